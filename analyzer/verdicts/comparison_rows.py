"""The columns of a comparison's frames."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np
import polars as pl

from ..run_statistics.runs import Values

DISTRIBUTION_LEVELS = (0.0, 0.01, 0.025, *(n / 20 for n in range(1, 20)), 0.975, 0.99, 0.995, 0.999)


@dataclass(frozen=True)
class ChangeRow:
    """Columns of `Comparison.rows` after the match columns: one statistic of one metric of one matched group.

    Null is what the samples do not support; times are infinite where more messages were lost than the statistic leaves
    room for. `*_low*` and `*_high*` are the ends of an interval, `new_*` of the new side what `base_*` is of the base.

    Attributes:
        metric: metric that is compared.
        statistic: mean or a percentile such as p99_9.
        base_messages: messages of the base that have the metric.
        base_ns: the statistic with lost messages infinitely late, ns.
        base_typical_ns: the statistic of the base's typical run, ns; the change is of the typical runs.
        difference_ns: new - base, ns.
        ratio: new / base.
        superiority: probability that a message of the new side takes less than one of the base.
        cliffs_delta: 2 * superiority - 1.
        verdict: better, worse, same or inconclusive, adjusted over the groups.
        base_received_ratio: share of the messages that were received.
        base_survivors_ns: the statistic of the received messages, ns.
        base_episodes: bursts that the tail rests on.
        basis: between runs, or within one run.
        pairs: repeats that were compared one by one; 0 without.
        p_value: of no difference; null within one run.
        p_adjusted: adjusted over the groups, metrics and statistics.
        smallest_ratio: change that this group by itself would have shown with a probability of 80 %.
    """

    metric: str
    statistic: str
    base_messages: int
    new_messages: int
    base_ns: float | None
    new_ns: float | None
    new_low_ns: float | None
    new_high_ns: float | None
    difference_ns: float | None
    difference_low_ns: float | None
    difference_high_ns: float | None
    ratio: float | None
    ratio_low: float | None
    ratio_high: float | None
    superiority: float | None
    cliffs_delta: float | None
    verdict: str
    base_received_ratio: float | None
    new_received_ratio: float | None
    base_survivors_ns: float | None
    new_survivors_ns: float | None
    base_low_ns: float | None
    base_high_ns: float | None
    base_runs: int
    new_runs: int
    base_episodes: int | None
    new_episodes: int | None
    basis: str
    pairs: int
    p_value: float | None
    p_adjusted: float | None
    smallest_ratio: float | None
    base_typical_ns: float | None
    new_typical_ns: float | None


def with_clock_bounds(row: ChangeRow, base_ns: int, new_ns: int) -> ChangeRow:
    """Widen the intervals of a row by the largest error of each side's clocks; a difference within both is no verdict."""
    if not base_ns and not new_ns:
        return row
    both_ns = base_ns + new_ns
    share = both_ns / row.base_ns if row.base_ns else math.inf
    is_within = row.difference_ns is not None and abs(row.difference_ns) <= both_ns
    return replace(
        row,
        base_low_ns=_moved(row.base_low_ns, -base_ns),
        base_high_ns=_moved(row.base_high_ns, base_ns),
        new_low_ns=_moved(row.new_low_ns, -new_ns),
        new_high_ns=_moved(row.new_high_ns, new_ns),
        difference_low_ns=_moved(row.difference_low_ns, -both_ns),
        difference_high_ns=_moved(row.difference_high_ns, both_ns),
        ratio_low=None if row.ratio_low is None else max(0.0, row.ratio_low - share),
        ratio_high=_moved(row.ratio_high, share),
        verdict="inconclusive" if is_within and row.verdict in {"better", "worse"} else row.verdict,
    )


def _moved(end: float | None, by: float) -> float | None:
    return None if end is None else end + by


@dataclass(frozen=True)
class DeliveryRow:
    """Columns of `Comparison.delivery` after the match columns: messages of one matched group on both sides.

    `*_low` and `*_high` are the ends of an interval, `new_*` of the new side what `base_*` is of the base.

    Attributes:
        base_published: messages that were sent.
        base_received_ratio: share of the messages that were received.
        difference: new - base of the received ratio.
        verdict: better, worse, same or inconclusive, adjusted over the groups.
        basis: between runs, or within one run.
        is_dead: whether messages were received on the base and none on the new side.
        environment: same, unknown (no fingerprint), or unlike: with the fields that differ.
        smallest_drop: loss of share that would have been shown with a probability of 80 %.
        p_value: of no difference; null within one run.
        p_adjusted: adjusted over the groups.
    """

    base_published: int
    base_received_ratio: float | None
    base_received_ratio_low: float | None
    base_received_ratio_high: float | None
    new_published: int
    new_received_ratio: float | None
    new_received_ratio_low: float | None
    new_received_ratio_high: float | None
    difference: float | None
    difference_low: float | None
    difference_high: float | None
    verdict: str
    basis: str
    base_runs: int
    new_runs: int
    is_dead: bool
    environment: str
    smallest_drop: float | None
    p_value: float | None
    p_adjusted: float | None


@dataclass(frozen=True)
class DistributionRow:
    """Columns of `Comparison.distributions` after the match columns: one metric of one matched group.

    Each list has the times in ns at the first of `DISTRIBUTION_LEVELS`, infinite for lost messages, as far as the messages suffice.
    """

    metric: str
    base_ns: tuple[float, ...]
    new_ns: tuple[float, ...]


def at_levels(ordered: Values) -> tuple[float, ...]:
    if not len(ordered):
        return ()
    levels = np.asarray(DISTRIBUTION_LEVELS)
    levels = levels[levels <= 1 - 1 / len(ordered)]
    ranks = np.maximum(1, np.ceil(levels * len(ordered) - 1e-9)).astype(np.int64)
    return tuple(float(value) for value in ordered[ranks - 1])


_DTYPES: dict[str, type[pl.DataType] | pl.DataType] = {
    "str": pl.String,
    "int": pl.UInt64,
    "int | None": pl.UInt64,
    "float | None": pl.Float64,
    "bool": pl.Boolean,
    "tuple[float, ...]": pl.List(pl.Float64),
}

COMPARISON_SCHEMA = {field.name: _DTYPES[str(field.type)] for field in fields(ChangeRow)}
DELIVERY_SCHEMA = {field.name: _DTYPES[str(field.type)] for field in fields(DeliveryRow)}
DISTRIBUTION_SCHEMA = {field.name: _DTYPES[str(field.type)] for field in fields(DistributionRow)}
