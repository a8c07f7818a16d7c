"""Events of all traces sorted by run and relay, each event once however often its file was copied."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from tracefile import EventColumns, Stage

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from tracefile import Trace

    Parts = list[tuple[int, EventColumns]]

Key = tuple[int, int]
"""(run_id, relay_id); the relay_id of T1 is 0 whatever the trace says."""


@dataclass(frozen=True, slots=True, eq=False)
class Gathered:
    """The events of one stage, run and relay.

    Attributes:
        columns: each event once.
        traces: positions of the traces that hold any of them.
    """

    columns: EventColumns
    traces: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Copies:
    """Events of one trace that an earlier one holds as well.

    Attributes:
        trace: position of the trace.
        events: how many of its events were left out for that reason.
        others: positions of the traces that hold them.
    """

    trace: int
    events: int
    others: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class EventsByKey:
    """The events of all traces: `of[stage][run_id, relay_id]`, and what was counted once only."""

    of: Mapping[Stage, Mapping[Key, Gathered]]
    copies: tuple[Copies, ...]

    def columns(self, stage: Stage, key: Key) -> EventColumns:
        """The events of one stage, run and relay; none if there are none."""
        found = self.of[stage].get(key)
        return found.columns if found else EventColumns.empty()

    def traces(self, stage: Stage, key: Key) -> tuple[int, ...]:
        """Positions of the traces that hold events of one stage, run and relay."""
        found = self.of[stage].get(key)
        return found.traces if found else ()


def gather_events(traces: Sequence[Trace]) -> EventsByKey:
    """Sort the events of `traces` by run and relay; an event that several traces hold is counted once.

    Two events are the same if stage, run, relay, sequence and instant agree: that holds for a copied file,
    for its `ros2 bag convert`, for a copy taken before the recording ended, and for no two recorded events.
    """
    tally: dict[int, _Tally] = defaultdict(_Tally)
    of: dict[Stage, dict[Key, Gathered]] = {}
    for stage in Stage:
        parts: dict[Key, Parts] = defaultdict(list)
        for position, trace in enumerate(traces):
            for key, columns in split_events(trace.events[stage], by_relay=stage is not Stage.T1).items():
                parts[key].append((position, columns))
        of[stage] = {key: _merged(found, tally) for key, found in parts.items()}
    copies = tuple(
        Copies(position, held.events, tuple(sorted(held.others))) for position, held in sorted(tally.items())
    )
    return EventsByKey(of, copies)


def split_events(columns: EventColumns, *, by_relay: bool) -> dict[Key, EventColumns]:
    """The events of each run (and relay), in file order; views where a run's events stand together in the file."""
    if not len(columns):
        return {}
    run_id = columns.run_id
    relay_id = columns.relay_id if by_relay else np.zeros_like(columns.relay_id)
    changes = (run_id[1:] != run_id[:-1]) | (relay_id[1:] != relay_id[:-1])
    starts = np.concatenate([[0], np.flatnonzero(changes) + 1])

    # Sorting stretches instead of events: a ping's file has one stretch a run.
    runs, run_code = np.unique(run_id[starts], return_inverse=True)
    relays, relay_code = np.unique(relay_id[starts], return_inverse=True)
    codes, stretch_code = np.unique(run_code * len(relays) + relay_code, return_inverse=True)
    keys = [(int(runs[code // len(relays)]), int(relays[code % len(relays)])) for code in codes]
    lengths = np.diff(starts, append=len(columns))
    if len(starts) > len(codes):  # several pings at one relay take turns
        code = np.repeat(stretch_code, lengths).astype(np.min_scalar_type(len(codes)))
        columns = columns.take(np.argsort(code, kind="stable"))
        lengths = np.bincount(code, minlength=len(codes))
    else:
        keys = [keys[code] for code in stretch_code]
    ends = np.cumsum(lengths)
    return {
        key: _view(columns, slice(end - length, end))
        for key, length, end in zip(keys, lengths.tolist(), ends.tolist(), strict=True)
    }


@dataclass(slots=True)
class _Tally:
    """What was left out of one trace so far."""

    events: int = 0
    others: set[int] = field(default_factory=set)


def _merged(parts: Parts, tally: Mapping[int, _Tally]) -> Gathered:
    traces = tuple(position for position, _ in parts)
    if len(parts) == 1:
        return Gathered(parts[0][1], traces)
    columns = EventColumns.concatenate(part for _, part in parts)
    owner = np.repeat(traces, [len(part) for _, part in parts])
    order = np.lexsort((owner, columns.monotonic_ns, columns.sequence))
    sequence, instant_ns, owner = columns.sequence[order], columns.monotonic_ns[order], owner[order]
    new = np.ones(len(order), np.bool_)
    new[1:] = (sequence[1:] != sequence[:-1]) | (instant_ns[1:] != instant_ns[:-1])
    if new.all():
        return Gathered(columns, traces)
    keeper = owner[new][np.cumsum(new) - 1]
    for position in np.unique(owner[~new]).tolist():
        copied = ~new & (owner == position)
        tally[position].events += int(np.count_nonzero(copied))
        tally[position].others |= set(np.unique(keeper[copied]).tolist()) - {position}
    return Gathered(columns.take(np.sort(order[new])), traces)


def _view(columns: EventColumns, part: slice) -> EventColumns:
    arrays: dict[str, Any] = {f.name: getattr(columns, f.name)[part] for f in fields(columns)}
    return EventColumns(**arrays)
