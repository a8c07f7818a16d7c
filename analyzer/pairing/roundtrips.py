"""The paired events of a batch: one row per published message and relay."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from dds_trace.base.threads import InlineExecutor
from dds_trace.tracefile.format.events import EventColumns, Stage

from ..model.columns import KEY_COLUMNS
from ..model.metrics import schema_of, with_metrics
from ..model.parameters import PARAMETER_COLUMNS
from .counts import COUNT_SCHEMA, count_all, count_messages
from .one_way import OneWay, fit_exchanges, knots_of
from .pair import (
    MISSING,
    OUTCOMES,
    PairedMessages,
    Published,
    Scalar,
    is_pinged,
    middleware_stamps,
    pair_messages,
    published_messages,
)
from .presence import present
from .unsent import count_unsent, settled
from .utc import utc_columns

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from concurrent.futures import Executor

    from numpy.typing import DTypeLike, NDArray

    from ..loading.event_index import EventKey
    from .exchanges import Exchange

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
"""Columns of `source_ns` and `received_ns` of T3 and T2: i64, ns since 1970, 0 if unknown."""

RECEPTION_STAMPS = frozenset(received for _, received in MIDDLEWARE_STAMPS.values())
"""Stamps of reception; without any of them the others are not used."""

STAMP_NAMES = tuple(name for names in MIDDLEWARE_STAMPS.values() for name in names)

ROWS_PER_FRAME = 1 << 20
"""Rows of a frame of `PairedRows.frames`, and of a row group of the Parquet file."""


@dataclass(frozen=True, slots=True, eq=False)
class PairedRows(ABC):
    """The rows of some exchanges, by exchange, then by sequence.

    Attributes:
        described: run_id, relay_id and the parameter columns, one row per exchange.
        bounds: int64, exchange i has the rows `bounds[i]` to `bounds[i + 1]` (not included).
        counts: one row per exchange, columns of `counts.COUNT_SCHEMA`.
        clock_knots: columns of `one_way.KNOT_SCHEMA` of the exchanges' own fits, `group` being the index of the exchange.
    """

    described: pl.DataFrame
    bounds: NDArray[np.int64]
    counts: pl.DataFrame
    clock_knots: pl.DataFrame

    @property
    @abstractmethod
    def stamp_names(self) -> frozenset[str]:
        """Columns of `MIDDLEWARE_STAMPS` that any event has."""

    @abstractmethod
    def column(self, name: str) -> pl.Series:
        """Return `sequence`, a column of `columns.MEASURED_COLUMNS` but `outcome`, or one of `stamp_names`."""

    @abstractmethod
    def frames(self) -> Iterator[pl.DataFrame]:
        """Yield the rows in frames of `ROWS_PER_FRAME`, at least one.

        Columns are `sequence`, `columns.MEASURED_COLUMNS` and `UTC_COLUMNS`; `outcome` is u8, an index of `pair.OUTCOMES`.
        """

    def per_row(self, values: NDArray[Scalar]) -> NDArray[Scalar]:
        """Repeat a value of each exchange for each of its rows."""
        return np.repeat(values, np.diff(self.bounds))

    def exchange_of_row(self) -> NDArray[np.uint32]:
        """Return the index of each row's exchange."""
        return self.per_row(np.arange(len(self.described), dtype=np.uint32))


