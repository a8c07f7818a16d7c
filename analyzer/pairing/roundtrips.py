"""The paired events of a batch: one row per published message and relay that took part in its run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np
import polars as pl

from dds_trace.tracefile import Stage

from ..model.column import schema_of
from ..model.columns import KEY_COLUMNS
from ..model.metrics import with_metrics
from ..model.parameters import PARAMETER_COLUMNS
from .counts import COUNT_SCHEMA, count_messages
from .one_way import OneWay, fit_exchanges
from .pair import MISSING, OUTCOMES, middleware_stamps, pair_messages, published_messages

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from dds_trace.tracefile import EventColumns

    from ..clocks.fit import ClockFit
    from ..loading.events import EventKey
    from .exchanges import Exchange
    from .pair import PairedMessages, Published

Scalar = TypeVar("Scalar", bound=np.generic)

MIDDLEWARE_STAMPS = {
    Stage.T3: ("relay_source_ns", "relay_received_ns"),
    Stage.T2: ("reply_source_ns", "reply_received_ns"),
}
"""Columns that hold `source_ns` and `received_ns` of a row's T3 and T2: i64, ns since 1970, 0 if unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class RoundTrips:
    """The rows of some exchanges, their counts and clock fits.

    Attributes:
        measured: `sequence` and the columns of `columns.MEASURED_COLUMNS`; rows by exchange, then by sequence.
        described: run_id, relay_id and the parameter columns, one row per exchange.
        outcome: uint8, for each row the position of its outcome in `pair.OUTCOMES`.
        bounds: int64, exchange i has the rows `bounds[i]` to `bounds[i + 1]` (not included).
        counts: one row per exchange, columns of `counts.COUNT_SCHEMA`.
        stamps: columns of `MIDDLEWARE_STAMPS` that any event has, one row per row of `measured`.
        clock_fits: of each exchange by its own messages; None without a message to fit, or where not asked for.
    """

    measured: pl.DataFrame
    described: pl.DataFrame
    outcome: NDArray[np.uint8]
    bounds: NDArray[np.int64]
    counts: pl.DataFrame
    stamps: tuple[pl.Series, ...]
    clock_fits: tuple[ClockFit | None, ...]

    def per_row(self, values: NDArray[Scalar]) -> NDArray[Scalar]:
        """Repeat a value of each exchange for each of its rows."""
        return np.repeat(values, np.diff(self.bounds))

    def exchange_of_row(self) -> NDArray[np.uint32]:
        """Return for each row the position of its exchange."""
        return self.per_row(np.arange(len(self.described), dtype=np.uint32))


class _Rows:
    """Columns of rows that are filled exchange by exchange: the frame's memory once, whatever the number of runs."""

    def __init__(self, rows: int) -> None:
        self.sequence = np.empty(rows, np.uint64)
        self.stamps = {
            name: np.empty(rows, np.int64)
            for name in ("scheduled_ns", "publish_ns", "receive_ns", "relay_in_ns", "relay_out_ns")
        }
        self.outcome = np.empty(rows, np.uint8)
        self.duplicates = np.empty(rows, np.uint16)
        self.reordered = np.empty(rows, np.bool_)
        self.of_middleware: dict[str, NDArray[np.int64]] = {}

    def fill(self, here: slice, published: Published, paired: PairedMessages) -> None:
        """Put the messages of an exchange into its rows."""
        self.sequence[here] = published.sequence
        self.stamps["scheduled_ns"][here] = published.scheduled_ns
        self.stamps["publish_ns"][here] = published.publish_ns
        self.stamps["receive_ns"][here] = paired.receive_ns
        self.stamps["relay_in_ns"][here] = paired.relay_in_ns
        self.stamps["relay_out_ns"][here] = paired.relay_out_ns
        self.outcome[here] = paired.outcome
        self.duplicates[here] = paired.duplicates
        self.reordered[here] = paired.reordered

    def fill_middleware(self, here: slice, names: Sequence[str], stamps: Sequence[NDArray[np.int64]]) -> None:
        """Put the middleware's stamps of an exchange into its rows."""
        for name, values in zip(names, stamps, strict=True):
            if name not in self.of_middleware:
                self.of_middleware[name] = np.zeros(len(self.sequence), np.int64)
            self.of_middleware[name][here] = values

    def measured(self, one_way: OneWay) -> pl.DataFrame:
        """Return the columns of `columns.MEASURED_COLUMNS`."""
        return with_metrics(
            pl.DataFrame({"sequence": self.sequence}).with_columns(
                *(_null_where_missing(name, values) for name, values in self.stamps.items()),
                _outcome_names(self.outcome),
                pl.Series("duplicates", self.duplicates),
                pl.Series("reordered", self.reordered),
                *one_way.columns,
            )
        )


def pair_exchanges(
    exchanges: Sequence[Exchange], events: Mapping[EventKey, EventColumns], *, details: bool = True
) -> RoundTrips:
    """Pair the events of every exchange, count them, and compute the metrics of every round trip.

    Args:
        exchanges: some exchanges.
        events: for each of their `event_keys` the events.
        details: fit clocks and keep the middleware's stamps; without, the columns of one-way times are null.
    """
    # A run's messages are the same for each of its relays.
    of_run = {e.run.run_id: e for e in exchanges}
    published = {
        run_id: published_messages(events[exchange.event_keys()[0]], exchange.run.warmup_messages)
        for run_id, exchange in of_run.items()
    }
    lengths = [len(published[exchange.run.run_id]) for exchange in exchanges]
    bounds = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    rows = _Rows(int(bounds[-1]))
    counts = []
    for position, exchange in enumerate(exchanges):
        here, messages = slice(*bounds[position : position + 2].tolist()), published[exchange.run.run_id]
        _, t2, t3, t4 = (events[key] for key in exchange.event_keys())
        paired = pair_messages(messages, t2, t3, t4)
        rows.fill(here, messages, paired)
        counts.append(count_messages(messages, paired))
        if details:
            for stage, of_stage, instant_ns in (
                (Stage.T3, t3, paired.relay_in_ns),
                (Stage.T2, t2, paired.receive_ns),
            ):
                stamps = middleware_stamps(messages, of_stage, instant_ns)
                if stamps is not None:
                    rows.fill_middleware(here, MIDDLEWARE_STAMPS[stage], stamps)
    one_way = (
        fit_exchanges(exchanges, bounds, rows.stamps)
        if details
        else OneWay.unknown(int(bounds[-1]), len(exchanges))
    )
    return RoundTrips(
        measured=rows.measured(one_way),
        described=_described(exchanges),
        outcome=rows.outcome,
        bounds=bounds,
        counts=pl.DataFrame(counts, schema=COUNT_SCHEMA),
        stamps=tuple(pl.Series(name, values) for name, values in rows.of_middleware.items()),
        clock_fits=one_way.fits,
    )


def _described(exchanges: Sequence[Exchange]) -> pl.DataFrame:
    return pl.DataFrame(
        [(e.run.run_id, e.relay_id, *e.parameters().values()) for e in exchanges],
        schema=schema_of((*KEY_COLUMNS[:2], *PARAMETER_COLUMNS)),
        orient="row",
    )


def _null_where_missing(name: str, values: NDArray[np.int64]) -> pl.Series:
    series = pl.Series(name, values)
    missing = values == MISSING
    return series.set(pl.Series(missing), None) if missing.any() else series


def _outcome_names(codes: NDArray[np.uint8]) -> pl.Series:
    names = pl.Series([outcome.value for outcome in OUTCOMES])
    return names.gather(codes.astype(np.uint32)).alias("outcome")
