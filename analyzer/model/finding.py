"""Findings, and the files that an analysis looked at."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


@dataclass(frozen=True, slots=True)
class Source:
    """One file or folder that was looked at.

    Attributes:
        status: `read`, `truncated` (used up to where it ends), `duplicate` (same content as another, not
            counted again) or `skipped` (not a trace).
        detail: why it was skipped or cut.
        events: events used from it.
    """

    path: str
    status: str
    detail: str
    events: int


class Severity(Enum):
    """How much a finding should change a reader's trust in the numbers."""

    ERROR = "error"  # numbers named here are wrong or missing
    WARNING = "warning"  # numbers named here are doubtful
    INFO = "info"  # worth knowing


@dataclass(frozen=True, slots=True)
class Finding:
    """A doubtful measurement: what is doubtful, where, and what to do about it.

    Attributes:
        code: a short stable name such as `loss`, for scripts.
        where: name of the file, run, result or device.
        what: one sentence with the figures.
        action: what to do next.
        groups: rows of `summary` that it is about, or that its recording took part in; empty for a file or device.
        count: number of findings in it; more than one only for the last of very many.
        effect: share of the messages or of the value that it affects, 0 to 1.
    """

    severity: Severity
    code: str
    where: str
    what: str
    action: str
    groups: tuple[int, ...] = ()
    count: int = 1
    effect: float = 1.0
