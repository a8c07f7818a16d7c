"""Numbers of a comparison in words, alike in each of its reports: times, changes, and what gates judge."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from dds_trace.analyzer.verdicts.gate import Against
from dds_trace.base.units import MISSING, format_duration

from ..book.groups import format_ratio
from ..changes import episodes_words

if TYPE_CHECKING:
    from collections.abc import Mapping

    from dds_trace.analyzer.verdicts.gates import GateResult

LOST = "lost"
"""In place of a time that more messages never reached than the statistic leaves room for."""


VERDICTS = {"worse": "slower", "better": "faster", "same": "the same", "inconclusive": "no clear change"}
"""Verdict on a time -> its words."""


def time_words(value_ns: float | None) -> str:
    """Write a time, as in `1.25 ms` or `lost`."""
    return LOST if value_ns is not None and math.isinf(value_ns) else format_duration(value_ns)


def both_words(row: Mapping[str, Any]) -> str:
    """Write the times of both sides, as in `1.02 ms → 1.21 ms`."""
    return f"{time_words(row['base_ns'])} → {time_words(row['new_ns'])}"


def survivors_words(row: Mapping[str, Any], side: str) -> str:
    """Write the time of a side, beside a lost one that of the survivors, and of a tail the episodes it rests on."""
    value_ns, survivors_ns = row[f"{side}_ns"], row[f"{side}_survivors_ns"]
    said = time_words(value_ns)
    if said == LOST and survivors_ns is not None:
        said += f" (survivors {format_duration(survivors_ns)})"
    episodes = episodes_words(row, side)
    return f"{said} ({episodes})" if episodes else said


def change_words(ratio: float | None) -> str:
    """Write a ratio as a change, as in `+20 %` or `-0.35 %`."""
    if ratio is None:
        return MISSING
    if math.isinf(ratio):
        return LOST
    percent = 100 * (ratio - 1)
    if abs(percent) < 0.005:
        return "0 %"
    return f"{percent:+,.0f} %" if abs(percent) >= 99.5 else f"{percent:+.2g} %"


def interval_words(row: Mapping[str, Any]) -> str:
    """Write the interval of a ratio, as in `+12 to +25 %`; a dash where it has no end."""
    low, high = (change_words(row[end]) for end in ("ratio_low", "ratio_high"))
    return MISSING if MISSING in (low, high) or low == high == LOST else f"{low.removesuffix(' %')} to {high}"


def change_with_interval(row: Mapping[str, Any]) -> str:
    """Write the change of a row and in brackets its interval, where it has one: `+20 % (12 to 25)`."""
    interval = interval_words(row)
    short = interval.replace("+", "").removesuffix(" %")
    return change_words(row["ratio"]) + (f" ({short})" if interval != MISSING else "")


def measured_words(result: GateResult, value: float | None) -> str:
    """Write a value that a gate judges in the unit of its limit."""
    if value is None:
        return "unknown"
    if result.gate.against is Against.RATIO:
        return change_words(value)
    if result.gate.statistic:
        return time_words(value)
    return f"{value * 100:+.2f} points" if result.gate.against is Against.DIFFERENCE else format_ratio(value)


def gate_interval_words(result: GateResult) -> str:
    """Write the interval of what a gate judges."""
    return f"{measured_words(result, result.low)} to {measured_words(result, result.high)}"


def why_words(result: GateResult) -> str:
    """Return the reason of a result, with the smallest change that could have been found."""
    found = ""
    if result.smallest_ratio is not None:
        found = f"changes from {change_words(result.smallest_ratio)} on are found with a probability of 80 %"
    elif result.smallest_drop is not None:
        found = f"drops from {100 * result.smallest_drop:.2f} points on are found with a probability of 80 %"
    return "; ".join(text for text in (result.reason, found) if text)
