"""Series whose correlation is known."""

from __future__ import annotations

import math

import numpy as np


def autoregressive(messages: int, correlation: float, seed: int):
    """Normal values whose neighbours correlate; the first 200 are thrown away."""
    noise = np.random.default_rng(seed).standard_normal(messages + 200)
    values = np.empty(messages + 200)
    values[0] = noise[0]
    for i in range(1, messages + 200):
        values[i] = correlation * values[i - 1] + math.sqrt(1 - correlation**2) * noise[i]
    return values[200:]
