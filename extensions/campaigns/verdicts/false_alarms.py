"""How precise a statistic is, and how often a comparison of two equal sides (A/A), dealt in every way, calls one better or worse."""

from __future__ import annotations

import math
import random
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

import polars as pl

from dds_trace.analyzer.model.metrics import METRICS
from dds_trace.analyzer.model.runs import delivered_runs, split_runs
from dds_trace.analyzer.run_statistics.between_runs import interval_of_runs
from dds_trace.analyzer.statistics.intervals import Basis, Interval
from dds_trace.base.errors import OptionError
from dds_trace.extensions.gates.compare import STATISTIC_BY_NAME, CompareOptions, compare_roundtrips


def check_statistic(text: str) -> tuple[str, str]:
    """Return metric and statistic of a text such as `latency_p99`; an `OptionError` where there is none."""
    metric, _, statistic = text.partition("_")
    if metric not in METRICS or statistic not in STATISTIC_BY_NAME:
        raise OptionError(
            f"{text!r} is not a statistic; write METRIC_STATISTIC, for example latency_p99 (metrics: {', '.join(METRICS)}; "
            f"statistics: {', '.join(STATISTIC_BY_NAME)})"
        )
    return metric, statistic


def until_confidence(runs: int) -> float:
    """Return the confidence of the interval that `--until` looks at after so many runs.

    A repeated confidence interval (C. Jennison and B. Turnbull, JRSS B 51, 1989), its levels by simulation: few runs that agree by chance
    would stop first.
    """
    if runs < 8:
        return 0.9999
    return 0.9995 if runs < 15 else 0.995


def half_widths(rows: pl.DataFrame, runs: Mapping[str, Collection[int]], text: str) -> dict[str, float]:
    """Return half of a statistic's interval between runs, in percent, for each set of run ids; or infinity."""
    metric, statistic = check_statistic(text)
    return {
        name: _half_width_percent(
            interval_of_runs(
                delivered_runs(split_runs(rows.filter(pl.col("run_id").is_in(list(run_ids)))), metric),
                STATISTIC_BY_NAME[statistic],
                until_confidence(len(run_ids)),
            )
        )
        for name, run_ids in runs.items()
    }


def _half_width_percent(interval: Interval) -> float:
    value, lower, upper = interval.value, interval.lower, interval.upper
    if interval.basis is Basis.WITHIN_RUN or value is None or value <= 0 or lower is None or upper is None:
        return math.inf
    return 100 * (upper - lower) / 2 / value


MOST_DEALS = 64


@dataclass(frozen=True, slots=True)
class FalseAlarms:
    measured: int
    of_measured: int
    dealt: int
    of_dealt: int
    deals: int

    @property
    def rate(self) -> float:
        return self.dealt / self.of_dealt if self.of_dealt else 0.0


def count_false_alarms(
    base: pl.DataFrame, new: pl.DataFrame, passes: Mapping[int, int], options: CompareOptions | None = None
) -> FalseAlarms:
    options = options or CompareOptions(paired=True)
    pass_of_row = pl.col("run_id").replace_strict(
        list(passes), list(passes.values()), default=None, return_dtype=pl.Int64
    )
    rows = pl.concat(
        [side.with_columns(_pass=pass_of_row, _is_new=pl.lit(is_new)) for side, is_new in ((base, False), (new, True))]
    ).sort("_pass", maintain_order=True, nulls_last=True)
    counts = []
    for swapped in _deals(sorted(set(passes.values()))):
        is_new = pl.col("_is_new") ^ pl.col("_pass").is_in(list(swapped)).fill_null(value=False)
        before, after = (rows.filter(is_new == side).drop("_pass", "_is_new") for side in (False, True))
        verdicts = compare_roundtrips(before, after, options, passes=passes).rows["verdict"]
        counts.append((int(verdicts.is_in(["better", "worse"]).sum()), len(verdicts)))
    dealt, of_dealt = (sum(column) for column in zip(*counts, strict=True))
    return FalseAlarms(*counts[0], dealt, of_dealt, len(counts))


def _deals(passes: list[int]) -> Iterator[tuple[int, ...]]:
    others = passes[1:]
    every, chance = 1 << len(others), random.Random(0)  # noqa: S311 - an order, not a secret
    numbers = {0} if every > MOST_DEALS else set(range(every))
    while len(numbers) < min(every, MOST_DEALS):
        numbers.add(chance.getrandbits(len(others)))
    for number in sorted(numbers):
        yield tuple(other for index, other in enumerate(others) if number >> index & 1)
