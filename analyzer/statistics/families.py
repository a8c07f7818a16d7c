"""Many tests at once: p values adjusted for how many there are."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Float64 = NDArray[np.float64]


def holm_adjusted(p_values: Sequence[float] | Float64) -> Float64:
    """Return p values that bound the probability of a single false alarm in the whole family.

    The i-th smallest of m becomes the largest `(m - j + 1) p_j` of those up to it (S. Holm, Scandinavian Journal of
    Statistics 6, 1979). It holds whatever the dependence of the tests.

    Args:
        p_values: of the tests, each between 0 and 1, shape (tests,).

    Returns:
        float64, in the order of the tests, at most 1.
    """
    values = np.asarray(p_values, np.float64)
    order = np.argsort(values, kind="stable")
    steps = np.maximum.accumulate(values[order] * np.arange(len(values), 0, -1))
    return _in_order(np.minimum(steps, 1.0), order)


def benjamini_hochberg_adjusted(p_values: Sequence[float] | Float64) -> Float64:
    """Return p values that bound the expected share of false alarms among all alarms.

    The i-th smallest of m becomes the smallest `m p_j / j` of those from it on (Y. Benjamini and Y. Hochberg, JRSS B
    57, 1995). It holds for tests that are independent or positively dependent, as those of one base are.

    Args:
        p_values: of the tests, each between 0 and 1, shape (tests,).

    Returns:
        float64, in the order of the tests, at most 1.
    """
    values = np.asarray(p_values, np.float64)
    m = len(values)
    order = np.argsort(values, kind="stable")
    steps = values[order] * m / np.arange(1, m + 1)
    falling = np.minimum.accumulate(steps[::-1])[::-1]
    return _in_order(np.minimum(falling, 1.0), order)


def _in_order(sorted_values: Float64, order: NDArray[np.intp]) -> Float64:
    found = np.empty_like(sorted_values)
    found[order] = sorted_values
    return found
