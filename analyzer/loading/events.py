"""Events of all traces by run and relay, fetched when they are wanted, each once however often its file was copied."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from dds_trace.tracefile import EventColumns, Stage

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from dds_trace.tracefile import Trace

Key = tuple[int, int]
"""(run_id, relay_id); the relay_id of T1 is 0 whatever the trace says."""

StageKey = tuple[Stage, int, int]
"""Stage, run_id and relay_id."""


class EventsElsewhere(Protocol):
    """Events that are in a file, or on another machine."""

    def load(self) -> EventColumns:
        """Fetch them."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """The events of one stage, run and relay in one trace.

    Attributes:
        trace: position of the trace.
        count: how many.
        first_ns: the earliest `monotonic_ns`.
        events: the events, or where they are.
    """

    trace: int
    count: int
    first_ns: int
    events: EventColumns | EventsElsewhere

    def load(self) -> EventColumns:
        """The events themselves."""
        return self.events if isinstance(self.events, EventColumns) else self.events.load()


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
    """Where the events of all traces are: `of[stage][run_id, relay_id]`; they are fetched key by key.

    Two events are the same if stage, run, relay, sequence and instant agree: that holds for a copied file,
    for its `ros2 bag convert`, for a copy taken before the recording ended, and for no two recorded events.
    """

    of: Mapping[Stage, Mapping[Key, tuple[Part, ...]]]

    def parts(self, stage: Stage, key: Key) -> tuple[Part, ...]:
        """The traces that hold events of one stage, run and relay, and how many; copies are not yet left out."""
        return self.of[stage].get(key, ())

    def count(self, stage: Stage, key: Key) -> int:
        """Events of one stage, run and relay; copies count."""
        return sum(part.count for part in self.parts(stage, key))

    def first_ns(self, stage: Stage, key: Key) -> int:
        """The earliest `monotonic_ns` of one stage, run and relay, of which there must be events."""
        return min(part.first_ns for part in self.parts(stage, key))

    def traces(self, stage: Stage, key: Key) -> tuple[int, ...]:
        """Positions of the traces that hold events of one stage, run and relay."""
        return tuple(part.trace for part in self.parts(stage, key))

    def columns(self, stage: Stage, key: Key) -> EventColumns:
        """The events of one stage, run and relay, each once; none if there are none."""
        return merge_parts(self.parts(stage, key))[0]

    def in_several(self) -> Iterator[tuple[StageKey, tuple[Part, ...]]]:
        """What several traces, so perhaps copies, hold events of."""
        for stage, held in self.of.items():
            for (run_id, relay_id), parts in held.items():
                if len(parts) > 1:
                    yield (stage, run_id, relay_id), parts


def gather_events(traces: Sequence[Trace]) -> EventsByKey:
    """Sort the events of `traces`, which are in memory, by run and relay."""
    return index_parts(split_trace(trace, position) for position, trace in enumerate(traces))


def index_parts(of_traces: Iterable[Mapping[StageKey, Part]]) -> EventsByKey:
    """Bring together what every trace holds of each run and relay."""
    of: dict[Stage, dict[Key, tuple[Part, ...]]] = {stage: {} for stage in Stage}
    for parts in of_traces:
        for (stage, run_id, relay_id), part in parts.items():
            key = (run_id, relay_id)
            of[stage][key] = (*of[stage].get(key, ()), part)
    return EventsByKey(of)


def split_trace(trace: Trace, position: int) -> dict[StageKey, Part]:
    """The events of one trace, which is in memory, by stage, run and relay."""
    return {
        (stage, *key): Part(position, len(columns), int(columns.monotonic_ns.min()), columns)
        for stage in Stage
        for key, columns in split_events(trace.events[stage], by_relay=stage is not Stage.T1).items()
    }


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


def merge_parts(parts: Sequence[Part]) -> tuple[EventColumns, tuple[Copies, ...]]:
    """The events of one stage, run and relay, each once, and what was left out because another trace holds it."""
    if not parts:
        return EventColumns.empty(), ()
    loaded = [part.load() for part in parts]
    if len(parts) == 1:
        return loaded[0], ()
    columns = EventColumns.concatenate(loaded)
    owner = np.repeat([part.trace for part in parts], [len(held) for held in loaded])
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


def total_copies(found: Iterable[Copies]) -> tuple[Copies, ...]:
    """All copies of each trace in one."""
    events: dict[int, int] = defaultdict(int)
    others: dict[int, set[int]] = defaultdict(set)
    for copies in found:
        events[copies.trace] += copies.events
        others[copies.trace] |= set(copies.others)
    return tuple(Copies(trace, events[trace], tuple(sorted(others[trace]))) for trace in sorted(events))


def _view(columns: EventColumns, part: slice) -> EventColumns:
    arrays: dict[str, Any] = {f.name: getattr(columns, f.name)[part] for f in fields(columns)}
    return EventColumns(**arrays)
