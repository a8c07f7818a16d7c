"""Pairing: the events T1..T4 of one exchange become one row per published message.

Nothing is allocated by the size of a number in a file. Of several events of one message the earliest counts; events that agree in
message and instant are one event.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from enum import Enum
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dds_trace.tracefile.format.events import EventColumns

MISSING = np.iinfo(np.int64).min
"""A missing stamp in int64 arrays, null in frames."""

Scalar = TypeVar("Scalar", bound=np.generic)

_NEVER = np.iinfo(np.int64).max
_UINT32_MAX = np.iinfo(np.uint32).max


class Outcome(Enum):
    COMPLETED = "completed"
    LOST_OUTBOUND = "lost_outbound"
    LOST_IN_RELAY = "lost_in_relay"
    LOST_RETURN = "lost_return"
    LOST_UNKNOWN = "lost_unknown"


OUTCOMES = tuple(Outcome)
LOSSES = tuple(outcome.value for outcome in Outcome if outcome is not Outcome.COMPLETED)
"""Outcomes of messages that did not come back, as the frames spell them."""

_CODE = {outcome: np.uint8(code) for code, outcome in enumerate(OUTCOMES)}


@dataclass(frozen=True, slots=True, eq=False)
class Published:
    """The counted messages of a run, one row each, by sequence number.

    Attributes:
        sequence: uint64, strictly ascending.
        publish_ns: int64, T1.
        scheduled_ns: int64, T0, or MISSING throughout if the run had no schedule.
        with_warmup: distinct messages with a T1, warm-up and those without a reply included.
        repeated: T1 events beyond the first of their message.
    """

    sequence: NDArray[np.uint64]
    publish_ns: NDArray[np.int64]
    scheduled_ns: NDArray[np.int64]
    warmup_messages: int
    with_warmup: int
    repeated: int
    payload_range_bytes: tuple[int, int]

    def __len__(self) -> int:
        return len(self.sequence)

    def take(self, mask: NDArray[np.bool_]) -> Published:
        return replace(
            self, sequence=self.sequence[mask], publish_ns=self.publish_ns[mask], scheduled_ns=self.scheduled_ns[mask]
        )

    def rows(self, sequence: NDArray[np.uint64]) -> NDArray[np.int64]:
        if not len(self):
            return np.full(len(sequence), -1, np.int64)
        first = self.sequence[0]
        if int(self.sequence[-1]) - int(first) < len(self):  # no gaps
            offset = sequence - first  # wraps to something huge below `first`
            return np.where(offset < len(self), offset.astype(np.int64), -1)
        row = np.minimum(np.searchsorted(self.sequence, sequence), len(self) - 1)
        return np.where(self.sequence[row] == sequence, row, -1)


@dataclass(frozen=True, slots=True, eq=False)
class PairedMessages:
    """The fate of a run's counted messages at one relay, in the order of `Published`.

    Attributes:
        receive_ns: int64, T2; MISSING if lost, as are T3 and T4.
        outcome: uint8, index of `OUTCOMES`.
        duplicates: uint16, T2 events beyond the first.
        second_source: bool, its T2 have several source stamps, although the relay sent one reply.
        unclear: bool, more T2 than the relay sent replies, of several source stamps or of none.
        reordered: bool, T2 came after the T2 of a later sequence.
        orphans: T2, T3 and T4 events without a T1, warm-up left out.
    """

    receive_ns: NDArray[np.int64]
    relay_in_ns: NDArray[np.int64]
    relay_out_ns: NDArray[np.int64]
    outcome: NDArray[np.uint8]
    duplicates: NDArray[np.uint16]
    second_source: NDArray[np.bool_]
    unclear: NDArray[np.bool_]
    reordered: NDArray[np.bool_]
    orphans: int

    def take(self, mask: NDArray[np.bool_]) -> PairedMessages:
        columns = {column.name: getattr(self, column.name) for column in fields(self) if column.name != "orphans"}
        return replace(self, **{name: values[mask] for name, values in columns.items()})


def published_messages(t1: EventColumns, warmup_messages: int, ping_every: int = 1) -> Published:
    sequence, publish_ns, scheduled_ns = t1.sequence, t1.monotonic_ns, t1.scheduled_ns
    # Zeros of a recorder without a schedule: no two messages are planned for the boot of the device.
    if len(t1) > 1 and not scheduled_ns.any():
        scheduled_ns = np.full(len(t1), MISSING)
    repeated = 0
    if not bool((sequence[1:] > sequence[:-1]).all()):
        order = np.lexsort((scheduled_ns, publish_ns, sequence))
        sequence, publish_ns, scheduled_ns = sequence[order], publish_ns[order], scheduled_ns[order]
        first = _is_new(sequence)
        distinct = first | _is_new(publish_ns)
        repeated = int(np.count_nonzero(distinct) - np.count_nonzero(first))
        sequence, publish_ns, scheduled_ns = sequence[first], publish_ns[first], scheduled_ns[first]
    counted: slice | NDArray[np.bool_] = slice(int(np.searchsorted(sequence, np.uint64(warmup_messages))), None)
    if ping_every > 1:
        counted = (sequence >= np.uint64(warmup_messages)) & is_pinged(sequence, ping_every)
    return Published(
        sequence=sequence[counted],
        publish_ns=publish_ns[counted],
        scheduled_ns=scheduled_ns[counted],
        warmup_messages=warmup_messages,
        with_warmup=len(sequence),
        repeated=repeated,
        payload_range_bytes=(int(t1.payload_bytes.min(initial=_UINT32_MAX)), int(t1.payload_bytes.max(initial=0))),
    )


def is_pinged(sequence: NDArray[np.uint64], ping_every: int) -> NDArray[np.bool_]:
    pinged: NDArray[np.bool_] = sequence % np.uint64(ping_every) == 0
    return pinged


def pair_messages(published: Published, t2: EventColumns, t3: EventColumns, t4: EventColumns) -> PairedMessages:
    """Pair events of one relay, in any order, warm-up included."""
    receive_ns, extra, orphan_replies = _earliest(published, t2)
    relay_in_ns, _, orphan_arrivals = _earliest(published, t3)
    relay_out_ns, sent_again, orphan_departures = _earliest(published, t4)
    second_source, unclear = _of_other_senders(published, t2, extra, relay_out_ns != MISSING, sent_again)
    if len(receive_ns) and receive_ns[0] != MISSING and (receive_ns[1:] >= receive_ns[:-1]).all():
        outcome = np.full(len(published), _CODE[Outcome.COMPLETED])
        reordered = np.zeros(len(published), np.bool_)
    else:
        outcome = _outcomes(receive_ns, relay_in_ns, relay_out_ns, relay_recorded=len(t3) + len(t4) > 0)
        reordered = _reordered(receive_ns)
    return PairedMessages(
        receive_ns=receive_ns,
        relay_in_ns=relay_in_ns,
        relay_out_ns=relay_out_ns,
        outcome=outcome,
        duplicates=extra,
        second_source=second_source,
        unclear=unclear,
        reordered=reordered,
        orphans=orphan_replies + orphan_arrivals + orphan_departures,
    )


def first_replies(published: Published, t2: EventColumns) -> NDArray[np.int64]:
    """Return the earliest T2 of each message, int64, MISSING without one."""
    return _earliest(published, t2)[0]


def middleware_stamps(
    published: Published, events: EventColumns, instant_ns: NDArray[np.int64]
) -> tuple[NDArray[np.int64], ...]:
    """Return `source_ns` and `received_ns` of each message's T2 or T3 `events` at `instant_ns`, 0 without; () if none has them."""
    if not (events.source_ns.any() or events.received_ns.any()):
        return ()
    if _are_its_own(published, events) and np.array_equal(instant_ns, events.monotonic_ns):
        return events.source_ns, events.received_ns
    source_ns, received_ns = np.zeros(len(published), np.int64), np.zeros(len(published), np.int64)
    row = published.rows(events.sequence)
    paired = np.flatnonzero(row >= 0)
    paired = paired[instant_ns[row[paired]] == events.monotonic_ns[paired]]
    paired = paired[::-1]  # written last, the first of two equal events counts
    source_ns[row[paired]] = events.source_ns[paired]
    received_ns[row[paired]] = events.received_ns[paired]
    return source_ns, received_ns


