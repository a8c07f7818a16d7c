"""Which events of each stage, run and relay a trace has."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dds_trace.tracefile.format.events import EVENT_COLUMNS, EventColumns, Stage

EventKey = tuple[Stage, int, int]
"""Stage, run_id and relay_id; the relay_id of T1 is 0 whatever the trace says. Of a tap: 0 and the `publisher_id`."""


class EventsElsewhere(Protocol):
    def load(self) -> EventColumns: ...


@dataclass(frozen=True, slots=True, eq=False)
class EventPart:
    """The events of one stage, run and relay in one trace: `trace` is its index in the campaign."""

    trace: int
    count: int
    first_ns: int
    last_ns: int
    events: EventColumns | EventsElsewhere

    def load(self) -> EventColumns:
        return self.events if isinstance(self.events, EventColumns) else self.events.load()


EventIndex = Mapping[EventKey, tuple[EventPart, ...]]
"""By key, traces in ascending order; a key without events is absent."""


@dataclass(frozen=True, slots=True)
class Copies:
    trace: int
    events: int
    others: tuple[int, ...]


def index_events(traces: Iterable[Mapping[EventKey, EventPart]]) -> EventIndex:
    index: dict[EventKey, tuple[EventPart, ...]] = {}
    for parts in traces:
        for key, part in parts.items():
            index[key] = (*index.get(key, ()), part)
    return index


def split_trace(events: Mapping[Stage, EventColumns], position: int) -> dict[EventKey, EventPart]:
    return {
        (stage, *key): EventPart(
            position, len(columns), int(columns.monotonic_ns.min()), int(columns.monotonic_ns.max()), columns
        )
        for stage in Stage
        for key, columns in split_events(
            events[stage], by_run=stage is not Stage.TAP, by_relay=stage is not Stage.T1
        ).items()
    }


def split_events(columns: EventColumns, *, by_run: bool = True, by_relay: bool) -> dict[tuple[int, int], EventColumns]:
    """Split events of one stage by run_id and relay_id, else 0, in file order; views where the events of a key are adjacent."""
    if not len(columns):
        return {}
    run_id = columns.run_id if by_run else np.zeros_like(columns.run_id)
    relay_id = columns.relay_id if by_relay else np.zeros_like(columns.relay_id)
    changes = (run_id[1:] != run_id[:-1]) | (relay_id[1:] != relay_id[:-1])
    starts = np.concatenate([[0], np.flatnonzero(changes) + 1])
    if len(starts) == 1:
        return {(int(run_id[0]), int(relay_id[0])): columns}

    # Sort stretches instead of events: a ping's file has one stretch a run.
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
        key: EventColumns(**{name: getattr(columns, name)[end - length : end] for name in EVENT_COLUMNS})
        for key, length, end in zip(keys, lengths.tolist(), ends.tolist(), strict=True)
    }


def merge_parts(parts: Sequence[EventPart]) -> tuple[EventColumns, tuple[Copies, ...]]:
    """Return the events of one stage, run and relay, each once, and the copies (of sequence and instant) left out."""
    if not parts:
        return EventColumns.empty(), ()
    loaded = [part.load() for part in parts]
    if len(parts) == 1:
        return loaded[0], ()
    columns = EventColumns.concatenate(loaded)
    owner = np.repeat([part.trace for part in parts], [len(events) for events in loaded])
    order = np.lexsort((owner, columns.monotonic_ns, columns.sequence))
    sequence, instant_ns, owner = columns.sequence[order], columns.monotonic_ns[order], owner[order]
    new = np.ones(len(order), np.bool_)
    new[1:] = (sequence[1:] != sequence[:-1]) | (instant_ns[1:] != instant_ns[:-1])
    if new.all():
        return columns, ()
    keeper = owner[new][np.cumsum(new) - 1]
    copies = []
    for position in np.unique(owner[~new]).tolist():
        copied = ~new & (owner == position)
        others = set(np.unique(keeper[copied]).tolist()) - {position}
        copies.append(Copies(position, int(np.count_nonzero(copied)), tuple(sorted(others))))
    return columns.take(np.sort(order[new])), tuple(copies)


def total_copies(copies: Iterable[Copies]) -> tuple[Copies, ...]:
    events: dict[int, int] = defaultdict(int)
    others: dict[int, set[int]] = defaultdict(set)
    for copied in copies:
        events[copied.trace] += copied.events
        others[copied.trace] |= set(copied.others)
    return tuple(Copies(trace, events[trace], tuple(sorted(others[trace]))) for trace in sorted(events))
