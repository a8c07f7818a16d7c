"""What a plan's key may hold and what it means, told once, at the field that holds its value.

From these the parser takes its validators (`tables.py`), an editor its completion (`schema.py`) and the documentation its
tables (`docs/generated/plan_keys.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeVar

from dds_trace.tracefile import limits

if TYPE_CHECKING:
    from dds_trace.tracefile.limits import Limit

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Key:
    """One key of a plan.

    Attributes:
        meaning: what the value says, as a sentence without its subject, for the documentation and editors.
        limit: validator of the value.
        unit: unit of a number, empty where the name tells it or there is none.
        default: what holds where the plan says nothing, in words; empty where the field's own default tells it.
    """

    meaning: str
    limit: Limit = limits.TEXT
    unit: str = ""
    default: str = ""


def plan_key(default: _T, limit: Limit, meaning: str, *, unit: str = "", default_words: str = "") -> _T:
    """Return a dataclass field that is a key of a plan; the arguments are those of `Key`, `default` is the field's."""
    value: _T = field(default=default, metadata={"key": Key(meaning, limit, unit, default_words)})
    return value
