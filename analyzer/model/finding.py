"""A finding: one doubtful measurement, as every check words it and every report shows it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


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
        groups: row numbers in `summary` of the groups it is about, or that a recording it is about took part in; empty where it is
            about a file or device.
        count: how many findings of its kind it stands for; more than one only for the last of very many.
        effect: size of what it says, 0 to 1: the share of messages, or of the value, that it touches; 1 where it
            touches all. Of equal severity the largest come first.
    """

    severity: Severity
    code: str
    where: str
    what: str
    action: str
    groups: tuple[int, ...] = ()
    count: int = 1
    effect: float = 1.0