@dataclass(frozen=True, slots=True, eq=False)
class RoundTrips(PairedRows):
    """The rows of some exchanges in memory.

    Attributes:
        outcome: uint8, for each row an index of `pair.OUTCOMES`.
    """

    measured: pl.DataFrame
    outcome: NDArray[np.uint8]
    stamps: tuple[pl.Series, ...]

    @property
    def stamp_names(self) -> frozenset[str]:
        return frozenset(series.name for series in self.stamps)

    def column(self, name: str) -> pl.Series:
        stamps = [series for series in self.stamps if series.name == name]
        return stamps[0] if stamps else self.measured[name]

    def frames(self) -> Iterator[pl.DataFrame]:
        for first in range(0, len(self.outcome) or 1, ROWS_PER_FRAME):
            outcome = pl.Series("outcome", self.outcome[first : first + ROWS_PER_FRAME])
            yield self.measured[first : first + ROWS_PER_FRAME].with_columns(outcome)

    def part(self, begin: int, end: int) -> RoundTrips:
        """Return exchanges `begin` to `end` (not included): views of their rows."""
        first, behind = self.bounds[[begin, end]].tolist()
        is_here = pl.col("group").is_between(begin, end, closed="left")
        return RoundTrips(
            measured=self.measured[first:behind],
            described=self.described[begin:end],
            outcome=self.outcome[first:behind],
            bounds=self.bounds[begin : end + 1] - first,
            counts=self.counts[begin:end],
            stamps=tuple(stamps[first:behind] for stamps in self.stamps),
            clock_knots=self.clock_knots.filter(is_here).with_columns(pl.col("group") - begin),
        )


def pair_exchanges(
    exchanges: Sequence[Exchange],
    events: Mapping[EventKey, EventColumns],
    *,
    details: bool = True,
    pool: Executor | None = None,
) -> RoundTrips:
    """Pair the events of every exchange by its `event_keys`, count them, and compute the metrics of every round trip.

    Without `details` no clocks are fitted, one-way times are null, and the middleware's stamps are dropped. `pool` counts
    messages and fits clocks in parallel.
    """
    pool = pool or InlineExecutor()
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
    of_all = [
        count_all(events[exchange.event_keys()[0]], events[exchange.event_keys()[2]], exchange.run.warmup_messages)
        if exchange.run.ping_every > 1
        else {}
        for exchange in exchanges
    ]
    for exchange, every, is_there, mask, first in zip(
        exchanges, messages_of_exchanges, in_service, masks, bounds[:-1].tolist(), strict=True
    ):
        events_of_stage = {key[0]: events[key] for key in exchange.event_keys()}
        paired = pair(exchange, every)
        unsent, messages = count_unsent(exchange.run, every, events_of_stage[Stage.T2]), every
        if not mask.all():
            messages, paired = every.take(mask), paired.take(mask)
        absent = len(every) - int(np.count_nonzero(is_there))
        counts.append(
            pool.submit(
                count_messages,
                messages,
                paired,
                unsent=unsent,
                in_flight=len(every) - absent - len(messages),
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
    fitting = pool.submit(fit_exchanges, exchanges, bounds, stamps) if details else None
    in_time = pl.DataFrame({"sequence": columns["sequence"]}).with_columns(
        *(_null_where_missing(name, values) for name, values in stamps.items()),
        outcome_names(columns["outcome"]),
        pl.Series("duplicates", columns["duplicates"]),
        pl.Series("reordered", columns["reordered"]),
    )
    utc = utc_columns(exchanges, bounds, stamps)
    one_way = fitting.result() if fitting else OneWay.unknown(rows, len(exchanges))
    measured = with_metrics(in_time.with_columns(*one_way.columns, *utc))
    return RoundTrips(
        measured=measured,
        described=describe(exchanges),
        outcome=columns["outcome"],
        bounds=bounds,
        counts=pl.DataFrame(
            [count.result() | more for count, more in zip(counts, of_all, strict=True)], schema=COUNT_SCHEMA
        ),
        stamps=tuple(pl.Series(name, columns[name]) for name in STAMP_NAMES if name in columns),
        clock_knots=knots_of(exchanges, range(len(exchanges)), one_way.fits),
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


def _null_where_missing(name: str, values: NDArray[np.int64]) -> pl.Series:
    series = pl.Series(name, values)
    missing = values == MISSING
    return series.set(pl.Series(missing), None) if missing.any() else series


def bounds_of(counts: pl.DataFrame) -> NDArray[np.int64]:
    return np.concatenate([[0], np.cumsum(counts["published"].to_numpy())]).astype(np.int64)


def outcome_names(codes: NDArray[np.uint8]) -> pl.Series:
    names = [outcome.value for outcome in OUTCOMES]
    return pl.Series("outcome", names, pl.Enum(names)).gather(codes.astype(np.uint32))
