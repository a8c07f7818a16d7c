"""Where the time of a message goes, from its planned sending to the reply in the callback.

    T0 ..waiting.. T1 ..transport.. R3 ..delivery.. T3 ..relay.. T4 ..transport.. R2 ..delivery.. T2
                   |------- outbound_ns ----------|             |--------- return_ns --------|

R3 and R2 are the middleware's reception stamps, wall clock of the device that received; where they are missing only
the whole `outbound_ns` and `return_ns` are known. The parts add up to `response_ns` exactly.

Clocks are never mixed without a bound. Between two devices it is the clock fit's. Between the wall clock and the
monotonic clock of one device: NTP slews both alike, so they differ by a constant until somebody sets the wall
clock (clock_gettime(2)). The session's anchor says the constant; the stamps check it, because a message is not
delivered before the middleware received it (`received <= T3`), nor stamped by the middleware before it was handed
over (`source >= T4`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from dds_trace.tracefile.format.events import Stage

from ..pairing.pair import MISSING, chosen_of
from ..pairing.roundtrips import MIDDLEWARE_STAMPS, RECEPTION_STAMPS, RoundTrips
from ..statistics.percentiles import minimum_messages, quantile_of
from .batch import exchanges_by_group, filled, is_present

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from ..pairing.exchanges import Exchange
    from ..pairing.roundtrips import PairedRows
    from .batch import Batch

    Int64 = NDArray[np.int64]
    Bools = NDArray[np.bool_]

STAGES = (
    "waiting_ns",
    "outbound_transport_ns",
    "relay_delivery_ns",
    "relay_ns",
    "return_transport_ns",
    "ping_delivery_ns",
)
"""The parts of a response in the order of time."""

_RELAY_SOURCE, _RELAY_RECEIVED = MIDDLEWARE_STAMPS[Stage.T3]
_REPLY_SOURCE, _REPLY_RECEIVED = MIDDLEWARE_STAMPS[Stage.T2]

_CHAIN = ("scheduled_ns", "outbound_ns", "intermediate_ns", "return_ns", "clock_bound_ns")
"""Columns that a message with every part of its chain has a value in."""

_SIDES = 4
"""Deliveries and writes of relay and ping: their anchors are judged from both sides."""

BREAKDOWN_SCHEMA: dict[str, type[pl.DataType]] = {
    "group": pl.UInt32,
    "part": pl.String,
    "order": pl.UInt32,
    "messages": pl.UInt64,
    "mean_ns": pl.Float64,
    "p50_ns": pl.Float64,
    "p99_ns": pl.Float64,
    "bound_ns": pl.Float64,
}

RESPONSE_SCHEMA: dict[str, type[pl.DataType]] = {
    "group": pl.UInt32,
    "messages": pl.UInt64,
    "late_ratio": pl.Float64,
    "waiting_max_ns": pl.Int64,
    "rtt_p50_ns": pl.Float64,
    "response_p50_ns": pl.Float64,
    "rtt_p99_ns": pl.Float64,
    "response_p99_ns": pl.Float64,
    "hidden_p50_ns": pl.Float64,
    "hidden_p99_ns": pl.Float64,
}


def breakdown_frame(batch: Batch, roundtrips: PairedRows) -> pl.DataFrame:
    """Summarize where the time of each group goes, a row per part, for a stacked figure.

    Percentiles of parts of a group do not add up, so a group that is here in part has no rows.

    Returns:
        Columns of `BREAKDOWN_SCHEMA`: `part` (a name of `STAGES`; `outbound_ns` and `return_ns` in place of transports and
        deliveries where a message of the group has no reception stamp of the middleware, or a run contradicts its anchor:
        wall clock set meanwhile), `order` (0, 1, ... in time), `p99_ns` null below 100 messages, `bound_ns` (mean bound from
        the clocks, 0 for parts on one clock; null where only one side of an anchor can be judged: no source stamps, or a
        bridge that writes its own). Only messages with every part of their chain count, so that the means add up to the
        mean response.
    """
    columns = _Columns(roundtrips)
    has_chain = _has_chain(roundtrips)
    bridges = roundtrips.described["bridge"].to_list()
    rows: list[dict[str, object]] = []
    for group, numbers in exchanges_by_group(batch):
        edges = roundtrips.bounds[numbers.start : numbers.stop + 1].tolist()
        messages = _Messages(columns, edges[0], has_chain[edges[0] : edges[-1]])
        if not messages.shown:
            continue
        deliveries = _deliveries(
            messages,
            [
                _OfExchange(
                    batch.exchanges[number],
                    slice(first - edges[0], after - edges[0]),
                    bridges[number] == "none",
                )
                for number, first, after in zip(numbers, edges, edges[1:], strict=False)
            ],
        )
        rows += [
            {
                "group": group,
                "part": part,
                "order": order,
                "messages": messages.shown,
                "mean_ns": float(values_ns.mean()),
                **_percentiles("", values_ns),
                "bound_ns": bound_ns,
            }
            for order, (part, values_ns, bound_ns) in enumerate(_parts(messages, deliveries))
        ]
    return pl.DataFrame(rows, schema=BREAKDOWN_SCHEMA)


def _has_chain(rows: PairedRows) -> Bools:
    """Return whether each message has every part of its chain."""
    has_chain = np.ones(int(rows.bounds[-1]), np.bool_)
    for name in _CHAIN:
        has_chain &= is_present(rows.column(name))
    return has_chain


class _Columns:
    """Columns of rows as arrays, int64, `MISSING` where there is no value.

    Args:
        rows: the rows. What is in memory is filled once; what is read when it is asked for is not kept.
    """

    def __init__(self, rows: PairedRows) -> None:
        self._rows = rows
        self._kept: dict[str, Int64] | None = {} if isinstance(rows, RoundTrips) else None
        # Stamps judge nothing where not both devices have those of reception.
        self.stamps = rows.stamp_names if rows.stamp_names >= RECEPTION_STAMPS else frozenset[str]()

    def __getitem__(self, name: str) -> Int64:
        """Return a column of `PairedRows`."""
        if self._kept is not None and name in self._kept:
            return self._kept[name]
        values = filled(self._rows.column(name), MISSING)
        if name in self.stamps:
            values = np.where(values == 0, MISSING, values)
        if self._kept is not None:
            self._kept[name] = values
        return values


@dataclass(frozen=True, slots=True, eq=False)
class _Messages:
    """The rows of a group.

    Attributes:
        columns: of all rows.
        first: the group's first row.
        has_chain: of each of its messages, whether it has every part of its chain.
    """

    columns: _Columns
    first: int
    has_chain: Bools

    @property
    def shown(self) -> int:
        """Messages with every part of their chain."""
        return int(np.count_nonzero(self.has_chain))

    def column(self, name: str) -> Int64:
        """Return a column of all messages."""
        return self.columns[name][self.first : self.first + len(self.has_chain)]

    def of_shown(self, name: str) -> Int64:
        """Return a column of the messages with every part of their chain."""
        return chosen_of(self.has_chain, self.column(name))


@dataclass(frozen=True, slots=True, eq=False)
class _OfExchange:
    """An exchange of a group.

    Attributes:
        exchange: the exchange.
        here: its messages among those of the group.
        is_direct: whether source stamps are of ping and relay, as without a bridge.
    """

    exchange: Exchange
    here: slice
    is_direct: bool

    @property
    def relay_wall_ns(self) -> int:
        """Wall clock less monotonic clock of the relay, by its anchor."""
        assert self.exchange.relay is not None
        return self.exchange.relay.wall_anchor_ns - self.exchange.relay.monotonic_anchor_ns

    @property
    def ping_wall_ns(self) -> int:
        """The same of the ping."""
        return self.exchange.ping.wall_anchor_ns - self.exchange.ping.monotonic_anchor_ns


@dataclass(frozen=True, slots=True, eq=False)
class _Deliveries:
    """What the middleware's reception stamps say of a group's messages with every part of their chain.

    Attributes:
        relay_ns: R3 to T3 of each.
        ping_ns: R2 to T2 of each.
        bound_ns: mean of how far the anchors of the wall clocks may be off; None where none can be judged.
        with_clock_ns: mean of this and the clocks' bound together.
    """

    relay_ns: Int64
    ping_ns: Int64
    bound_ns: float | None
    with_clock_ns: float | None


def _parts(messages: _Messages, deliveries: _Deliveries | None) -> Iterator[tuple[str, Int64, float | None]]:
    """Yield the name of each part in the order of time, its time in each message, and its mean bound; one by one, for memory."""
    of_shown = messages.of_shown
    clock_ns = float(of_shown("clock_bound_ns").mean())
    yield "waiting_ns", of_shown("publish_ns") - of_shown("scheduled_ns"), 0.0
    if deliveries is None:
        yield "outbound_ns", of_shown("outbound_ns"), clock_ns
    else:
        yield "outbound_transport_ns", of_shown("outbound_ns") - deliveries.relay_ns, deliveries.with_clock_ns
        yield "relay_delivery_ns", deliveries.relay_ns, deliveries.bound_ns
    yield "relay_ns", of_shown("intermediate_ns"), 0.0
    if deliveries is None:
        yield "return_ns", of_shown("return_ns"), clock_ns
    else:
        yield "return_transport_ns", of_shown("return_ns") - deliveries.ping_ns, deliveries.with_clock_ns
        yield "ping_delivery_ns", deliveries.ping_ns, deliveries.bound_ns


def _percentiles(name: str, values_ns: Int64) -> dict[str, float | None]:
    """Return `p50_ns` and `p99_ns` behind a name; what is beyond p99 takes 100 messages."""
    ordered = np.sort(values_ns)
    p99_ns = quantile_of(ordered, 0.99) if len(ordered) >= minimum_messages(0.99) else None
    return {f"{name}p50_ns": quantile_of(ordered, 0.5), f"{name}p99_ns": p99_ns}


def _deliveries(messages: _Messages, exchanges: Iterable[_OfExchange]) -> _Deliveries | None:
    """Return the deliveries of a group; None unless every message that is shown has both, by an anchor that is not contradicted.

    An anchor is judged by the shortest of the deliveries of its exchange and of its writes: nothing arrives or leaves before its
    time. One that were later than the shortest delivery would make that negative, likewise early: so far it may be off.
    """
    has_chain, stamps = messages.has_chain, messages.columns.stamps
    held = [of for of in exchanges if has_chain[of.here].any()]
    if not stamps or any(of.exchange.relay is None for of in held):
        return None
    relay = _Times.of(messages, _RELAY_RECEIVED, "relay_in_ns")
    ping = _Times.of(messages, _REPLY_RECEIVED, "receive_ns")
    if not chosen_of(has_chain, relay.known & ping.known).all():
        return None
    shortest = [
        [relay.least_ns(of.here, of.relay_wall_ns), ping.least_ns(of.here, of.ping_wall_ns)] for of in held
    ]
    # How long after T4 (T1) the middleware stamped the message, by the same anchor.
    relay_walls_ns, ping_walls_ns = [of.relay_wall_ns for of in held], [of.ping_wall_ns for of in held]
    for begin, end, walls_ns in (
        ("relay_out_ns", _REPLY_SOURCE, relay_walls_ns),
        ("publish_ns", _RELAY_SOURCE, ping_walls_ns),
    ):
        if end in stamps:
            writes = _Times.of(messages, begin, end)
            for of, wall_ns, times_ns in zip(held, walls_ns, shortest, strict=True):
                times_ns.append(writes.least_ns(of.here, -wall_ns) if of.is_direct else None)
    found = [[time_ns for time_ns in times_ns if time_ns is not None] for times_ns in shortest]
    if any(min(times_ns) < 0 for times_ns in found):
        return None
    bounds_ns = [max(times_ns) if len(times_ns) == _SIDES else None for times_ns in found]
    relay_ns = [relay.values_ns[of.here][has_chain[of.here]] + of.relay_wall_ns for of in held]
    ping_ns = [ping.values_ns[of.here][has_chain[of.here]] + of.ping_wall_ns for of in held]
    clock_bound_ns = messages.column("clock_bound_ns")
    judged, off_ns, clock_ns = 0, 0, 0
    for of, bound_ns in zip(held, bounds_ns, strict=True):
        if bound_ns is not None:
            shown = has_chain[of.here]
            count = int(np.count_nonzero(shown))
            judged += count
            off_ns += count * bound_ns
            clock_ns += int(clock_bound_ns[of.here][shown].sum())
    return _Deliveries(
        np.concatenate(relay_ns),
        np.concatenate(ping_ns),
        off_ns / judged if judged else None,
        (off_ns + clock_ns) / judged if judged else None,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Times:
    """The time between two instants of each message of a group, on clocks that a wall clock's anchor sets apart.

    Attributes:
        values_ns: end less begin.
        known: whether the message has both.
    """

    values_ns: Int64
    known: Bools

    @classmethod
    def of(cls, messages: _Messages, begin: str, end: str) -> _Times:
        """Return the times between two columns."""
        begin_ns, end_ns = messages.column(begin), messages.column(end)
        return cls(end_ns - begin_ns, (begin_ns != MISSING) & (end_ns != MISSING))

    def least_ns(self, here: slice, wall_ns: int) -> int | None:
        """Return the shortest of some messages, by an anchor that says the begin's clock to be so much ahead; None without any."""
        values_ns = chosen_of(self.known[here], self.values_ns[here])
        return int(values_ns.min()) + wall_ns if len(values_ns) else None


