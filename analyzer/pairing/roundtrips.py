"""The paired events of a batch: one row per published message and relay."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import DTypeLike, NDArray

from dds_trace.base.units import SECOND_NS
from dds_trace.tracefile.format.descriptions import Run
from dds_trace.tracefile.format.events import EventColumns, Stage

from ..loading.event_index import EventKey
from ..model.columns import KEY_COLUMNS
from ..model.metrics import METRICS, schema_of, with_metrics
from ..model.parameters import PARAMETER_COLUMNS
from ..model.runs import MOST_MESSAGES
from .counts import COUNT_SCHEMA, count_all, count_messages, count_sizes
from .exchanges import Exchange
from .one_way import OneWay, fit_exchanges, knots_of
from .pair import (
    MISSING,
    OUTCOMES,
    PairedMessages,
    Published,
    Scalar,
    first_replies,
    is_pinged,
    middleware_stamps,
    pair_messages,
    published_messages,
)
from .utc import null_where_missing, utc_columns

_STAMPS = ("scheduled_ns", "publish_ns", "receive_ns", "relay_in_ns", "relay_out_ns")

_DTYPES: Mapping[str, DTypeLike] = {
    "sequence": np.uint64,
    **dict.fromkeys(_STAMPS, np.int64),
    "outcome": np.uint8,
    "duplicates": np.uint16,
    "reordered": np.bool_,
}

_PUBLISHED = ("sequence", "scheduled_ns", "publish_ns")
_PAIRED = ("receive_ns", "relay_in_ns", "relay_out_ns", "outcome", "duplicates", "reordered")

MIDDLEWARE_STAMPS = {
    Stage.T3: ("relay_source_ns", "relay_received_ns"),
    Stage.T2: ("reply_source_ns", "reply_received_ns"),
}
"""`source_ns` and `received_ns` of T3 and T2: i64, ns since 1970, 0 if unknown."""

RECEPTION_STAMPS = frozenset(received for _, received in MIDDLEWARE_STAMPS.values())
"""Stamps of reception; without any of them the others are not used."""

STAMP_NAMES = tuple(name for names in MIDDLEWARE_STAMPS.values() for name in names)

ROWS_PER_FRAME = 1 << 20
"""Rows of a frame of `RoundTrips.frames`, and of a row group of the Parquet file."""


@dataclass(frozen=True, slots=True, eq=False)
class RoundTrips:
    """The rows of some exchanges, by exchange, then by sequence.

    Attributes:
        described: run_id, relay_id and the parameter columns, one row per exchange.
        bounds: int64, exchange i has the rows `bounds[i]` to `bounds[i + 1]` (not included).
        counts: one row per exchange, columns of `counts.COUNT_SCHEMA`.
        clock_knots: columns of `one_way.KNOT_SCHEMA` of the exchanges' own fits, `group` being the index of the exchange.
        measured: `sequence`, `columns.MEASURED_COLUMNS` but `outcome`, and `UTC_COLUMNS`; of many rows without metrics and UTC.
        outcome: uint8, an index of `pair.OUTCOMES`.
        stamps: the columns of `MIDDLEWARE_STAMPS` that any event has, if these are among them: `RECEPTION_STAMPS`.
        exchanges: of many rows; else none.
    """

    described: pl.DataFrame
    bounds: NDArray[np.int64]
    counts: pl.DataFrame
    clock_knots: pl.DataFrame
    measured: pl.DataFrame
    outcome: NDArray[np.uint8]
    stamps: tuple[pl.Series, ...]
    exchanges: tuple[Exchange, ...] = ()

    @property
    def stamp_names(self) -> frozenset[str]:
        return frozenset(series.name for series in self.stamps)

    def column(self, name: str) -> pl.Series:
        if name in self.measured.columns:
            return self.measured.get_column(name)
        stamps = [series for series in self.stamps if series.name == name]
        return stamps[0] if stamps else self.select([name]).to_series()

    def select(self, names: Sequence[str]) -> pl.DataFrame:
        """Return columns without `stamps`; a metric that is not there is computed."""
        there = self.measured.columns
        lacking = [METRICS[name.removesuffix("_ns")].formula.alias(name) for name in names if name not in there]
        return self.measured.select(*(name for name in names if name in there), *lacking)

    def frames(self) -> Iterator[pl.DataFrame]:
        """Yield the rows in frames of `ROWS_PER_FRAME`, at least one, with `outcome`, but without `stamps`."""
        for first in range(0, len(self.outcome) or 1, ROWS_PER_FRAME):
            outcome = pl.Series("outcome", self.outcome[first : first + ROWS_PER_FRAME])
            frame = self.measured[first : first + ROWS_PER_FRAME]
            if self.exchanges:
                bounds = self.bounds.clip(first, first + len(frame)) - first
                frame = with_metrics(frame).with_columns(utc_columns(self.exchanges, bounds, frame))
            yield frame.with_columns(outcome)

    def per_row(self, values: NDArray[Scalar]) -> NDArray[Scalar]:
        return np.repeat(values, np.diff(self.bounds))

    def exchange_of_row(self) -> NDArray[np.uint32]:
        return self.per_row(np.arange(len(self.described), dtype=np.uint32))


def pair_exchanges(
    exchanges: Sequence[Exchange], events: Mapping[EventKey, EventColumns], *, details: bool = True
) -> RoundTrips:
    """Pair the events of every exchange by its `event_keys`, count them, and compute the metrics of every round trip.

    Without `details` no clocks are fitted, one-way times are null, and the middleware's stamps are dropped.
    """
    # A run's messages are the same for each of its relays.
    published = {
        run_id: published_messages(
            events[exchange.event_keys()[0]], exchange.run.warmup_messages, exchange.run.ping_every
        )
        for run_id, exchange in {exchange.run.run_id: exchange for exchange in exchanges}.items()
    }
    messages_of_exchanges = [published[exchange.run.run_id] for exchange in exchanges]

    def pair(exchange: Exchange, messages: Published) -> PairedMessages:
        _, t2, t3, t4 = (events[key] for key in exchange.event_keys())
        if exchange.run.ping_every > 1:
            t3 = t3.take(is_pinged(t3.sequence, exchange.run.ping_every))
        return pair_messages(messages, t2, t3, t4)

    in_service = present(exchanges, messages_of_exchanges, pair)
    masks = [
        settled(exchange.run, messages, events[exchange.event_keys()[1]]) & is_there
        for exchange, messages, is_there in zip(exchanges, messages_of_exchanges, in_service, strict=True)
    ]
    bounds = np.concatenate([[0], np.cumsum([np.count_nonzero(mask) for mask in masks])]).astype(np.int64)
    rows = int(bounds[-1])

    filled, counts = _Filled(rows), []
    of_all = []
    for exchange in exchanges:
        t1, t2, t3, _ = (events[key] for key in exchange.event_keys())
        one_way_counts = count_all(t1, t3, exchange.run.warmup_messages) if exchange.run.ping_every > 1 else {}
        of_all.append(count_sizes(t1, t2, exchange.run) | one_way_counts)
    for exchange, all_messages, is_there, mask, first in zip(
        exchanges, messages_of_exchanges, in_service, masks, bounds[:-1].tolist(), strict=True
    ):
        events_of_stage = {key[0]: events[key] for key in exchange.event_keys()}
        paired = pair(exchange, all_messages)
        unsent, messages = count_unsent(exchange.run, all_messages, events_of_stage[Stage.T2]), all_messages
        if not mask.all():
            messages, paired = all_messages.take(mask), paired.take(mask)
        absent = len(all_messages) - int(np.count_nonzero(is_there))
        counts.append(
            count_messages(
                messages,
                paired,
                unsent=unsent,
                in_flight=len(all_messages) - absent - len(messages),
                absent=absent,
                history_ns=exchange.run.history_ns,
            )
        )
        filled.put(first, {name: getattr(messages, name) for name in _PUBLISHED})
        filled.put(first, {name: getattr(paired, name) for name in _PAIRED})
        for stage, names in MIDDLEWARE_STAMPS.items() if details else ():
            instant_ns = paired.relay_in_ns if stage is Stage.T3 else paired.receive_ns
            stamps_of_events = middleware_stamps(messages, events_of_stage[stage], instant_ns)
            filled.put(first, dict(zip(names, stamps_of_events, strict=False)))  # none where no event has any

    columns = filled.columns
    stamps = {name: columns[name] for name in _STAMPS}
    outcomes = [outcome.value for outcome in OUTCOMES]
    in_time = pl.DataFrame({"sequence": columns["sequence"]}).with_columns(
        *(null_where_missing(name, values) for name, values in stamps.items()),
        pl.Series("outcome", outcomes, pl.Enum(outcomes)).gather(columns["outcome"].astype(np.uint32)),
        pl.Series("duplicates", columns["duplicates"]),
        pl.Series("reordered", columns["reordered"]),
    )
    stamp_names = STAMP_NAMES if columns.keys() >= RECEPTION_STAMPS else ()
    one_way = fit_exchanges(exchanges, bounds, stamps) if details else OneWay.unknown(rows, len(exchanges))
    measured = in_time.with_columns(*one_way.columns)
    if not (is_long := rows > ROWS_PER_FRAME):
        measured = with_metrics(measured).with_columns(utc_columns(exchanges, bounds, measured))
    return RoundTrips(
        measured=measured,
        described=describe(exchanges),
        outcome=columns["outcome"],
        bounds=bounds,
        counts=pl.DataFrame([count | more for count, more in zip(counts, of_all, strict=True)], schema=COUNT_SCHEMA),
        stamps=tuple(pl.Series(name, columns[name]) for name in stamp_names if name in columns),
        clock_knots=knots_of(exchanges, range(len(exchanges)), one_way.fits),
        exchanges=tuple(exchanges) if is_long else (),
    )


class _Filled:
    """Columns of all exchanges, zero by default; a single exchange is not copied: do not write to it."""

    def __init__(self, rows: int) -> None:
        self._rows = rows
        none = _DTYPES if not rows else {}
        self.columns: dict[str, NDArray[Any]] = {name: np.empty(0, dtype) for name, dtype in none.items()}

    def put(self, first: int, values: Mapping[str, NDArray[Any]]) -> None:
        for name, part in values.items():
            if len(part) == self._rows:
                self.columns[name] = part
            elif len(part):
                if name not in self.columns:
                    self.columns[name] = np.zeros(self._rows, part.dtype)
                self.columns[name][first : first + len(part)] = part


def describe(exchanges: Sequence[Exchange]) -> pl.DataFrame:
    return pl.DataFrame(
        [(e.run.run_id, e.relay_id, *e.parameters().values()) for e in exchanges],
        schema=schema_of((*KEY_COLUMNS[:2], *PARAMETER_COLUMNS)),
        orient="row",
    )


def present(
    exchanges: Sequence[Exchange], published: Sequence[Published], pair: Callable[[Exchange, Published], PairedMessages]
) -> list[NDArray[np.bool_]]:
    """Return for each exchange which messages count for its relay.

    For a relay that started within the run, those from the first one on that it got; for one that it replaced on its device, those
    before.
    """
    masks = [np.ones(len(messages), np.bool_) for messages in published]
    by_run: dict[int, list[int]] = defaultdict(list)
    for number, exchange in enumerate(exchanges):
        by_run[exchange.run.run_id].append(number)
    for numbers in by_run.values():
        if len(numbers) == 1:
            continue
        paired = {number: pair(exchanges[number], published[number]) for number in numbers}
        for late in numbers:
            first = _first_after_start(exchanges[late], published[late], paired[late])
            if first is None:
                continue
            masks[late][:first] = False
            for other in numbers:
                if other != late and _is_succeeded(exchanges[other], exchanges[late], paired[other], first):
                    masks[other][first:] = False
    return masks


def _first_after_start(exchange: Exchange, published: Published, paired: PairedMessages) -> int | None:
    """Return the first message (by the least T3 - T1) for a relay that started within the run; None for others."""
    arrived = paired.relay_in_ns != MISSING
    if exchange.relay is None or not arrived.any():
        return None
    if paired.relay_in_ns[arrived].min() < exchange.relay.monotonic_anchor_ns:  # an anchor that is not the start
        return None
    most_ahead_ns = int((paired.relay_in_ns[arrived] - published.publish_ns[arrived]).min())
    is_after = published.publish_ns >= exchange.relay.monotonic_anchor_ns - most_ahead_ns
    reached = np.flatnonzero(is_after & arrived)
    return None if is_after.all() or not len(reached) else int(reached[0])


def _is_succeeded(other: Exchange, late: Exchange, paired: PairedMessages, first: int) -> bool:
    if other.relay is None or late.relay is None or other.relay.device != late.relay.device:
        return False
    seen = (paired.relay_in_ns != MISSING) | (paired.receive_ns != MISSING)
    return not seen[first:].any() and bool(seen[:first].any())


_PATIENCE_NS = 2 * SECOND_NS
"""Time that a reply may take in a run without any: a ping's wait at its end."""


