"""Student's t, the power of its test, and exact limits of a Poisson count, by scipy, which is loaded at the first call."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from functools import lru_cache
from importlib import import_module
from importlib.util import find_spec, module_from_spec
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

_POWER_STEPS = 2000
_loading = Lock()


def special() -> Any:
    """Return the compiled functions; their package would import much of numpy."""
    name = "scipy.special._ufuncs"
    with _loading:
        if name not in sys.modules and (spec := find_spec("scipy.special")):
            sys.modules[spec.name] = module_from_spec(spec)  # empty
            try:
                import_module(name)
            finally:
                del sys.modules[spec.name]
    return sys.modules[name]


def student_cdf(t: float, degrees: float) -> float:
    """Return the probability of at most `t`; infinite degrees of freedom give the normal distribution."""
    return float(special().ndtr(t) if math.isinf(degrees) else special().stdtr(degrees, t))


@lru_cache(maxsize=4096)
def student_quantile(probability: float, degrees: float) -> float:
    """Return the inverse of `student_cdf`; `stdtrit` of scipy 1.8 has eight digits."""
    if not 0 < probability < 1:
        raise ValueError("a probability must be between 0 and 1, both excluded")
    if math.isinf(degrees):
        return float(special().ndtri(probability))
    beta = float(special().betaincinv(degrees / 2, 0.5, 2 * min(probability, 1 - probability)))
    return math.copysign(math.sqrt(degrees * (1 - beta) / beta), probability - 0.5)


@lru_cache(maxsize=4096)
def shift_for_power(degrees: float, confidence: float = 0.95, power: float = 0.8) -> float:
    """Return the standard errors that a two-sided t test detects with a probability of `power`.

    The power is the mean of `Phi(shift - t u)` over `u**2`, a chi-square variable over its degrees of freedom (noncentral t,
    N. L. Johnson and B. L. Welch, 1940; the far side is left out).
    """
    roots, weights = _estimated_errors(degrees, _POWER_STEPS)
    threshold = student_quantile((1 + confidence) / 2, degrees)
    return _shift_found(lambda shift: float(weights @ special().ndtr(shift - threshold * roots)), power)


@lru_cache(maxsize=4096)
def estimated_shift_for_power(degrees: float, confidence: float = 0.95, power: float = 0.8) -> float:
    """Return the same in errors as other runs estimate them."""
    roots, weights = _estimated_errors(degrees, _POWER_STEPS // 10)
    joint = weights[:, None] * weights
    threshold = student_quantile((1 + confidence) / 2, degrees) * roots
    return _shift_found(lambda shift: float(np.sum(joint * special().ndtr(shift * roots[:, None] - threshold))), power)


def _estimated_errors(degrees: float, steps: int) -> tuple[Float64, Float64]:
    """Return estimated over true standard errors, and their weights, on a grid beyond which the probability is below 1e-9."""
    spread = 8 * math.sqrt(2 / degrees) + 8 / degrees
    logs = np.linspace(-3 * spread, spread, steps)
    log_density = degrees / 2 * (logs - np.exp(logs))
    weights = np.exp(log_density - log_density.max())
    return np.exp(logs / 2), weights / weights.sum()


def _shift_found(power_of: Callable[[float], float], power: float) -> float:
    low, high = 0.0, 2.0
    while power_of(high) < power:
        high *= 2
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if power_of(middle) < power else (low, middle)
    return (low + high) / 2


@lru_cache(maxsize=1024)
def poisson_limits(count: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return exact limits of a Poisson mean after `count` events, each with half of the error (F. Garwood, 1936)."""
    tail, limit = (1 - confidence) / 2, special().gammaincinv
    return float(limit(count, tail)) if count else 0.0, float(limit(count + 1, 1 - tail))
