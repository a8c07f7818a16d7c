"""The rows of a comparison: what is known of one statistic of a matched group, and of its messages on both sides."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

if TYPE_CHECKING:
    from ...run_statistics.runs import Values

DISTRIBUTION_LEVELS = (0.0, 0.01, 0.025, *(n / 20 for n in range(1, 20)), 0.975, 0.99, 0.995, 0.999)
"""Shares of messages at which the distributions of two sides are given."""


@dataclass(frozen=True, slots=True)
class ChangeRow:
    """The columns of `Comparison.rows` behind the match columns: one statistic of one metric of one matched group.

    Times are in ns, infinite where more messages were lost than the statistic leaves room for; `..._survivors_ns` is the
    same of the messages that came back, whose number is `..._messages`. `superiority` and `cliffs_delta` are of the
    metric, not of the statistic; delta is positive where new is faster. `p_adjusted` is adjusted over the groups;
    `smallest_ratio` would have been found with a probability of 80 %. Null is what the samples do not support.
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


@dataclass(frozen=True, slots=True)
class DeliveryRow:
    """The columns of `Comparison.delivery` behind the match columns: messages of one matched group on both sides.

    `smallest_drop` of the received ratio would have been found with a probability of 80 %; `environment` is `same`, `unlike:` with the fields of the fingerprints that differ, or `unknown` without a fingerprint.
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


@dataclass(frozen=True, slots=True)
class DistributionRow:
    """The columns of `Comparison.distributions` behind the match columns: one metric of one matched group.

    Each list has the times in ns at the first of `DISTRIBUTION_LEVELS`, infinite for lost messages; it ends where the
    messages are too few for the next level.
    """

    metric: str
    base_ns: tuple[float, ...]
    new_ns: tuple[float, ...]


def at_levels(ordered: Values) -> tuple[float, ...]:
    """Return values at the first of `DISTRIBUTION_LEVELS`, to the last that so many values support.

    Args:
        ordered: rising, infinity for a lost message.
    """
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
"""Annotation of a field of the rows above -> dtype of its column."""

COMPARISON_SCHEMA = {field.name: _DTYPES[str(field.type)] for field in fields(ChangeRow)}
DELIVERY_SCHEMA = {field.name: _DTYPES[str(field.type)] for field in fields(DeliveryRow)}
DISTRIBUTION_SCHEMA = {field.name: _DTYPES[str(field.type)] for field in fields(DistributionRow)}
