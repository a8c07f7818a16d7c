"""Student's t, the power of its test, and exact limits of a Poisson count, without scipy."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from statistics import NormalDist

import numpy as np

_NORMAL = NormalDist()
_MOST_TERMS = 500
_HALVINGS = 200  # to 1e-60 of an interval
_POWER_STEPS = 2000


def student_cdf(t: float, degrees: float) -> float:
    """Return the probability of at most `t`; infinite degrees of freedom give the normal distribution.

    By the regularized incomplete beta function (M. Abramowitz and I. Stegun, 1964, 26.7.1).
    """
    if math.isinf(t):
        return 1.0 if t > 0 else 0.0
    if math.isinf(degrees):
        return _NORMAL.cdf(t)
    beyond = incomplete_beta(degrees / (degrees + t * t), degrees / 2, 0.5) / 2
    return 1 - beyond if t > 0 else beyond


@lru_cache(maxsize=4096)
def student_quantile(probability: float, degrees: float) -> float:
    """Relative error below 1e-9."""
    if not 0 < probability < 1:
        raise ValueError("a probability must be between 0 and 1, both excluded")
    if math.isinf(degrees):
        return _NORMAL.inv_cdf(probability)
    if probability < 0.5:
        return -student_quantile(1 - probability, degrees)
    # Newton's method on the tail, which keeps its digits: steps from the normal's quantile stay on this side of the root.
    tail, t = 1 - probability, _NORMAL.inv_cdf(probability)
    for _ in range(_MOST_TERMS):
        step = (student_cdf(-t, degrees) - tail) / _student_density(t, degrees)
        t += step
        if step <= 1e-13 * t:
            break
    return t


def _student_density(t: float, degrees: float) -> float:
    log_front = math.lgamma((degrees + 1) / 2) - math.lgamma(degrees / 2) - math.log(degrees * math.pi) / 2
    return math.exp(log_front - (degrees + 1) / 2 * math.log1p(t * t / degrees))


@lru_cache(maxsize=4096)
def shift_for_power(degrees: float, confidence: float = 0.95, power: float = 0.8) -> float:
    """Return the standard errors that a two-sided t test detects with a probability of `power`.

    The power is the mean of `Phi(shift - t u)` over `u**2`, a chi-square variable over its degrees of freedom (noncentral t,
    N. L. Johnson and B. L. Welch, 1940; the far side is left out).
    """
    threshold = student_quantile((1 + confidence) / 2, degrees)
    # log(chi-square) on a grid beyond which the probability is below 1e-9.
    spread = 8 * math.sqrt(2 / degrees) + 8 / degrees
    logs = np.linspace(-3 * spread, spread, _POWER_STEPS)
    log_density = degrees / 2 * (logs - np.exp(logs))
    weights = np.exp(log_density - log_density.max())
    weights /= weights.sum()
    roots = np.exp(logs / 2)

    def missing(shift: float) -> float:
        powers = list(map(math.erf, ((shift - threshold * roots) / math.sqrt(2)).tolist()))
        return (1 + float(np.dot(weights, powers))) / 2 - power

    high = 2.0
    while missing(high) < 0:
        high *= 2
    return _root(missing, 0.0, high, halvings=40)


@lru_cache(maxsize=1024)
def poisson_limits(count: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return exact limits of a Poisson mean after `count` events, each with half of the error (F. Garwood, 1936)."""
    tail = (1 - confidence) / 2
    high = count + 10 * math.sqrt(count + 1) - math.log(tail)
    upper = _root(lambda mean: tail - poisson_cdf(count, mean), float(count), high)
    if not count:
        return 0.0, upper
    return _root(lambda mean: 1 - poisson_cdf(count - 1, mean) - tail, 0.0, float(count)), upper


def poisson_cdf(count: int, mean: float) -> float:
    if mean <= 0:
        return 1.0
    return math.fsum(math.exp(k * math.log(mean) - mean - math.lgamma(k + 1)) for k in range(count + 1))


def chi_square_cdf(value: float, degrees: float) -> float:
    """Return the probability of at most `value` (NIST DLMF 8.7.1)."""
    if value <= 0:
        return 0.0
    if value > degrees + 20 * math.sqrt(2 * degrees) + 100:  # beyond it is below 1e-20, and the series overflows
        return 1.0
    half, exponent = value / 2, degrees / 2
    term = total = 1 / exponent
    index = exponent
    while term > 1e-16 * total:
        index += 1
        term *= half / index
        total += term
    return min(1.0, total * math.exp(exponent * math.log(half) - half - math.lgamma(exponent)))


def incomplete_beta(x: float, a: float, b: float) -> float:
    """Return the regularized `I_x(a, b)` (NIST DLMF 8.17.22, by Lentz's method)."""
    if x <= 0 or x >= 1:
        return 0.0 if x <= 0 else 1.0
    if x > (a + 1) / (a + b + 2):  # where the continued fraction of the other tail converges faster
        return 1 - incomplete_beta(1 - x, b, a)
    log_front = math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b) + a * math.log(x) + b * math.log1p(-x)
    return math.exp(log_front) / (a * _beta_fraction(x, a, b))


def _beta_fraction(x: float, a: float, b: float) -> float:
    tiny = 1e-300
    value = ratio = 1.0
    inverse = 0.0
    for term in range(1, _MOST_TERMS):
        m = term // 2
        if term % 2:
            step = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1))
        else:
            step = m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m))
        inverse = 1 / (1 + step * inverse or tiny)
        ratio = 1 + step / ratio or tiny
        value *= ratio * inverse
        if abs(ratio * inverse - 1) < 1e-15:
            break
    return value


def _root(rising: Callable[[float], float], low: float, high: float, halvings: int = _HALVINGS) -> float:
    for _ in range(halvings):
        middle = (low + high) / 2
        if middle in (low, high):
            break
        if rising(middle) < 0:
            low = middle
        else:
            high = middle
    return (low + high) / 2
