"""Findings, and files that were looked at."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

UNUSABLE = ("forged_or_foreign", "reply_size")
"""Codes of findings whose results are in no answer."""


@dataclass(frozen=True, slots=True)
class Source:
    """One file or folder that was looked at.

    `status` is `read`, `truncated`, `duplicate` (same content as another, not counted again) or `skipped` (not a trace), and
    `detail` says why.
    """

    path: str
    status: str
    detail: str
    events: int


class Severity(Enum):
    """What a finding means for the numbers."""

    ERROR = "error"  # they are wrong or missing
    WARNING = "warning"  # they are doubtful
    INFO = "info"  # worth knowing


class Subject(Enum):
    """What the `where` of a finding names."""

    ANALYSIS = "analysis"
    DEVICE = "device"  # or a pair of devices
    FILE = "file"
    RECORDING = "recording"
    RELAY = "relay"
    RESULT = "result"
    RUN = "run"


@dataclass(frozen=True, slots=True)
class Finding:
    """A doubtful measurement: where, what is doubtful, and what to do about it.

    Attributes:
        code: a stable name such as `loss`, for scripts.
        groups: rows of `summary` that it, or its recording, is about.
        count: findings in it; more than one only for the last of very many.
        effect: share of the messages or of the value that it affects, 0 to 1.
        subject: what `where` names.
        cure: what removes the cause that the traces prove; empty without.
    """

    severity: Severity
    code: str
    where: str
    what: str
    action: str
    groups: tuple[int, ...] = ()
    count: int = 1
    effect: float = 1.0
    subject: Subject = Subject.RESULT
    cure: str = ""
