"""The bounds of the rules of evidence, each with what it separates."""

from __future__ import annotations

from dds_trace.base.units import SECOND_NS

NOTICED_NS = SECOND_NS // 10
"""Changes of an age and clocks that are set by less are jitter of busy machines."""

DAY_NS = 86_400 * SECOND_NS
"""Ages below may be of a queue; stamps farther away are of another clock."""

FEWEST = 8
"""With fewer messages any times look regular; as many on each side show a level or a phase; more publishers, steps of a clock or moves of pages are noise."""

WINDOW = 32
"""Messages with one rate: a stretch that has another rate for fewer may be losses."""

PATTERN = 16
"""Most messages in a pattern that repeats, fewest with a rate of their own; counters that run faster in a hole are another publisher's.

Longer steps are compared with no grid; least power of a common phase (random times exceed it once in ten million).
"""

PHASES = 2000
"""Messages over which the phase of a timer is compared: over more its clock drifts."""

NEAR = 0.25
"""What is this near to a multiple of the period is that multiple: half of what separates two; shares within it differ by chance."""

REGULAR = 0.35
"""An interval within this of the period is one period; two of them are longer by more."""

MOST = 0.95
"""The share that holds for all but exceptions."""

FEW = 0.02
"""The share of exceptions, and the difference of speeds, that chance explains."""

STEADY = 1e-5
"""The spread of an age, in ages, that no late stream has: a constant offset is of another clock."""

SHOWN = 3
"""Holes, pauses, chains and damages that are listed, the largest; the rest is counted."""
