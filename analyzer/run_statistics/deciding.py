"""How many runs it takes until a limit is surely kept or surely broken."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ..statistics.power import runs_to_decide

if TYPE_CHECKING:
    from ..statistics.intervals import Interval
    from .change import Change


def runs_to_settle_ratio(change: Change, limit: float) -> int | None:
    """Return the runs a side after which the interval of a ratio very likely lies on one side of a limit.

    Supposes that the measured ratio is the true one and that further runs spread like those that were measured; it
    then happens with a probability of 80 %.

    Args:
        change: of the two sides.
        limit: a ratio new / base above 0: 1.1 for a gate at +10 %.

    Returns:
        Runs a side in all, not more of them; None within one run, where a ratio is not finite, and where it takes more
        than `power.MOST_RUNS`, because the ratio is next to the limit.
    """
    if change.ratio is None or not 0 < change.ratio < math.inf:
        return None
    spreads = (change.base.unit_spread, change.new.unit_spread)
    if change.pairs:
        spreads = (change.pair_spread, 0.0)
    return _runs(change.ratio / limit, spreads, change.base, change.new)


def runs_to_settle_value(interval: Interval, limit: float) -> int | None:
    """Return the runs after which the interval of a statistic very likely lies on one side of a limit.

    Args:
        interval: of the statistic.
        limit: in its unit, above 0.

    Returns:
        As for `runs_to_settle_ratio`.
    """
    if interval.value is None or not 0 < interval.value < math.inf:
        return None
    return _runs(interval.value / limit, (interval.unit_spread, 0.0), interval)


def _runs(distance: float, spreads: tuple[float | None, float | None], *sides: Interval) -> int | None:
    """Return the units that it takes, times the runs that a unit has."""
    base, new = spreads
    if base is None or new is None:
        return None
    units = runs_to_decide(math.log(distance), base, new, sides[0].confidence)
    runs_of_unit = max(side.runs / side.units for side in sides)
    return None if units is None else math.ceil(round(units * runs_of_unit, 6))
