"""The clocks of a recording: which one its times are of, and where one was set or ran over."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dds_trace.base.units import counted, format_duration

from .periods import Int64

DAY_NS = 86_400 * 10**9
_APART_NS = 30 * DAY_NS
_SIMULATED_BEFORE_NS = 10**9 * 10**9  # September 2001: no recorder of today
_JUMP_NS = 10**9
_COUNTERS = {"ns": 1, "us": 1_000, "ms": 1_000_000}


def of_one_clock(log_ns: Int64) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return which ascending log times are of the recording's clock, not at time 0 of a simulation."""
    gaps = np.flatnonzero(np.diff(log_ns) > _APART_NS)
    edges = np.concatenate([[0], gaps + 1, [len(log_ns)]])
    largest = int(np.argmax(np.diff(edges)))
    selected = np.zeros(len(log_ns), bool)
    selected[edges[largest] : edges[largest + 1]] = True
    return selected


def apart(time_ns: float) -> str:
    days = time_ns / DAY_NS
    return f"{days / 365.25:.0f} years" if days > 365.25 else f"{days:.0f} days"


def is_simulated(start_ns: int) -> bool:
    return start_ns < _SIMULATED_BEFORE_NS


def set_back(topic: str, log_ns: Int64) -> Iterator[str]:
    """Yield a note if stored log times go back by more than a second."""
    steps_ns = np.diff(log_ns)
    if len(steps_ns) and steps_ns.min() < -_JUMP_NS:
        times = counted(int((steps_ns < -_JUMP_NS).sum()), "time")
        yield f"{topic} is not stored in order of time: {times} back by up to {format_duration(-int(steps_ns.min()))}"


def stamp_jumps(topic: str, log_ns: Int64, stamp_ns: Int64) -> Iterator[str]:
    steps_ns = np.diff(stamp_ns) - np.diff(log_ns)
    ages_ns = log_ns - stamp_ns
    jumps = np.flatnonzero(np.abs(steps_ns) > _JUMP_NS)
    for unit, unit_ns in _COUNTERS.items():
        size_ns = 2**32 * unit_ns
        over = int((np.abs(steps_ns[jumps] + size_ns) < size_ns // 100).sum())
        if over:
            yield f"stamps of {topic} ran over {counted(over, 'time')}: a counter of 32 bits of {unit}"
            return
    lasting = [
        at
        for at in jumps.tolist()
        if abs(np.median(ages_ns[at + 1 : at + 6]) - np.median(ages_ns[max(at - 4, 0) : at + 1])) > _JUMP_NS
    ]
    if lasting:
        largest = max(lasting, key=lambda at: abs(int(steps_ns[at])))
        yield (
            f"stamps of {topic} jump {counted(len(lasting), 'time')} against the log times, by up to "
            f"{format_duration(abs(int(steps_ns[largest])))}: a clock was set"
        )
