"""The wall clock of a recording against its monotonic one, at every event with a reception stamp.

A message is received before its event, so `received_ns - monotonic_ns` is below the wall clock at monotonic zero by what the event waited.
The largest difference of a second shows where the wall clock was set; a shorter wait of a second is no such thing.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import polars as pl

from dds_trace.base.units import SECOND_NS
from dds_trace.tracefile.format.descriptions import Session
from dds_trace.tracefile.format.events import Stage

from ..clocks.fit import Int64
from ..loading.campaign import Campaign
from ..loading.event_index import EventPart

ANCHOR_NS = 5_000
"""Error of reading wall and monotonic clock one after the other."""

_WAIT_NS, _NOISES = 200_000, 6
"""By so much the shortest waits of two seconds differ without load, and by so many times their usual difference under it."""

_LASTING_SECONDS = 5
"""Seconds of equally late events that a clock set back explains, and waiting for a processor does not."""


@dataclass(frozen=True, slots=True, eq=False)
class WallReadings:
    """Seconds of a recording: first and last event on the monotonic clock, wall clock at monotonic zero, and its largest error."""

    session: Session
    first_ns: Int64
    last_ns: Int64
    zero_ns: Int64
    bound_ns: Int64

    @property
    def steps_ns(self) -> Int64:
        """Changes of the wall clock from each second to the next, 0 where their errors explain them."""
        zero_ns = self.session.wall_anchor_ns - self.session.monotonic_anchor_ns
        step_ns = np.diff(self.zero_ns, prepend=zero_ns)
        return np.where(np.abs(step_ns) > self.bound_ns + np.append(ANCHOR_NS, self.bound_ns[:-1]), step_ns, 0)


def follow_wall_clocks(campaign: Campaign) -> Iterator[WallReadings]:
    parts: dict[int, list[EventPart]] = defaultdict(list)
    for (stage, _, _), parts_of_key in campaign.events.items():
        for part in parts_of_key if stage in (Stage.TAP, Stage.T2, Stage.T3) else ():
            parts[part.trace].append(part)
    for trace, parts_of_trace in parts.items():
        sessions = campaign.traces[trace].sessions
        if len({(session.device, session.extra.get("boot_id")) for session in sessions}) == 1:
            events = [part.load() for part in parts_of_trace]
            at_ns, wall_ns = (
                np.concatenate([getattr(one, f"{n}_ns") for one in events]) for n in ("monotonic", "received")
            )
            seconds = (
                pl.DataFrame({"at": at_ns, "zero": wall_ns - at_ns})
                .filter(pl.Series(wall_ns > 0))
                .group_by(pl.col("at") // SECOND_NS)
                .agg(first=pl.col("at").min(), last=pl.col("at").max(), zero=pl.col("zero").max())
                .sort("first")
            )
            if len(seconds) > 1:
                yield _read(sessions[0], *(seconds[name].to_numpy() for name in ("first", "last", "zero")))


def _read(session: Session, first_ns: Int64, last_ns: Int64, latest_ns: Int64) -> WallReadings:
    anchor_ns = session.wall_anchor_ns - session.monotonic_anchor_ns
    wait_ns = anchor_ns - latest_ns
    usual_ns = int(min(wait_ns[wait_ns >= 0], default=0))
    noise_ns = np.median(np.abs(np.diff(latest_ns, 2))) / 2 if len(latest_ns) > 2 else 0.0
    slack_ns = int(_WAIT_NS + _NOISES * noise_ns)
    is_late = wait_ns > usual_ns + slack_ns
    is_set = wait_ns < -ANCHOR_NS
    for start in range(len(is_late) - _LASTING_SECONDS + 1):
        part = slice(start, start + _LASTING_SECONDS)
        is_set[part] |= is_late[part].all() and np.ptp(latest_ns[part]) < slack_ns
    is_late_to_the_end = np.logical_and.accumulate(is_late[::-1])[::-1]
    unsure_ns = np.where(is_set, slack_ns, np.where(is_late_to_the_end, wait_ns, ANCHOR_NS))
    return WallReadings(session, first_ns, last_ns, np.where(is_set, latest_ns + usual_ns, anchor_ns), unsure_ns)
