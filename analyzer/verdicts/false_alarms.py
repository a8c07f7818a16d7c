"""The false-alarm rate of a comparison, measured with two sides that are the same (A/A).

Every pass has one run of each side, and in an A/A sweep either could have been the base. So the passes are dealt anew to
the two sides in every way there is, each way is compared, and what is called better or worse is false. That is more than
one comparison can say, and less than as many sweeps would: the ways share their runs.
"""

from __future__ import annotations

import itertools
import random
from dataclasses import dataclass
from typing import TYPE_CHECKING

import polars as pl

from .compare import CompareOptions, compare_roundtrips

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from .compare import Comparison

MOST_DEALS = 64
"""Ways to deal the passes that are compared at most; of more, these are drawn."""

_ALARMS = ("better", "worse")


@dataclass(frozen=True, slots=True)
class FalseAlarms:
    """What the comparison of a thing with itself has said.

    Attributes:
        measured: verdicts better or worse of the two sides as they were recorded.
        of_measured: verdicts of that comparison.
        dealt: verdicts better or worse over all ways to deal the passes.
        of_dealt: verdicts of all these comparisons.
        deals: ways that were compared, the recorded one included.
    """

    measured: int
    of_measured: int
    dealt: int
    of_dealt: int
    deals: int

    @property
    def rate(self) -> float:
        """Share of the verdicts of all ways that are false alarms; 0 without a verdict."""
        return self.dealt / self.of_dealt if self.of_dealt else 0.0


def count_false_alarms(
    base: pl.DataFrame, new: pl.DataFrame, passes: Mapping[int, int], options: CompareOptions | None = None
) -> FalseAlarms:
    """Compare two sides of an A/A sweep in every way to deal their passes, and count what is called better or worse.

    Args:
        base: round trips of one side.
        new: round trips of the other.
        passes: run_id -> pass, of both sides; the rows of other runs stay on their side.
        options: how to compare; None for the defaults, pass by pass.
    """
    options = options or CompareOptions(paired=True)
    pass_of_row = pl.col("run_id").replace_strict(
        list(passes), list(passes.values()), default=None, return_dtype=pl.Int64
    )
    rows = pl.concat(
        [
            side.with_columns(_pass=pass_of_row, _is_new=pl.lit(is_new))
            for side, is_new in ((base, False), (new, True))
        ]
    ).sort("_pass", maintain_order=True, nulls_last=True)
    counts = []
    for swapped in _deals(sorted(set(passes.values()))):
        is_new = pl.col("_is_new") ^ pl.col("_pass").is_in(list(swapped)).fill_null(value=False)
        of_base, of_new = (rows.filter(is_new == side).drop("_pass", "_is_new") for side in (False, True))
        counts.append(_count(compare_roundtrips(of_base, of_new, options, passes=passes)))
    (measured, of_measured) = counts[0]
    return FalseAlarms(
        measured=measured,
        of_measured=of_measured,
        dealt=sum(alarms for alarms, _ in counts),
        of_dealt=sum(verdicts for _, verdicts in counts),
        deals=len(counts),
    )


def _deals(passes: list[int]) -> Iterator[tuple[int, ...]]:
    """Yield passes whose sides are exchanged, none of them first; the first pass never is, as that is its mirror image."""
    others = passes[1:]
    if 2 ** len(others) <= MOST_DEALS:
        for size in range(len(others) + 1):
            yield from itertools.combinations(others, size)
        return
    yield ()
    chance = random.Random(0)  # noqa: S311 - an order, not a secret
    drawn: set[tuple[int, ...]] = {()}
    while len(drawn) < MOST_DEALS:
        deal = tuple(number for number in others if chance.random() < 0.5)
        if deal not in drawn:
            drawn.add(deal)
            yield deal


def _count(comparison: Comparison) -> tuple[int, int]:
    verdicts = comparison.rows["verdict"]
    return int(verdicts.is_in(_ALARMS).sum()), len(verdicts)
