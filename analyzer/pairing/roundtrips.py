"""The frame `roundtrips`: one row per published message and relay that took part in its run."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, TypeVar

import numpy as np
import polars as pl

from ..model.column import schema_of
from ..model.columns import KEY_COLUMNS, ROUNDTRIP_COLUMNS
from ..model.metrics import with_metrics
from ..model.parameters import PARAMETER_COLUMNS
from .one_way import OneWay, fit_exchanges
from .pair import MISSING, OUTCOMES, Published, pair_messages, published_messages

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from ..clocks.fit import ClockFit
    from .exchanges import Exchange


Scalar = TypeVar("Scalar", bound=np.generic)

_STAMPS = ("scheduled_ns", "publish_ns", "receive_ns", "relay_in_ns", "relay_out_ns")


@dataclass(frozen=True, eq=False)
class RoundTrips:
    """Paired events of some exchanges.

    Attributes:
        measured: `sequence` and the columns of `columns.MEASURED_COLUMNS`; rows by exchange, then by sequence.
        described: run_id, relay_id and the parameter columns, one row per exchange.
        exchanges: in the order of their rows, with their events.
        outcome: uint8, for each row the position of its outcome in `pair.OUTCOMES`.
        bounds: int64, exchange i has the rows `bounds[i]` to `bounds[i + 1]` (not included).
        published: the counted messages of each exchange's run.
        orphans: int64, T2, T3 and T4 events of each exchange whose message has no T1.
        clock_fits: of each exchange by its own messages; None without a message to fit, or where not asked for.
    """

    measured: pl.DataFrame
    described: pl.DataFrame
    exchanges: tuple[Exchange, ...]
    outcome: NDArray[np.uint8]
    bounds: NDArray[np.int64]
    published: tuple[Published, ...]
    orphans: NDArray[np.int64]
    clock_fits: tuple[ClockFit | None, ...]

    @cached_property
    def frame(self) -> pl.DataFrame:
        """The columns of `columns.ROUNDTRIP_COLUMNS`, made when first wanted: texts take more memory than numbers."""
        described = _repeated(self.described, np.diff(self.bounds))
        return self.measured.with_columns(*described).select(column.name for column in ROUNDTRIP_COLUMNS)

    def counted(self) -> PairedExchanges:
        """What pairing has to say beside the rows."""
        return PairedExchanges(
            tuple(exchange.without_events() for exchange in self.exchanges),
            tuple(published.counts_only() for published in self.published),
            self.orphans,
        )

    def per_row(self, values: NDArray[Scalar]) -> NDArray[Scalar]:
        """A value of each exchange, repeated for each of its rows."""
        return np.repeat(values, np.diff(self.bounds))

    def exchange_of_row(self) -> NDArray[np.uint32]:
        """For each row the position of its exchange."""
        return self.per_row(np.arange(len(self.exchanges), dtype=np.uint32))


@dataclass(frozen=True, slots=True, eq=False)
class PairedExchanges:
    """All exchanges and what pairing counted of each, without events and rows.

    Attributes:
        exchanges: in the order of their rows, without events.
        published: the messages of each exchange's run; counts only.
        orphans: int64, T2, T3 and T4 events of each exchange whose message has no T1.
    """

    exchanges: tuple[Exchange, ...]
    published: tuple[Published, ...]
    orphans: NDArray[np.int64]

    @classmethod
    def concatenate(cls, parts: Sequence[PairedExchanges]) -> PairedExchanges:
        """The exchanges of all parts (at least one), one after the other."""
        return cls(
            tuple(exchange for part in parts for exchange in part.exchanges),
            tuple(published for part in parts for published in part.published),
            np.concatenate([part.orphans for part in parts]),
        )


def pair_exchanges(exchanges: Sequence[Exchange], *, one_way: bool = True) -> RoundTrips:
    """Pair the events of every exchange and compute the metrics of every round trip.

    Args:
        exchanges: with their events.
        one_way: fit clocks; without, the columns of one-way times are null.
    """
    published = _published_by_run(exchanges)
    counted = [published[exchange.run.run_id] for exchange in exchanges]
    bounds = np.concatenate([[0], np.cumsum([len(p) for p in counted])]).astype(np.int64)
    rows = int(bounds[-1])
    orphans = np.zeros(len(exchanges), np.int64)

    # Filled exchange by exchange: the frame's memory once, whatever the number of runs.
    sequence = np.empty(rows, np.uint64)
    stamps = {name: np.empty(rows, np.int64) for name in _STAMPS}
    outcome = np.empty(rows, np.uint8)
    duplicates = np.empty(rows, np.uint16)
    reordered = np.empty(rows, np.bool_)
    for position, (exchange, of_run) in enumerate(zip(exchanges, counted, strict=True)):
        here = slice(*bounds[position : position + 2])
        paired = pair_messages(of_run, exchange.t2, exchange.t3, exchange.t4)
        sequence[here] = of_run.sequence
        stamps["scheduled_ns"][here] = of_run.scheduled_ns
        stamps["publish_ns"][here] = of_run.publish_ns
        stamps["receive_ns"][here] = paired.receive_ns
        stamps["relay_in_ns"][here] = paired.relay_in_ns
        stamps["relay_out_ns"][here] = paired.relay_out_ns
        outcome[here] = paired.outcome
        duplicates[here] = paired.duplicates
        reordered[here] = paired.reordered
        orphans[position] = paired.orphans

    described = pl.DataFrame(
        [(e.run.run_id, e.relay_id, *e.parameters().values()) for e in exchanges],
        schema=schema_of((*KEY_COLUMNS[:2], *PARAMETER_COLUMNS)),
        orient="row",
    )
    clocks = (
        fit_exchanges(exchanges, bounds, stamps, MISSING) if one_way else OneWay.unknown(rows, len(exchanges))
    )
    measured = with_metrics(
        pl.DataFrame({"sequence": sequence}).with_columns(
            *(_null_where_missing(name, values) for name, values in stamps.items()),
            _outcome_names(outcome),
            pl.Series("duplicates", duplicates),
            pl.Series("reordered", reordered),
            *clocks.columns,
        )
    )
    return RoundTrips(
        measured=measured,
        described=described,
        exchanges=tuple(exchanges),
        outcome=outcome,
        bounds=bounds,
        published=tuple(counted),
        orphans=orphans,
        clock_fits=clocks.fits,
    )


def _published_by_run(exchanges: Sequence[Exchange]) -> dict[int, Published]:
    """A run's messages are the same for each of its relays."""
    published: dict[int, Published] = {}
    for exchange in exchanges:
        run = exchange.run
        if run.run_id not in published:
            published[run.run_id] = published_messages(exchange.t1, run.warmup_messages)
    return published


def _repeated(described: pl.DataFrame, counts: NDArray[np.int64]) -> Iterator[pl.Series | pl.Expr]:
    """Each column of `described` with every value repeated; one that is the same throughout takes no memory."""
    exchange = pl.Series(np.repeat(np.arange(described.height, dtype=np.uint32), counts))
    for column in described.iter_columns():
        if column.n_unique() == 1 and len(exchange):
            yield pl.lit(column[0], column.dtype).alias(column.name)
        else:
            yield column.gather(exchange)


def _null_where_missing(name: str, values: NDArray[np.int64]) -> pl.Series:
    series = pl.Series(name, values)
    missing = values == MISSING
    return series.set(pl.Series(missing), None) if missing.any() else series


def _outcome_names(codes: NDArray[np.uint8]) -> pl.Series:
    names = pl.Series([outcome.value for outcome in OUTCOMES])
    return names.gather(codes.astype(np.uint32)).alias("outcome")
