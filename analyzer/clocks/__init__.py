"""Clocks of two devices from the stamps of messages, in pure numpy.

- `boots`: boots of a device, and its wall clock beside its monotonic clock.
- `lines`: stretches without a step, and all straight lines that agree with the messages of a window.
- `fit`: offset and drift over time, each with its bound.
"""
