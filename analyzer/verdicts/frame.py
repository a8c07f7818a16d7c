"""Judgements of results against each other: links and devices, our own nodes' cost, bridges, other flows and loads, and of a job."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import polars as pl

from dds_trace.base.printable import printable
from dds_trace.base.units import format_duration

from ..model.names import device_pair, group_words, varying_parameters
from ..model.parameters import BRIDGE_MATCH_COLUMNS, DEVICE_COLUMNS, PARAMETER_NAMES, SETTING_COLUMNS, ParameterValue
from ..statistics.intervals import Basis, ranges_overlap
from .answers import CaseAnswer
from .judgements import OPEN, PROVEN, Claim, Judgement, Row, judged_change

if TYPE_CHECKING:
    from .recommend import Recommendation


def judge_places(summary: pl.DataFrame, intervals: pl.DataFrame, forged: Collection[int]) -> Iterator[Judgement]:
    """Judge how many times as long a message takes over each link, and from or on each device, as over and on the fastest.

    By medians of results that lost nothing and differ in nothing else; proven where their intervals between runs do not overlap.
    """
    between = {"metric": "latency", "percentile": "p50", "basis": Basis.BETWEEN_RUNS.value}
    groups = (
        summary.with_row_index("group")
        .filter(pl.col("published") == pl.col("received"), pl.col("unsent").fill_null(0) == 0)
        .filter(~pl.col("group").is_in(list(forged)))
        .join(intervals.filter(**between).select("group", "low_ns", "high_ns"), on="group", maintain_order="left")
        .with_columns(pl.col("latency_p50_ns").fill_null(0.0))
    )
    pings, relays = (set(summary[name].to_list()) for name in DEVICE_COLUMNS)
    has_one_relay = len(relays) == 1 and not relays & pings
    places: tuple[tuple[Claim, tuple[str, ...], Callable[[Row], str]], ...] = (
        (Claim.OVER, ("connectivity",), lambda row: printable(row["connectivity"])),
        (Claim.FROM, DEVICE_COLUMNS, lambda row: printable(row["ping_device"]))
        if has_one_relay
        else (Claim.ON, DEVICE_COLUMNS, lambda row: device_pair(row["ping_device"], row["relay_device"])),
    )
    for claim, columns, name_of in places:
        alike: dict[tuple[ParameterValue, ...], dict[str, Row]] = {}
        for row in groups.iter_rows(named=True):
            others = tuple(row[name] for name in PARAMETER_NAMES if name not in columns)
            alike.setdefault(others, {})[name_of(row)] = row
        compared = [by_name for by_name in alike.values() if len(by_name) > 1]
        medians_ns = ({name: row["latency_p50_ns"] for name, row in by_name.items()} for by_name in compared)
        won = Counter(min(times_ns, key=times_ns.__getitem__) for times_ns in medians_ns)
        for fastest, _ in won.most_common(1):
            for by_name in (by_name for by_name in compared if fastest in by_name):
                base = by_name.pop(fastest)
                for name, slow in sorted(by_name.items()):
                    ratio = slow["latency_p50_ns"] / base["latency_p50_ns"] if base["latency_p50_ns"] else None
                    ranges = [(side["low_ns"], side["high_ns"]) for side in (slow, base)]
                    yield Judgement(
                        *(claim, name, "latency_p50", fastest, ratio),
                        basis=Basis.BETWEEN_RUNS.value,
                        verdict=PROVEN if ratio and not ranges_overlap(*ranges) else OPEN,
                        group=slow["group"],
                    )


_DIFFERENT = (Claim.FASTEST, Claim.SLOWER)


def judge_own_nodes(answers: Iterable[CaseAnswer], summary: pl.DataFrame) -> Iterator[Judgement]:
    """Judge for each proven difference whether it is less than what our nodes cost more on the slower side.

    `value` is that cost in ns: half of the difference of `own_cost_ns`, which is of a round trip.
    """
    own_ns = summary["own_cost_ns"].to_list()
    for answer in answers:
        times_ns = {one.name: (one.p50_ns, own_ns[one.groups[-1]] if one.groups else None) for one in answer.contenders}
        proven = [row for row in answer.judgements if row.verdict == PROVEN and row.statistic == "latency_p50"]
        judged = [_own_nodes(row, times_ns, answer.words) for row in proven if row.claim in _DIFFERENT]
        yield from {(row.subject, row.base): row for row in judged}.values()


def _own_nodes(proven: Judgement, times_ns: Mapping[str, tuple[float | None, float | None]], words: str) -> Judgement:
    fast, slow = sorted((proven.subject, proven.base), key=lambda name: times_ns[name][0] or 0.0)
    (fast_ns, fast_own_ns), (slow_ns, slow_own_ns) = times_ns[fast], times_ns[slow]
    more_ns = (slow_own_ns - fast_own_ns) / 2 if slow_own_ns and fast_own_ns else None
    is_below = bool(fast_ns and slow_ns and more_ns is not None and slow_ns - fast_ns < more_ns)
    verdict = PROVEN if is_below else OPEN
    return Judgement(
        Claim.OWN_NODES, f"{slow}; {words}", "latency_p50", fast, more_ns, verdict=verdict, group=proven.group
    )


def judged_costs(bridge_costs: pl.DataFrame, interference: pl.DataFrame) -> Iterator[Judgement]:
    names = varying_parameters(bridge_costs, BRIDGE_MATCH_COLUMNS)
    for row in bridge_costs.iter_rows(named=True):
        yield _cost(judged_change(Claim.THROUGH, f"{row['bridge']}; {group_words(row, names)}", row, "the same domain"))
    for row in interference.iter_rows(named=True):
        yield _cost(judged_change(Claim.WITH, row["with_flows"], row, row["flow"], row["group"]))


def _cost(change: Judgement) -> Judgement:
    return replace(change, verdict=OPEN if change.verdict in ("same", "inconclusive") else PROVEN)


def judged_candidates(recommendation: Recommendation) -> Iterator[Judgement]:
    from .recommend import Fit

    job, settings = recommendation.job, [one.setting for one in recommendation.candidates]
    names = [name for name in SETTING_COLUMNS if name == "vendor" or len({setting[name] for setting in settings}) > 1]
    for one in recommendation.candidates:
        yield Judgement(
            Claim.MISSES if one.fit is Fit.MISSES else Claim.MEETS,
            group_words(one.setting, names),
            f"{job.metric}_p{100 * job.reliability:.6g}",
            format_duration(job.deadline_ns),
            *(one.value_ns, one.lower_ns, one.upper_ns, one.basis),
            verdict=PROVEN if one.fit in (Fit.MEETS, Fit.MISSES) and one.measured else OPEN,
            reason=one.reason,
        )