def _earliest(published: Published, events: EventColumns) -> tuple[NDArray[np.int64], NDArray[np.uint16], int]:
    extra = np.zeros(len(published), np.uint16)
    if _are_its_own(published, events):
        return events.monotonic_ns, extra, 0
    earliest = np.full(len(published), MISSING)
    row, instant_ns = published.rows(events.sequence), events.monotonic_ns
    unplaced = row < 0
    orphans = 0
    if unplaced.any():
        orphans = int(np.count_nonzero(events.sequence[unplaced] >= np.uint64(published.warmup_messages)))
        row, instant_ns = row[~unplaced], instant_ns[~unplaced]
    earliest[row] = instant_ns
    if np.count_nonzero(earliest != MISSING) < len(row):  # some message has several events
        order = np.lexsort((instant_ns, row))
        row, instant_ns = row[order], instant_ns[order]
        first = _is_new(row)
        earliest[row[first]] = instant_ns[first]
        distinct = first | _is_new(instant_ns)
        count = np.bincount(row[distinct & ~first], minlength=len(published))
        extra = np.minimum(count, np.iinfo(np.uint16).max).astype(np.uint16)
    return earliest, extra, orphans


def _of_other_senders(
    published: Published,
    t2: EventColumns,
    extra: NDArray[np.uint16],
    is_sent: NDArray[np.bool_],
    sent_again: NDArray[np.uint16],
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return `second_source` and `unclear`: a sample that is delivered again has the same source stamp."""
    if not extra.any():
        return (np.zeros(len(published), np.bool_),) * 2
    row = published.rows(t2.sequence)
    several = (row >= 0) & (extra[row] > 0)
    row, source_ns = row[several], t2.source_ns[several]
    order = np.lexsort((source_ns, row))
    row, source_ns = row[order], source_ns[order]
    others = np.bincount(row[_is_new(source_ns) & ~_is_new(row)], minlength=len(published))
    is_stamped = np.bincount(row[source_ns != 0], minlength=len(published)) > 0
    return (others > 0) & is_sent & (sent_again == 0), np.where(is_stamped, others, extra) > sent_again


def _are_its_own(published: Published, events: EventColumns) -> bool:
    return np.array_equal(published.sequence, events.sequence)


def _outcomes(
    receive_ns: NDArray[np.int64],
    relay_in_ns: NDArray[np.int64],
    relay_out_ns: NDArray[np.int64],
    *,
    relay_recorded: bool,
) -> NDArray[np.uint8]:
    """Judge by the last stage that saw a message; a T4 without T3 (dropped by the recorder) counts."""
    unseen = Outcome.LOST_OUTBOUND if relay_recorded else Outcome.LOST_UNKNOWN
    return np.select(
        [receive_ns != MISSING, relay_out_ns != MISSING, relay_in_ns != MISSING],
        [_CODE[Outcome.COMPLETED], _CODE[Outcome.LOST_RETURN], _CODE[Outcome.LOST_IN_RELAY]],
        _CODE[unseen],
    )


def _reordered(receive_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    received = np.where(receive_ns == MISSING, _NEVER, receive_ns)
    minimum_from_here = np.minimum.accumulate(received[::-1])[::-1]
    reordered = np.zeros(len(received), np.bool_)
    reordered[:-1] = (minimum_from_here[1:] < received[:-1]) & (receive_ns[:-1] != MISSING)
    return reordered


def chosen_of(mask: NDArray[np.bool_], values: NDArray[Scalar]) -> NDArray[Scalar]:
    return values if mask.all() else values[mask]


def _is_new(values: NDArray[np.generic]) -> NDArray[np.bool_]:
    new = np.ones(len(values), np.bool_)
    new[1:] = values[1:] != values[:-1]
    return new
