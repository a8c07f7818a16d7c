"""The frames `breakdown` and `responses`: where the time of a message goes, from planned sending to reply.

    T0 ..waiting.. T1 ..transport.. R3 ..delivery.. T3 ..relay.. T4 ..transport.. R2 ..delivery.. T2
                   |------- outbound_ns ----------|             |--------- return_ns --------|

R3 and R2 are the middleware's reception stamps, on wall clocks. Wall clock and monotonic clock of a device differ by a constant,
the session's anchor, until somebody sets the wall clock (clock_gettime(2)). The stamps check it: no message is delivered before
it is received (`received <= T3`), nor stamped before it is handed over (`source >= T4`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import polars as pl
from numpy.typing import NDArray

from dds_trace.tracefile.format.events import Stage

from ..model.metrics import frame_schema
from ..pairing.exchanges import Exchange
from ..pairing.pair import MISSING, chosen_of
from ..pairing.roundtrips import MIDDLEWARE_STAMPS, RECEPTION_STAMPS, RoundTrips
from ..statistics.percentiles import minimum_messages, quantile_of
from .batch import Batch, exchanges_by_group, filled, is_present

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

_RELAY_SOURCE, _RELAY_RECEIVED = MIDDLEWARE_STAMPS[Stage.T3]
_REPLY_SOURCE, _REPLY_RECEIVED = MIDDLEWARE_STAMPS[Stage.T2]

_PART_COLUMNS = ("scheduled_ns", "outbound_ns", "intermediate_ns", "return_ns", "clock_bound_ns")
"""Parts of a response; only messages with all of them are shown."""

_SIDES = 4
"""Deliveries and writes of relay and ping bound an anchor from both sides."""

BREAKDOWN_SCHEMA = frame_schema(
    "group:u32 part:str order:u32 messages:u64 mean_ns:f64 p50_ns:f64 p99_ns:f64 bound_ns:f64"
)

RESPONSE_SCHEMA = frame_schema(
    "group:u32 messages:u64 late_ratio:f64 waiting_max_ns:i64 rtt_p50_ns:f64 response_p50_ns:f64 "
    "rtt_p99_ns:f64 response_p99_ns:f64 hidden_p50_ns:f64 hidden_p99_ns:f64"
)


def breakdown_frame(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
    """Summarize where the time of each whole group goes, a row per part.

    Only messages with all parts count, so that the means add up to the mean response. `part` is a name of `STAGES`, or
    `outbound_ns` and `return_ns` where a reception stamp is missing or contradicts its anchor; `p99_ns` is null below 100
    messages, `bound_ns` (mean bound of the clocks) where an anchor is bounded on one side only.
    """
    columns = _Columns(roundtrips)
    is_complete = _is_complete(roundtrips)
    bridges = roundtrips.described["bridge"].to_list()
    rows: list[dict[str, object]] = []
    for group, numbers in exchanges_by_group(batch):
        offsets = roundtrips.bounds[numbers.start : numbers.stop + 1].tolist()
        messages = _Messages(columns, offsets[0], is_complete[offsets[0] : offsets[-1]])
        if not messages.shown:
            continue
        deliveries = _deliveries(
            messages,
            [
                _ExchangeRows(
                    batch.exchanges[number], slice(first - offsets[0], after - offsets[0]), bridges[number] == "none"
                )
                for number, first, after in zip(numbers, offsets, offsets[1:], strict=False)
            ],
        )
        rows += [
            {
                "group": group,
                "part": part,
                "order": order,
                "messages": messages.shown,
                "mean_ns": float(values_ns.mean()),
                **_percentiles(values_ns),
                "bound_ns": bound_ns,
            }
            for order, (part, values_ns, bound_ns) in enumerate(_parts(messages, deliveries))
        ]
    return pl.DataFrame(rows, schema=BREAKDOWN_SCHEMA)


def _is_complete(rows: RoundTrips) -> Bools:
    is_complete = np.ones(int(rows.bounds[-1]), np.bool_)
    for name in _PART_COLUMNS:
        is_complete &= is_present(rows.column(name))
    return is_complete


class _Columns(dict[str, Int64]):
    def __init__(self, rows: RoundTrips) -> None:
        super().__init__()
        self._rows = rows
        # Stamps prove nothing unless both devices have reception stamps.
        self.stamps = rows.stamp_names if rows.stamp_names >= RECEPTION_STAMPS else frozenset[str]()

    def __missing__(self, name: str) -> Int64:
        values = filled(self._rows.column(name), MISSING)
        if name in self.stamps:
            values = np.where(values == 0, MISSING, values)
        self[name] = values
        return values


@dataclass(frozen=True, slots=True, eq=False)
class _Messages:
    """Rows of a group, from `first` on in `columns`; complete ones are shown."""

    columns: _Columns
    first: int
    is_complete: Bools

    @property
    def shown(self) -> int:
        return int(np.count_nonzero(self.is_complete))

    def column(self, name: str) -> Int64:
        return self.columns[name][self.first : self.first + len(self.is_complete)]

    def shown_column(self, name: str) -> Int64:
        return chosen_of(self.is_complete, self.column(name))


@dataclass(frozen=True, slots=True, eq=False)
class _ExchangeRows:
    """`rows` are in the group; `is_direct`: no bridge writes the source stamps."""

    exchange: Exchange
    rows: slice
    is_direct: bool

    @property
    def relay_wall_ns(self) -> int:
        assert self.exchange.relay is not None
        return self.exchange.relay.wall_anchor_ns - self.exchange.relay.monotonic_anchor_ns

    @property
    def ping_wall_ns(self) -> int:
        return self.exchange.ping.wall_anchor_ns - self.exchange.ping.monotonic_anchor_ns


@dataclass(frozen=True, slots=True, eq=False)
class _Deliveries:
    """Deliveries (R3 to T3, R2 to T2), the anchors' mean bound, and this plus the clocks' bound."""

    relay_ns: Int64
    ping_ns: Int64
    bound_ns: float | None
    with_clock_ns: float | None


def _parts(messages: _Messages, deliveries: _Deliveries | None) -> Iterator[tuple[str, Int64, float | None]]:
    shown = messages.shown_column
    clock_ns = float(shown("clock_bound_ns").mean())
    yield "waiting_ns", shown("publish_ns") - shown("scheduled_ns"), 0.0
    if deliveries is None:
        yield "outbound_ns", shown("outbound_ns"), clock_ns
    else:
        yield "outbound_transport_ns", shown("outbound_ns") - deliveries.relay_ns, deliveries.with_clock_ns
        yield "relay_delivery_ns", deliveries.relay_ns, deliveries.bound_ns
    yield "relay_ns", shown("intermediate_ns"), 0.0
    if deliveries is None:
        yield "return_ns", shown("return_ns"), clock_ns
    else:
        yield "return_transport_ns", shown("return_ns") - deliveries.ping_ns, deliveries.with_clock_ns
        yield "ping_delivery_ns", deliveries.ping_ns, deliveries.bound_ns


def _percentiles(values_ns: Int64) -> dict[str, float | None]:
    ordered = np.sort(values_ns)
    p99_ns = quantile_of(ordered, 0.99) if len(ordered) >= minimum_messages(0.99) else None
    return {"p50_ns": quantile_of(ordered, 0.5), "p99_ns": p99_ns}


def _deliveries(messages: _Messages, exchanges: Iterable[_ExchangeRows]) -> _Deliveries | None:
    """Return the deliveries of the shown messages; None unless all have both, by anchors that no stamp contradicts.

    A larger error of an anchor than the shortest delivery and write would make one of these negative.
    """
    is_complete, stamps = messages.is_complete, messages.columns.stamps
    shown = [exchange for exchange in exchanges if is_complete[exchange.rows].any()]
    if not stamps or any(exchange.exchange.relay is None for exchange in shown):
        return None
    relay = _Times.between(messages, _RELAY_RECEIVED, "relay_in_ns")
    ping = _Times.between(messages, _REPLY_RECEIVED, "receive_ns")
    if not chosen_of(is_complete, relay.has_value & ping.has_value).all():
        return None
    times_ns = [
        [relay.least_ns(part.rows, part.relay_wall_ns), ping.least_ns(part.rows, part.ping_wall_ns)] for part in shown
    ]
    # How long after T4 (T1) the middleware stamped the message, by the same anchor.
    relay_walls_ns, ping_walls_ns = ([part.relay_wall_ns for part in shown], [part.ping_wall_ns for part in shown])
    for start, end, walls_ns in (
        ("relay_out_ns", _REPLY_SOURCE, relay_walls_ns),
        ("publish_ns", _RELAY_SOURCE, ping_walls_ns),
    ):
        if end in stamps:
            writes = _Times.between(messages, start, end)
            for part, wall_ns, least_ns in zip(shown, walls_ns, times_ns, strict=True):
                least_ns.append(writes.least_ns(part.rows, -wall_ns) if part.is_direct else None)
    shortest_ns = [[time for time in least_ns if time is not None] for least_ns in times_ns]
    if any(min(bounds_ns) < 0 for bounds_ns in shortest_ns):
        return None
    masks = [is_complete[part.rows] for part in shown]
    relay_ns = [relay.values_ns[part.rows][mask] + part.relay_wall_ns for part, mask in zip(shown, masks, strict=True)]
    ping_ns = [ping.values_ns[part.rows][mask] + part.ping_wall_ns for part, mask in zip(shown, masks, strict=True)]
    clock_bound_ns = messages.column("clock_bound_ns")
    judged, anchor_ns, clock_ns = 0, 0, 0
    for part, mask, bounds_ns in zip(shown, masks, shortest_ns, strict=True):
        if len(bounds_ns) == _SIDES:
            count = int(np.count_nonzero(mask))
            judged += count
            anchor_ns += count * max(bounds_ns)
            clock_ns += int(clock_bound_ns[part.rows][mask].sum())
    return _Deliveries(
        np.concatenate(relay_ns),
        np.concatenate(ping_ns),
        anchor_ns / judged if judged else None,
        (anchor_ns + clock_ns) / judged if judged else None,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Times:
    values_ns: Int64
    has_value: Bools

    @classmethod
    def between(cls, messages: _Messages, start: str, end: str) -> _Times:
        start_ns, end_ns = messages.column(start), messages.column(end)
        return cls(end_ns - start_ns, (start_ns != MISSING) & (end_ns != MISSING))

    def least_ns(self, rows: slice, wall_ns: int) -> int | None:
        values_ns = chosen_of(self.has_value[rows], self.values_ns[rows])
        return int(values_ns.min()) + wall_ns if len(values_ns) else None


def response_frame(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
    """Compare response times with round trips of each whole group.

    A sender that waits hides the waiting in round trips ("coordinated omission", G. Tene, 2013). `late_ratio` were sent
    more than a tenth of the period after T0; `hidden_*_ns` = response - rtt; p99 needs 100 messages.
    """
    if not batch.whole:
        return pl.DataFrame(schema=RESPONSE_SCHEMA)
    names = ("scheduled_ns", "publish_ns", "response_ns", "rtt_ns")
    waiting_ns, period_ns = pl.col("publish_ns") - pl.col("scheduled_ns"), 1e9 / pl.col("rate_hz").first()
    times = {name: pl.col(f"{name}_ns") for name in ("rtt", "response")}
    enough = pl.len() >= minimum_messages(0.99)
    responses = (
        pl.DataFrame([roundtrips.column(name) for name in names])
        .with_columns(
            pl.Series("group", roundtrips.per_row(batch.group_of_exchange)),
            roundtrips.described["rate_hz"].gather(roundtrips.exchange_of_row()),
        )
        .drop_nulls("response_ns")
        .group_by("group", maintain_order=True)
        .agg(
            messages=pl.len(),
            late_ratio=(waiting_ns > 0.1 * period_ns).fill_null(False).mean(),
            waiting_max_ns=waiting_ns.max(),
            **{f"{name}_p50_ns": time.median() for name, time in times.items()},
            **{f"{name}_p99_ns": pl.when(enough).then(time.quantile(0.99, "linear")) for name, time in times.items()},
        )
    )
    hidden = {f"hidden_{p}_ns": pl.col(f"response_{p}_ns") - pl.col(f"rtt_{p}_ns") for p in ("p50", "p99")}
    return responses.with_columns(**hidden).select(pl.col(n).cast(kind) for n, kind in RESPONSE_SCHEMA.items())
