"""How often a message of one side is faster than one of the other."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .runs import Values


def probability_of_superiority(base: Values, new: Values) -> float | None:
    """Return how often a value drawn from `new` is below one drawn from `base`, ties counted half; None without values.

    One half means no difference, 1 that every new message is faster than every one of the base (R. McGraw and S. Wong,
    "A common language effect size statistic", Psychological Bulletin 111, 1992).

    Args:
        base: rising, infinity for a lost message.
        new: likewise.
    """
    if not len(base) or not len(new):
        return None
    # Looked up in rising order: neighbours of one search are still in the cache at the next.
    not_above = np.searchsorted(base, new, side="right")
    ties = not_above - np.searchsorted(base, new, side="left")
    above = len(base) - not_above
    return float((above + ties / 2).mean() / len(base))