def count_unsent(run: Run, published: Published, t2: EventColumns) -> int:
    """Return the number of counted messages that were due when the run ended and never published.

    The run ended at its `ended_ns`, else at the last T1 or T2. A live topic has no plan: its skipped messages were never sent.
    """
    skipped = run.extra.get("skipped_messages")
    if isinstance(skipped, int):
        return min(max(skipped, 0), MOST_MESSAGES)
    if not len(published) or run.rate_hz <= 0 or str(run.extra.get("data_source", "")).startswith("topic:"):
        return 0
    first, scheduled_ns = int(published.sequence[0]), int(published.scheduled_ns[0])
    if scheduled_ns == MISSING:
        return 0
    run_end = run.extra.get("ended_ns")
    ended_ns = run_end if isinstance(run_end, int) else _last_ns(published, t2)
    planned = run.warmup_messages + run.planned_messages
    due = first + 1 + int((ended_ns - scheduled_ns) * run.rate_hz / SECOND_NS)
    left = max(int(published.sequence[-1]) + 1, run.published, run.warmup_messages)
    return min(max(0, min(due, planned) - left), MOST_MESSAGES)


def settled(run: Run, published: Published, t2: EventColumns) -> NDArray[np.bool_]:
    """Return for each counted message whether its fate is known.

    In the run of a killed ping, a message without a reply is in flight if the slowest reply took more time than is left before
    the last T1 or T2. So is the last message: the ping may have died between its T1 and sending it.
    """
    is_settled = np.ones(len(published), np.bool_)
    if run.state == "finished" or not len(published):
        return is_settled
    receive_ns = first_replies(published, t2)
    replied = receive_ns != MISSING
    rtts_ns = receive_ns[replied] - published.publish_ns[replied]
    longest_ns = int(rtts_ns.max()) if len(rtts_ns) else _PATIENCE_NS
    is_settled &= replied | (published.publish_ns <= _last_ns(published, t2) - longest_ns)
    is_settled[-1] = replied[-1]
    return is_settled


def _last_ns(published: Published, t2: EventColumns) -> int:
    last_ns = int(published.publish_ns.max())
    return max(last_ns, int(t2.monotonic_ns.max())) if len(t2) else last_ns
