"""The one value that leaves this room: a frozen `Analysis` of a folder of traces."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, cast

import polars as pl
from polars.exceptions import PolarsError

from dds_trace.base.errors import TraceFormatError
from dds_trace.tracefile.format.descriptions import Run, Session

from .model.unsent import with_unsent
from .model.wire import WIRE_FRAMES
from .pairing.rows import RowStore
from .saving.folder import read_folder, write_folder
from .saving.records import Content, from_json, to_json

if TYPE_CHECKING:
    import os
    from collections.abc import Mapping

    from plotly.graph_objects import Figure

    from .model.finding import Finding, Source
    from .verdicts.answers import CaseAnswer
    from .verdicts.recommend import Recommendation


@dataclass(frozen=True, slots=True, eq=False)
class Details:
    """What takes a closer look than rows and summary. `group` is the row number in `summary`; times in ns.

    Attributes:
        intervals: every percentile with its confidence interval (`intervals.interval_frame`): `group` u32,
            `metric` str (`rtt`, `intermediate`, `latency`, `response`, `outbound`, `return`), `percentile` str
            (`p50` ... `p99_9`), `quantile` f64, `estimate_ns`, `low_ns`, `high_ns` f64 null where the sample does
            not support them, `method` str null, `confidence` f64, `messages` u64, `independent` u64, `runs`, `units` u32,
            `episodes` u64 null, `basis` str (`between runs` or `within one run`), `between`, `within` f64 null,
            `typical_ns` f64 null.
        one_way: way out and way back (`intervals.one_way_frame`): `group` u32, `metric` str (`outbound`,
            `return`), `messages` u64, `mean_ns`, `min_ns`, `p50_ns` ... `p99_9_ns`, `max_ns` f64, `bound_p50_ns`,
            `bound_max_ns` f64: asymmetry of the link inside the bound cannot be seen.
        breakdown: where the time goes (`breakdown.breakdown_frame`), a row per part in the order of time:
            `group` u32, `part` str, `order` u32, `messages` u64, `mean_ns`, `p50_ns`, `p99_ns`, `bound_ns` f64.
        responses: response time against round trip time (`breakdown.response_frame`), a row per group
            with a schedule: `group` u32, `messages` u64, `late_ratio` f64, `waiting_max_ns` i64, `rtt_p50_ns`,
            `response_p50_ns`, `rtt_p99_ns`, `response_p99_ns`, `hidden_p50_ns`, `hidden_p99_ns` f64. Like `breakdown`
            without a row of a group that was worked at in parts (`batches.WHOLE_GROUP_EVENTS`); a finding says so.
        freshness: a row per run and relay: the columns of `freshness.FRESHNESS_SCHEMA`.
        outages: a row per outage: `group` u32, `run_id` u64, `relay_id` u32, `first_sequence`, `messages` u64,
            `start_ns`, `end_ns`, `duration_ns`, `recovery_ns` i64 null.
        clock_fits: a row per pair of devices, boot and stretch without a step (`one_way.segment_table`):
            `ping_device`, `relay_device` str, `boot` i64, `same_clock` bool, `segment` u32, `start_ns`, `end_ns`,
            `at_ns`, `offset_ns`, `bound_ns` i64, `drift_ppb`, `drift_bound_ppb` f64, `residual_ns`, `step_before_ns`,
            `step_bound_ns` i64, `relay_boot` str null.
        clock_knots: offsets over time, what the fits rest on (`one_way.knots_of`): `group` u32, `run_id` u64,
            `relay_id` u32, `ping_device`, `relay_device` str, `messages` u64, `at_ns`, `offset_ns`, `bound_ns` i64,
            `relay_boot` str null, `same_boot` bool null.
        host_samples: load of the devices over time (`host_samples.host_sample_frame`), columns of
            `host_samples.HOST_SAMPLE_SCHEMA`.
        bridge_costs: different domains against the same domain for equal parameters (`bridge_cost.bridge_cost`),
            every percentile of the latency. A kind of message with more than `cases.MOST_COMPARED_ROWS` rows has
            none, and a finding says so.
        wire: what the messages cost on the wire, a row per group recorded with `--wire` (`model.wire`).
        wire_classes: the same by class of traffic.
        wire_repeats: the same by how often messages were sent again, with their times.
        answers: the fastest contenders for each kind of message; rows as for `bridge_costs`.
        deadline_ns: the deadline that `freshness` judges; None for none.
        deadline_metric: metric that it is for.
        recommendation: settings for the `job` of the analysis; None without a job.
        requested: False if the analysis was made with `details=False`: every frame is then empty.
    """

    intervals: pl.DataFrame
    one_way: pl.DataFrame
    breakdown: pl.DataFrame
    responses: pl.DataFrame
    freshness: pl.DataFrame
    outages: pl.DataFrame
    clock_fits: pl.DataFrame
    clock_knots: pl.DataFrame
    host_samples: pl.DataFrame
    bridge_costs: pl.DataFrame
    wire: pl.DataFrame
    wire_classes: pl.DataFrame
    wire_repeats: pl.DataFrame
    answers: tuple[CaseAnswer, ...]
    deadline_ns: int | None = None
    recommendation: Recommendation | None = None
    requested: bool = True
    deadline_metric: str = "response"


@dataclass(frozen=True, slots=True, eq=False)
class Analysis:
    """Everything that was computed from one folder of traces; reports draw it and compute nothing.

    Frames (columns, units and dtypes are documented where each is made):

    Attributes:
        title: the analyzed folder's name.
        sources: the files that were looked at.
        sessions: the recording processes, sorted by start.
        runs: the runs, sorted by start.
        rows: one row per published message and relay; read with `load_roundtrips` and `scan_roundtrips`.
        summary: one row per group (`docs/trace-format.md`), sorted by its parameter columns; row number i
            is group i wherever another frame has a column `group`.
        distributions: `group` u32, `metric` str (`rtt`, `intermediate`, `latency`, `response`), `value_ns`
            f64 (bucket centre), `count` u64: a histogram per group and metric, relative error at most 0.1 %.
        run_times: when each run of each group sent, and what came back: columns of `run_rows.RUN_SCHEMA`.
        timeline: `group` u32, `run_id` u64, `relay_id` u32, `sequence` u64, `elapsed_s` f64 (scheduled time
            since the run's first counted message), `latency_ns` i64 null, `rtt_ns` i64 null, `outcome` str: rows of
            the round trips for drawing, decimated where a run is long (extremes and losses are kept).
        timeline_decimated: whether `timeline` leaves rows out.
        findings: most severe first.
        details: what takes more time than rows and summary.
        outputs: files written, by kind (`roundtrips`, `summary`).
        unsent: run_id -> messages that were due and never left, of the runs that have any.
    """

    title: str
    sources: tuple[Source, ...]
    sessions: tuple[Session, ...]
    runs: tuple[Run, ...]
    rows: RowStore
    summary: pl.DataFrame
    distributions: pl.DataFrame
    run_times: pl.DataFrame
    timeline: pl.DataFrame
    timeline_decimated: bool
    findings: tuple[Finding, ...]
    details: Details
    outputs: Mapping[str, Path] = field(default_factory=dict)
    unsent: Mapping[int, int] = field(default_factory=dict)

    def load_roundtrips(self) -> pl.DataFrame:
        """Read all round trips into memory: gigabytes of a large campaign, which `scan_roundtrips` reads in part.

        Returns:
            One row per published message and relay (`docs/trace-format.md`), by group, run, relay and sequence.
        """
        return self.rows.load()

    def load_messages(self) -> pl.DataFrame:
        """Read every message that was due into memory: what verdicts rest on.

        Returns:
            The round trips, and behind those of each run and relay a row of outcome `unsent` for each message that was due
            and never left (`model.unsent.with_unsent`).
        """
        return with_unsent(self.load_roundtrips(), self.unsent)

    @property
    def barred_groups(self) -> pl.DataFrame:
        """The rows of `summary` in whose groups a setting was asked for and not applied (finding `not_applied`)."""
        barred = {group for each in self.findings if each.code == "not_applied" for group in each.groups}
        return self.summary[sorted(barred)]

    def scan_roundtrips(self) -> pl.LazyFrame:
        """Return the round trips as a lazy frame, which reads only the rows and columns that a query takes."""
        return self.rows.scan()

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Write the analysis into a folder of its own, from which `load_analysis` reads it.

        An analysis that is there already is replaced as a whole, or stays if this one cannot be written.

        Raises:
            OutputExistsError: the folder holds something else than a saved analysis.
            OutputError: the folder cannot be written.
        """
        content = Content(
            title=self.title,
            sources=self.sources,
            sessions=tuple(session.to_json() for session in self.sessions),
            runs=tuple(run.to_json() for run in self.runs),
            timeline_decimated=self.timeline_decimated,
            findings=self.findings,
            outputs={kind: str(path) for kind, path in self.outputs.items()},
            answers=self.details.answers,
            deadline_ns=self.details.deadline_ns,
            deadline_metric=self.details.deadline_metric,
            recommendation=self.details.recommendation,
            requested=self.details.requested,
            unsent={f"{run_id:016x}": count for run_id, count in self.unsent.items()},
        )
        text = json.dumps(to_json(content), allow_nan=False)
        frames = {name: getattr(self, name) for name in _FRAMES}
        frames |= {name: getattr(self.details, name) for name in DETAIL_FRAMES}
        write_folder(
            Path(folder),
            {
                _CONTENT: lambda path: path.write_text(text, encoding="utf-8"),
                _ROUNDTRIPS: self.scan_roundtrips().sink_parquet,
                **{f"{name}.parquet": frame.write_parquet for name, frame in frames.items()},
            },
        )

    def _repr_html_(self) -> str:
        """Return the first screen of the report, as a notebook shows it."""
        return _presenter().first_screen(self)

    def plot(
        self, name: str, *, panels: str | None = None, metric: str | None = None, statistic: str = "p50"
    ) -> Figure:
        """Return a figure of the report as a plotly `Figure`, to look at, change and save.

        Args:
            name: `latency_by_size`, `latency_by_rate`, `vendor_comparison`, `by_device`, `relay_time`, `received`, `run_spread`,
                `sustainable`, `transfer_by_size`, `transfer_by_rate` or `transfer_rate`.
            panels: what sets panels apart: `size`, `rate`, `device`, `link`, `middleware` or `bridge`; None as in the report.
            metric: `latency`, `rtt`, `intermediate` or `response`; None for the report's. For figures of such times.
            statistic: `mean`, `min`, `p50`, `p90`, `p95`, `p99`, `p99_9` or `max`. For figures of times and of their spread.

        Raises:
            OptionError: there is no such figure, dimension, metric or statistic, or nothing to draw.
        """
        return _presenter().plot(self, name, panels=panels, metric=metric, statistic=statistic)

    def show(self, folder: str | os.PathLike[str] | None = None) -> Path:
        """Write the HTML report, open it in this machine's browser and return its path.

        Args:
            folder: where it goes; None for a new temporary folder, which is not removed.

        Raises:
            OutputError: the report cannot be written.
        """
        return _presenter().show(self, None if folder is None else Path(folder))


class Presenter(Protocol):
    """What shows an analysis: the reports, a room above this one."""

    def first_screen(self, analysis: Analysis) -> str:
        """Return the first screen as HTML."""

    def plot(
        self, analysis: Analysis, name: str, *, panels: str | None, metric: str | None, statistic: str
    ) -> Figure:
        """Return a figure."""

    def show(self, analysis: Analysis, folder: Path | None) -> Path:
        """Write the report and open it."""


PRESENTER_MODULE = "dds_trace.reports.notebook"
"""Module that is the `Presenter`, imported by this name at first use: this room says what it asks for, and needs none of it."""


def _presenter() -> Presenter:
    return cast("Presenter", import_module(PRESENTER_MODULE))


_CONTENT, _ROUNDTRIPS = "content.json", "roundtrips.parquet"
_FRAMES = ("summary", "distributions", "run_times", "timeline")
DETAIL_FRAMES = (
    "intervals",
    "one_way",
    "breakdown",
    "responses",
    "freshness",
    "outages",
    "clock_fits",
    "clock_knots",
    "host_samples",
    "bridge_costs",
    *WIRE_FRAMES,
)
"""Names of the frames of `Details`."""


def load_analysis(folder: str | os.PathLike[str]) -> Analysis:
    """Read an analysis that `Analysis.save` wrote; its round trips stay in the folder until they are asked for.

    Raises:
        TraceFormatError: the folder holds no saved analysis, one of another version, or a file that was changed.
    """
    files = read_folder(Path(folder))
    try:
        content = from_json(Content, json.loads(files[_CONTENT].read_bytes()))
        frames = {name: _read_frame(files, name) for name in (*_FRAMES, *DETAIL_FRAMES)}
        rows = RowStore.of(files[_ROUNDTRIPS], frames["summary"])
    except (KeyError, ValueError, RecursionError, OSError, PolarsError) as err:
        raise TraceFormatError(
            Path(folder), f"the saved analysis cannot be read ({err}); analyze again"
        ) from err
    where = files[_CONTENT]
    return Analysis(
        title=content.title,
        sources=content.sources,
        sessions=tuple(Session.from_json(text, where) for text in content.sessions),
        runs=tuple(Run.from_json(text, where) for text in content.runs),
        rows=rows,
        **{name: frames[name] for name in _FRAMES},
        timeline_decimated=content.timeline_decimated,
        findings=content.findings,
        details=Details(
            **{name: frames[name] for name in DETAIL_FRAMES},
            answers=content.answers,
            deadline_ns=content.deadline_ns,
            deadline_metric=content.deadline_metric,
            recommendation=content.recommendation,
            requested=content.requested,
        ),
        outputs={kind: Path(path) for kind, path in content.outputs.items()},
        unsent={int(run_id, 16): count for run_id, count in content.unsent.items()},
    )


def _read_frame(files: Mapping[str, Path], name: str) -> pl.DataFrame:
    """Read one frame of a saved analysis."""
    return pl.read_parquet(files[f"{name}.parquet"])
