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

from dds_trace.tracefile import Stage

from ..pairing.pair import MISSING, chosen_of
from ..pairing.roundtrips import MIDDLEWARE_STAMPS
from ..statistics.percentiles import minimum_messages, quantile_of
from .batch import exchanges_by_group, filled

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from numpy.typing import NDArray

    from ..pairing.exchanges import Exchange
    from ..pairing.roundtrips import RoundTrips
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

_RECEIVED = {_RELAY_RECEIVED, _REPLY_RECEIVED}

_INSTANTS = ("publish_ns", "relay_in_ns", "relay_out_ns", "receive_ns")

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


def breakdown_frame(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
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
    messages = _Messages.of(roundtrips)
    bridges = roundtrips.described["bridge"].to_list()
    rows: list[dict[str, object]] = []
    for group, numbers in exchanges_by_group(batch):
        edges = roundtrips.bounds[numbers.start : numbers.stop + 1].tolist()
        of_group = messages.between(edges[0], edges[-1])
        if not of_group.shown:
            continue
        deliveries = _deliveries(
            (batch.exchanges[number], messages.between(first, after), bridges[number] == "none")
            for number, first, after in zip(numbers, edges, edges[1:], strict=False)
        )
        rows += [
            {
                "group": group,
                "part": part,
                "order": order,
                "messages": of_group.shown,
                "mean_ns": float(values_ns.mean()),
                **_percentiles("", values_ns),
                "bound_ns": bound_ns,
            }
            for order, (part, values_ns, bound_ns) in enumerate(_parts(of_group, deliveries))
        ]
    return pl.DataFrame(rows, schema=BREAKDOWN_SCHEMA)


@dataclass(frozen=True, slots=True, eq=False)
class _Messages:
    """Rows that follow one another.

    Attributes:
        columns: int64, `MISSING` where there is no value; the middleware's stamps where both devices have those of reception.
        has_chain: whether a message has every part of its chain.
        shown: how many have.
    """

    columns: Mapping[str, Int64]
    has_chain: Bools
    shown: int

    @classmethod
    def of(cls, roundtrips: RoundTrips) -> _Messages:
        """Return all rows of a batch."""
        measured = roundtrips.measured
        has_chain = measured.select(pl.all_horizontal(pl.col(_CHAIN).is_not_null())).to_series().to_numpy()
        columns = {name: filled(measured[name], MISSING) for name in (*_CHAIN, *_INSTANTS)}
        stamps = {series.name: filled(series) for series in roundtrips.stamps}
        if stamps.keys() >= _RECEIVED:  # else nothing is judged by them
            columns |= {name: np.where(values == 0, MISSING, values) for name, values in stamps.items()}
        return cls(columns, has_chain, int(np.count_nonzero(has_chain)))

    def between(self, first: int, after: int) -> _Messages:
        """Return some of the rows."""
        has_chain = self.has_chain[first:after]
        columns = {name: values[first:after] for name, values in self.columns.items()}
        return _Messages(columns, has_chain, int(np.count_nonzero(has_chain)))

    def of_shown(self, name: str) -> Int64:
        """Return a column of the messages with every part of their chain."""
        return chosen_of(self.has_chain, self.columns[name])


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


def _deliveries(exchanges: Iterable[tuple[Exchange, _Messages, bool]]) -> _Deliveries | None:
    """Return the deliveries of a group; None unless every message that is shown has both, by an anchor that is not contradicted.

    Args:
        exchanges: of the group, each with its messages and whether source stamps are of ping and relay, as without a bridge.
    """
    relay_ns, ping_ns, judged, off_ns, clock_ns = [], [], 0, 0, 0
    for exchange, messages, is_direct in exchanges:
        if not messages.shown:
            continue
        anchors = _judge(exchange, messages, is_direct=is_direct)
        if anchors is None:
            return None
        relay_ns.append(
            messages.of_shown("relay_in_ns") - (messages.of_shown(_RELAY_RECEIVED) - anchors.relay_wall_ns)
        )
        ping_ns.append(
            messages.of_shown("receive_ns") - (messages.of_shown(_REPLY_RECEIVED) - anchors.ping_wall_ns)
        )
        if anchors.bound_ns is not None:
            judged += messages.shown
            off_ns += messages.shown * anchors.bound_ns
            clock_ns += int(messages.of_shown("clock_bound_ns").sum())
    return _Deliveries(
        np.concatenate(relay_ns),
        np.concatenate(ping_ns),
        off_ns / judged if judged else None,
        (off_ns + clock_ns) / judged if judged else None,
    )


@dataclass(frozen=True, slots=True)
class _Anchors:
    """The anchors of an exchange that its stamps agree with.

    Attributes:
        relay_wall_ns: wall clock less monotonic clock of the relay.
        ping_wall_ns: the same of the ping.
        bound_ns: how far they may be off: one that were later than the shortest delivery would make that negative, likewise
            early. None where only one side can be judged.
    """

    relay_wall_ns: int
    ping_wall_ns: int
    bound_ns: int | None


def _judge(exchange: Exchange, messages: _Messages, *, is_direct: bool) -> _Anchors | None:
    """Judge the anchors of an exchange by the shortest of its deliveries and of its writes: nothing arrives or leaves before its time.

    Returns:
        None if a stamp contradicts an anchor, and if a message with every part of its chain has no reception stamp.
    """
    if exchange.relay is None or not messages.columns.keys() >= _RECEIVED:
        return None
    if any((messages.of_shown(name) == MISSING).any() for name in _RECEIVED):
        return None
    relay_wall_ns = exchange.relay.wall_anchor_ns - exchange.relay.monotonic_anchor_ns
    ping_wall_ns = exchange.ping.wall_anchor_ns - exchange.ping.monotonic_anchor_ns
    shortest = [
        _shortest(messages, _RELAY_RECEIVED, "relay_in_ns", relay_wall_ns),
        _shortest(messages, _REPLY_RECEIVED, "receive_ns", ping_wall_ns),
    ]
    # How long after T4 (T1) the middleware stamped the message, by the same anchor.
    if is_direct:
        shortest += [
            _shortest(messages, "relay_out_ns", _REPLY_SOURCE, -relay_wall_ns),
            _shortest(messages, "publish_ns", _RELAY_SOURCE, -ping_wall_ns),
        ]
    found = [time_ns for time_ns in shortest if time_ns is not None]
    if min(found) < 0:
        return None
    return _Anchors(relay_wall_ns, ping_wall_ns, max(found) if len(found) == _SIDES else None)


def _shortest(messages: _Messages, begin: str, end: str, wall_ns: int) -> int | None:
    """Return the shortest time between two columns in ns, on the clock that is `wall_ns` ahead of the end's; None without any."""
    if not {begin, end} <= set(messages.columns):
        return None
    begin_ns, end_ns = messages.columns[begin], messages.columns[end]
    known = (begin_ns != MISSING) & (end_ns != MISSING)
    times_ns = chosen_of(known, end_ns) - chosen_of(known, begin_ns)
    return int(times_ns.min()) + wall_ns if len(times_ns) else None


def response_frame(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
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
    columns = {name: filled(roundtrips.measured[name]) for name in names}
    came = roundtrips.measured["response_ns"].is_not_null().to_numpy()
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
