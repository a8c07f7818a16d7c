"""Clocks of two devices from the stamps of messages, in pure numpy.

- `boots`: boots of a device, and its wall clock.
- `stretches`, `windows`, `lines`, `hulls`: from messages to the straight lines that agree with them.
- `fit`: offset and drift over time, each with its bound.
- `slews`: stretches in which a clock was made to run fast or slow.
"""
