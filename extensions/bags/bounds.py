"""The bounds of the rules of evidence, each with what it separates."""

SECOND_NS = 10**9
"""A topic that is silent for less did not stop: late starts, early ends and clocks that are set take longer."""

NOTICED_NS = SECOND_NS // 10
"""Changes of an age and clocks that are set by less are jitter of busy machines."""

FEWEST = 8
"""With fewer messages any times look regular; as many on each side show a level or a phase; more publishers or steps of a clock are noise."""

WINDOW = 32
"""Messages with one rate: a stretch that has another rate for fewer may be losses."""

LONG = 20
"""Longest step in periods that is compared with a grid; least power of a common phase (random times exceed it once in a million)."""

PATTERN = 16
"""Most messages in a pattern that repeats; counters that run faster than that in a hole are of another publisher."""

PHASES = 2000
"""Messages over which the phase of a timer is compared: over more its clock drifts."""

LARGEST = 100_000
"""Largest jump of a counter that is a loss and no restart."""

NEAR = 0.25
"""An interval this near to a multiple of the period is that multiple: half of what separates two multiples."""

REGULAR = 0.35
"""An interval within this of the period is one period; two of them are longer by more."""

OFF = 0.2
"""Stamps off by more, in periods, are on no grid; shares within it differ by chance."""

MOST = 0.95
"""The share that holds for all but exceptions."""

FEW = 0.02
"""The share of exceptions, and the difference of speeds, that chance explains."""

STEADY = 1e-5
"""The spread of an age, in ages, that no late stream has: a constant offset is of another clock."""

P99, FEWEST_FOR_P99 = 0.99, 100
"""A quantile, and the fewest values that show one."""

NORMAL = 1.4826
"""Standard deviation of normal values in median deviations."""
