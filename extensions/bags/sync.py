"""The clock that stamps one topic against the clock that stamps another: offset, course and drift, by the log times of both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dds_trace.analyzer.statistics.distributions import student_quantile
from dds_trace.base.errors import OptionError
from dds_trace.base.limits import nearest
from dds_trace.base.units import UNIT_NS, format_duration

from .bounds import FEWEST, MOST, PATTERN
from .losses import TopicTimes
from .periods import Float64, Int64
from .quantiles import spread
from .recorded import NONE


@dataclass(frozen=True, slots=True)
class Sync:
    """By how much stamps of `topic` are older than `other`'s.

    The offset has the difference of both ways to the recorder; the drift, in ns a ms (ppm), is certain within `drift_bound_ppm` while that
    is steady. `spread_ns` is a robust standard deviation around that line, of `PATTERN` equal parts of the time that both have.
    """

    topic: str
    other: str
    messages: int
    offset_ns: float
    spread_ns: float
    start_ns: float
    end_ns: float
    drift_ppm: float
    drift_bound_ppm: float

    @property
    def words(self) -> str:
        side = "older" if self.offset_ns >= 0 else "newer"
        drift = f"{self.drift_ppm:.3g} ± {self.drift_bound_ppm:.2g} ppm"
        if abs(self.drift_ppm) <= self.drift_bound_ppm:
            drift = f"no drift above {abs(self.drift_ppm) + self.drift_bound_ppm:.2g} ppm"
        return (
            f"stamps of {self.topic} are {format_duration(abs(self.offset_ns))} {side} than {self.other}'s (± {format_duration(self.spread_ns)}; "
            f"{format_duration(self.start_ns)} at the start, {format_duration(self.end_ns)} at the end): {drift}"
        )


def compare_stamps(names: Sequence[str], topics: dict[str, TopicTimes]) -> Sync:
    """Return how the stamps of the first topic go against the second's.

    Raises:
        OptionError: a topic is not there, has no stamps, or both have too few messages in a common time.
    """
    first, other = (_stamped(name, topics) for name in names)
    first_ns, last_ns = max(first[0][0], other[0][0]), min(first[0][-1], other[0][-1])
    edges = np.linspace(first_ns, max(last_ns, first_ns), PATTERN + 1)
    ages = [_by_part(*times, edges) for times in (first, other)]
    offsets, middle_ns = ages[0] - ages[1], (edges[1:] + edges[:-1]) / 2 - first_ns
    if np.isnan(offsets).any():
        raise OptionError(
            f"--sync {','.join(names)}: fewer than {FEWEST} messages of both in one of {PATTERN} parts of their common time; name two faster topics, or take a longer recording"
        )
    slope, level = np.polyfit(middle_ns, offsets, 1)
    residual = offsets - slope * middle_ns - level
    error = np.sqrt((residual**2).sum() / (PATTERN - 2) / ((middle_ns - middle_ns.mean()) ** 2).sum())
    ends = (float(part.mean()) for part in (offsets[:2], offsets[-2:]))
    bound = student_quantile((1 + MOST) / 2, PATTERN - 2) * error
    drifts_ppm = (float(value * UNIT_NS["ms"]) for value in (slope, bound))
    messages = min(len(first[0]), len(other[0]))
    return Sync(names[0], names[1], messages, float(np.median(offsets)), spread(residual), *ends, *drifts_ppm)


def _stamped(name: str, topics: dict[str, TopicTimes]) -> tuple[Int64, Int64]:
    if name not in topics:
        raise OptionError(f"--sync: no topic {name} in the recording; {nearest(name, topics)}")
    is_stamped = topics[name].stamp_ns != NONE
    if not is_stamped.any():
        raise OptionError(f"--sync: the messages of {name} have no stamp")
    return topics[name].log_ns[is_stamped], topics[name].stamp_ns[is_stamped]


def _by_part(log_ns: Int64, stamp_ns: Int64, edges: Float64) -> Float64:
    at = np.searchsorted(log_ns, edges)
    parts = zip(at[:-1].tolist(), at[1:].tolist(), strict=True)
    ages_ns = log_ns - stamp_ns
    return np.array([np.median(ages_ns[a:b]) if b - a >= FEWEST else np.nan for a, b in parts])
