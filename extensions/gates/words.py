"""Numbers of a comparison in words, the same in each of its reports."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dds_trace.base.printable import MAX_FINDING_CHARACTERS, printable
from dds_trace.base.units import (
    MISSING,
    counted,
    format_duration,
    format_number,
    format_rate,
    format_ratio,
    joined,
    three_digits,
)
from dds_trace.reports.book.groups import ALL_METRIC_LABELS, LOST, STATISTIC_LABELS, some_of, time_words, times_words
from dds_trace.reports.book.verdicts import episodes_words

from .gate import Against, GateOutcome
from .gates import GateResult


def tone_of(verdict: str) -> str:
    is_bad = verdict in ("no reply came back", "loses more", "slower")
    return "bad" if is_bad else "good" if verdict in ("loses less", "faster") else ""


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


def both_words(row: Mapping[str, Any]) -> str:
    return f"{time_words(row['base_typical_ns'])} → {time_words(row['new_typical_ns'])}"


def side_words(row: Mapping[str, Any], side: str) -> str:
    value_ns, received_ns = row[f"{side}_typical_ns"], row[f"{side}_survivors_ns"]
    words = time_words(value_ns)
    if words == LOST and received_ns is not None:
        words += f" (received {format_duration(received_ns)})"
    bursts = episodes_words(row, side)
    return f"{words} ({bursts})" if bursts else words


MOST_PERCENT = 1000

MOST_RATIO = 10.0
"""A smallest visible change beyond which a statistic cannot be judged."""

TOO_WIDE = 100.0
"""Upper by lower end of an interval that says nothing."""

WIDE = "uncertain"


def change_words(ratio: float | None) -> str:
    if ratio is None:
        return MISSING
    if math.isinf(ratio):
        return LOST
    percent = 100 * (ratio - 1)
    if abs(percent) < 0.005:
        return "0 %"
    digits = ".3g" if abs(percent) >= 1 else ".2f"
    return f"{percent:+{digits}} %" if percent < MOST_PERCENT - 0.5 else f"{format_number(ratio)} times"


def interval_words(row: Mapping[str, Any]) -> str:
    ends = row["ratio_low"], row["ratio_high"]
    if None in ends or ends == (math.inf, math.inf):
        return MISSING
    return _ratios_words(*ends)


def _ratios_words(low: float, high: float) -> str:
    """Return an interval of changes, in percent or in times."""
    if _is_wide(low, high):
        return WIDE
    last = change_words(high)
    return ends_words(f"{format_number(low)} times" if last.endswith("times") else change_words(low), last)


def _is_wide(low: float, high: float) -> bool:
    return math.isfinite(high) and high > TOO_WIDE * low


def change_with_interval(row: Mapping[str, Any]) -> str:
    interval = interval_words(row)
    change = change_words(row["ratio"])
    return change if interval in (MISSING, change) else f"{change} ({interval})"


def measured_words(result: GateResult, value: float | None, *ends: float | None) -> str:
    """Return a value, a time in the unit of the largest of it and the ends."""
    if value is None:
        return "unknown"
    if result.gate.against is Against.RATIO:
        return change_words(value)
    if result.gate.metric == "rate":
        return format_rate(value)
    if result.gate.statistic or result.gate.metric in ("jitter", "hole"):
        return times_words([value, *ends])[0]
    if result.gate.against is Against.DIFFERENCE:
        return f"{'+' if value > 0 else ''}{three_digits(100 * value)} points"
    return format_ratio(value)


def gate_interval_words(result: GateResult) -> str:
    low, high = result.low, result.high
    if low is not None and high is not None:
        if result.gate.against is Against.RATIO:
            return _ratios_words(low, high)
        if result.gate.statistic and result.gate.against is Against.NEW and _is_wide(low, high):
            return WIDE
    return ends_words(measured_words(result, low, high), measured_words(result, high, low))


def ends_words(low: str, high: str) -> str:
    return low if low == high else f"{low.removesuffix(unit_of(high))} to {high}"


def unit_of(words: str) -> str:
    return "".join(words.rpartition(" ")[1:]) if " " in words else ""


def why_words(result: GateResult) -> str:
    smallest = seen_words(result)
    if smallest == WIDE:
        smallest = unjudged_words([result.gate.statistic])[0]
    elif smallest:
        smallest = f"the smallest change seen in 8 of 10 comparisons is {smallest}"
    return printable("; ".join(text for text in (result.reason, smallest) if text), MAX_FINDING_CHARACTERS)


def seen_words(result: GateResult) -> str:
    if result.found_from is None:
        return ""
    if result.gate.against is Against.RATIO:
        return found_from_words(result.found_from)
    return measured_words(result, result.found_from)


@dataclass(frozen=True, slots=True)
class Gated:
    where: str
    result: GateResult


MARKS = {GateOutcome.PASSED: "✓", GateOutcome.REGRESSED: "✗", GateOutcome.INCONCLUSIVE: "?"}
GATE_COLUMNS = ("", "Gate", "Measured (interval)", "Smallest change seen in 8 of 10 comparisons", "Result")
MOST_ROWS = 10

GateCells = tuple[str, str, str, str, str]


def gate_rows(gates: Sequence[Gated], *, shows_all: bool = False) -> list[tuple[GateOutcome, GateCells]]:
    rows: dict[object, list[Gated]] = {}
    for number, gated in enumerate(gates):
        is_single = shows_all or gated.result.outcome is GateOutcome.REGRESSED
        rows.setdefault(number if is_single else (gated.result.outcome, gated.result.gate.text), []).append(gated)
    return [(alike[0].result.outcome, _gate_cells(alike)) for alike in rows.values()]


def _gate_cells(alike: Sequence[Gated]) -> GateCells:
    is_above = alike[0].result.gate.operator in (">", ">=")
    measured = [gated for gated in alike if gated.result.value is not None] or alike
    worst = max(measured, key=lambda gated: (gated.result.value or 0.0) * (1 if is_above else -1))
    by_size = sorted((gated.result for gated in alike), key=lambda result: result.found_from or 0.0)
    limit_words = [words for result in by_size if (words := seen_words(result))]
    words = measured_words(worst.result, worst.result.value, worst.result.low, worst.result.high)
    interval = gate_interval_words(worst.result)
    more = f" and {len(alike) - 1} more" if len(alike) > 1 else ""
    return (
        MARKS[worst.result.outcome],
        worst.result.gate.text,
        words if interval in (words, "unknown") else f"{words} ({interval.removesuffix(unit_of(words))})",
        ends_words(limit_words[0], limit_words[-1]) if len(set(limit_words)) > 1 else "".join(limit_words[:1]),
        worst.where + more,
    )


def found_from_words(ratio: float) -> str:
    return WIDE if ratio > MOST_RATIO else change_words(ratio)


def gate_notes(gates: Sequence[Gated]) -> list[str]:
    notes = [
        f"{gated.result.gate.text}: {gated.where}: {gated.result.reason}"
        for gated in gates
        if gated.result.outcome is GateOutcome.REGRESSED and gated.result.reason
    ]
    notes += dict.fromkeys(
        f"Accepted: {gated.result.gate.text} in {gated.where}: {gated.result.gate.accepted}"
        for gated in gates
        if gated.result.gate.accepted
    )
    notes += [undecided_words(gates)]
    return [printable(note, MAX_FINDING_CHARACTERS) for note in notes if note]


def undecided_words(gates: Sequence[Gated]) -> str:
    """Return which gates are undecided, and for each what would decide the result that takes most."""
    unsure: dict[str, list[GateResult]] = {}
    for gated in gates:
        if gated.result.outcome is GateOutcome.INCONCLUSIVE:
            unsure.setdefault(gated.result.gate.text, []).append(gated.result)
    parts = []
    for text, results in unsure.items():
        most = max(results, key=lambda result: result.needs or 0)
        decides = most.reason.partition(", there ")[0].rstrip(".") or most.subject
        parts.append(f"{text} ({decides})")
    return f"Undecided: {joined(parts)}." if parts else ""


def not_met_words(gates: Sequence[Gated]) -> str:
    failed = [gated.result for gated in gates if gated.result.outcome is GateOutcome.REGRESSED]
    parts = [f"{row.gate.text}: {measured_words(row, row.value)}" for row in failed if row.value is not None]
    values = f" ({some_of(parts, 'more')})" if parts else ""
    return f"{len(failed)} of {counted(len(gates), 'limit')} not met{values}." if failed else ""


def with_undecided(answer: tuple[str, ...], gates: Sequence[Gated]) -> tuple[str, ...]:
    """Return an answer that names limits that are not met, and open ones, in its first line."""
    not_met, undecided, (headline, *others) = not_met_words(gates), undecided_words(gates), answer
    first = (headline, not_met, undecided) if not_met else (undecided, headline)
    return " ".join(printable(words, MAX_FINDING_CHARACTERS) for words in first if words), *others
