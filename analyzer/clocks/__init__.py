"""Clocks of two devices from the stamps of messages, in pure numpy.

- `boots`: boots of a device, and its wall clock against its monotonic clock.
- `lines`: stretches without a step, and all straight lines that agree with the messages of a window.
- `fit`: offset and drift over time, each with its bound.
- `slews`: stretches in which a clock was made to run fast, by the steps of a fit or against CLOCK_MONOTONIC_RAW.
"""
