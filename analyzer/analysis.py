"""The one value that leaves this room: a frozen `Analysis` of a folder of traces."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import polars as pl

    from analyzer.rows import RoundTripRows
    from tracefile import Run, Session


class Severity(Enum):
    """How much a finding should change a reader's trust in the numbers."""

    ERROR = "error"  # numbers named here are wrong or missing
    WARNING = "warning"  # numbers named here are doubtful
    INFO = "info"  # worth knowing


@dataclass(frozen=True, slots=True)
class Finding:
    """A doubtful measurement: what is doubtful, where, and what to do about it.

    Attributes:
        code: a short stable name such as `loss` or `few_samples`, for scripts.
        where: the file, run, group or device it is about, in words.
        what: one sentence with the figures.
        action: one sentence: what to do next.
    """

    severity: Severity
    code: str
    where: str
    what: str
    action: str


@dataclass(frozen=True, slots=True)
class Source:
    """One file or folder that was looked at.

    Attributes:
        status: `read`, `truncated` (used up to where it ends), `duplicate` (same content as another, not
            counted again) or `skipped` (no trace).
        detail: why it was skipped or cut; empty when read whole.
        events: events used from it.
    """

    path: str
    status: str
    detail: str
    events: int


@dataclass(frozen=True, slots=True, eq=False)
class Analysis:
    """Everything that was computed from one folder of traces; reports draw it and compute nothing.

    Frames (columns, units and dtypes are documented where each is made):

    Attributes:
        title: the analyzed folder's name.
        sources: the files that were looked at.
        sessions: the recording processes, sorted by start.
        runs: the runs, sorted by start.
        rows: one row per published message and relay; see `roundtrips` and `scan_roundtrips`.
        summary: one row per group (`docs/trace-format.md`), sorted by its parameter columns; row number i
            is group i wherever another frame has a column `group`.
        distributions: `group` u32, `metric` str (`rtt`, `intermediate`, `latency`, `response`), `value_ns`
            f64 (bucket centre), `count` u64: a histogram per group and metric, relative error at most 0.1 %.
        timeline: `group` u32, `run_id` u64, `relay_id` u32, `sequence` u64, `elapsed_s` f64 (scheduled time
            since the run's first counted message), `latency_ns` i64 null, `rtt_ns` i64 null, `outcome` str: rows of
            `roundtrips` for drawing, decimated where a run is long (extremes and losses are kept).
        timeline_decimated: whether `timeline` leaves rows out.
        findings: most severe first.
        outputs: files written, by kind (`roundtrips`, `summary`).
    """

    title: str
    sources: tuple[Source, ...]
    sessions: tuple[Session, ...]
    runs: tuple[Run, ...]
    rows: RoundTripRows
    summary: pl.DataFrame
    distributions: pl.DataFrame
    timeline: pl.DataFrame
    timeline_decimated: bool
    findings: tuple[Finding, ...]
    outputs: Mapping[str, Path] = field(default_factory=dict)

    @property
    def roundtrips(self) -> pl.DataFrame:
        """One row per published message and relay (`docs/trace-format.md`), by group, run, relay and sequence.

        Of a large campaign they are in a file, and this reads all of it: take `scan_roundtrips` for a part.
        """
        return self.rows.frame()

    def scan_roundtrips(self) -> pl.LazyFrame:
        """The same, of which only what is asked for is read."""
        return self.rows.scan()
