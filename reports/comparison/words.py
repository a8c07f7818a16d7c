"""Numbers of a comparison in words, the same in each of its reports."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dds_trace.analyzer.verdicts.gate import Against
from dds_trace.analyzer.verdicts.gates import GateResult
from dds_trace.base.printable import MAX_FINDING_CHARACTERS, printable
from dds_trace.base.units import MISSING, format_duration, format_number, three_digits

from ..book.groups import ALL_METRIC_LABELS, STATISTIC_LABELS, format_ratio, joined
from ..book.verdicts import episodes_words

LOST = "lost"
"""Replaces a time where too many messages were lost for the statistic."""

VERDICTS = {"worse": "slower", "better": "faster", "same": "the same", "inconclusive": "no clear change"}


def metric_words(metric: str) -> str:
    return ALL_METRIC_LABELS.get(metric, metric)


def statistic_words(statistic: str) -> str:
    return STATISTIC_LABELS.get(statistic, statistic)


def with_article(statistic: str) -> str:
    label = statistic_words(statistic)
    return f"the {label}" if label.isalpha() else label


def unjudged_words(statistics: Sequence[str]) -> list[str]:
    tails = [with_article(name) for name in statistics if name.startswith("p9")]
    others = [with_article(name) for name in statistics if not name.startswith("p9")]
    reasons = (("the runs differ too much", others), ("there are too few messages", tails))
    return [f"{reason} to judge {joined(names)}" for reason, names in reasons if names]


def found_from_words(ratio: float | None) -> str:
    if ratio is None:
        return ""
    return change_words(ratio) if ratio <= MOST_RATIO else WIDE


def time_words(value_ns: float | None) -> str:
    return LOST if value_ns is not None and math.isinf(value_ns) else format_duration(value_ns)


def both_words(row: Mapping[str, Any]) -> str:
    return f"{time_words(row['base_ns'])} → {time_words(row['new_ns'])}"


def side_words(row: Mapping[str, Any], side: str) -> str:
    value_ns, received_ns = row[f"{side}_ns"], row[f"{side}_survivors_ns"]
    words = time_words(value_ns)
    if words == LOST and received_ns is not None:
        words += f" (received {format_duration(received_ns)})"
    bursts = episodes_words(row, side)
    return f"{words} ({bursts})" if bursts else words


MOST_PERCENT = 1000
"""Change from which on a factor is written."""

MOST_RATIO = 10.0
"""A smallest visible change beyond which a statistic cannot be judged."""

TOO_WIDE = 100.0
"""Upper by lower end of an interval that says nothing."""

WIDE = "uncertain"
"""Replaces such an interval."""


def change_words(ratio: float | None) -> str:
    if ratio is None:
        return MISSING
    if math.isinf(ratio):
        return LOST
    percent = 100 * (ratio - 1)
    if abs(percent) < 0.005:
        return "0 %"
    return f"{percent:+.3g} %" if percent < MOST_PERCENT - 0.5 else f"{format_number(ratio)} times"


def interval_words(row: Mapping[str, Any]) -> str:
    ends = row["ratio_low"], row["ratio_high"]
    low, high = map(change_words, ends)
    if MISSING in (low, high) or low == high == LOST:
        return MISSING
    return WIDE if _is_wide(*ends) else f"{low.removesuffix(' %')} to {high}"


def _is_wide(low: float, high: float) -> bool:
    return math.isfinite(high) and high > TOO_WIDE * low


def change_with_interval(row: Mapping[str, Any]) -> str:
    interval = interval_words(row)
    short = interval.replace("+", "").removesuffix(" %")
    return change_words(row["ratio"]) + (f" ({short})" if interval != MISSING else "")


def statistic_cells(row: Mapping[str, Any]) -> tuple[str, str, str, str, str]:
    name = f"{metric_words(row['metric'])} {statistic_words(row['statistic'])}"
    sides = side_words(row, "base"), side_words(row, "new")
    return name, *sides, change_words(row["ratio"]), interval_words(row)


def measured_words(result: GateResult, value: float | None) -> str:
    if value is None:
        return "unknown"
    if result.gate.against is Against.RATIO:
        return change_words(value)
    if result.gate.statistic:
        return time_words(value)
    if result.gate.against is Against.DIFFERENCE:
        return f"{'+' if value > 0 else ''}{three_digits(100 * value)} points"
    return format_ratio(value)


def gate_interval_words(result: GateResult) -> str:
    low, high = result.low, result.high
    is_ratio = result.gate.against is Against.RATIO or (result.gate.statistic and result.gate.against is Against.NEW)
    if is_ratio and low is not None and high is not None and _is_wide(low, high):
        return WIDE
    return f"{measured_words(result, low)} to {measured_words(result, high)}"


def why_words(result: GateResult) -> str:
    smallest = ""
    if result.smallest_ratio is not None:
        smallest = f"changes from {change_words(result.smallest_ratio)} on are found with a probability of 80 %"
        if result.smallest_ratio > MOST_RATIO:
            smallest = unjudged_words([result.gate.statistic])[0]
    elif result.smallest_drop is not None:
        smallest = f"drops from {100 * result.smallest_drop:.3g} points on are found with a probability of 80 %"
    return printable("; ".join(text for text in (result.reason, smallest) if text), MAX_FINDING_CHARACTERS)


@dataclass(frozen=True, slots=True)
class Gated:
    where: str
    result: GateResult

    @property
    def line(self) -> str:
        why = why_words(self.result)
        return f"{self.result.outcome.value}: {self.result.gate.text} ({self.where})" + (f": {why}" if why else "")


GATE_COLUMNS = ("Gate", "Result", "Measured", "Interval", "Outcome", "Why")


def gate_cells(gates: Sequence[Gated]) -> list[tuple[str, str, str, str, str, str]]:
    return [
        (
            gated.result.gate.text,
            gated.where,
            measured_words(gated.result, gated.result.measured),
            gate_interval_words(gated.result),
            gated.result.outcome.value,
            why_words(gated.result),
        )
        for gated in gates
    ]