def response_frame(batch: Batch, roundtrips: PairedRows) -> pl.DataFrame:
    """Compare the response times of a user with a fixed schedule with the round trips that stamps show, a row per group.

    A sender that waits for itself (a blocked publish, a slow loop) sends late and then fast: its round trips look
    good and its users wait ("coordinated omission", G. Tene, "How not to measure latency", 2013). The schedule is
    open-loop and T0 is recorded, so the waiting is in `response_ns` and the difference shows it. A group that is here in
    part has no row, as in `breakdown_frame`.

    Returns:
        Columns of `RESPONSE_SCHEMA`: `messages` (with T0 and T2), `late_ratio` (sent more than a tenth of the
        period after T0), `waiting_max_ns`, and for p50, p99 (null below 100 messages): `rtt_*_ns`,
        `response_*_ns` and `hidden_*_ns` = response - rtt.
    """
    names = ("scheduled_ns", "publish_ns", "response_ns", "rtt_ns")
    columns = {name: filled(roundtrips.column(name)) for name in names}
    came = is_present(roundtrips.column("response_ns"))
    rates_hz = roundtrips.described["rate_hz"].to_list()
    rows: list[dict[str, object]] = []
    for group, numbers in exchanges_by_group(batch):
        here = slice(*roundtrips.bounds[[numbers.start, numbers.stop]].tolist())
        scheduled_ns, publish_ns, response_ns, rtt_ns = (
            chosen_of(came[here], values[here]) for values in columns.values()
        )
        if len(response_ns):
            waiting_ns = publish_ns - scheduled_ns
            rate_hz = rates_hz[numbers.start]
            late = waiting_ns > (0.1 * 1e9 / rate_hz if rate_hz else math.inf)
            times = _percentiles("rtt_", rtt_ns) | _percentiles("response_", response_ns)
            rows.append(
                {
                    "group": group,
                    "messages": len(response_ns),
                    "late_ratio": np.count_nonzero(late) / len(late),
                    "waiting_max_ns": int(waiting_ns.max()),
                    **times,
                }
            )
    return pl.DataFrame(rows, schema=RESPONSE_SCHEMA).with_columns(
        (pl.col(f"response_{name}_ns") - pl.col(f"rtt_{name}_ns")).alias(f"hidden_{name}_ns")
        for name in ("p50", "p99")
    )
