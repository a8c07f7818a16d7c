"""Mean and variance of a few values: numpy's own take three times as long for what they look after."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def mean_and_variance(values: NDArray[np.float64]) -> tuple[float, float]:
    """Return the mean and the unbiased variance of at least two finite values, to the last bit as `mean` and `var(ddof=1)`."""
    count = len(values)
    mean = np.add.reduce(values) / count
    apart = values - mean
    return float(mean), float(np.add.reduce(apart * apart) / (count - 1))
