"""Groups of exchanges with equal parameters, and batches of groups."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from ..loading.event_index import EventKey
from ..model.applied import words_not_applied
from ..model.metrics import METRICS, schema_of
from ..model.parameters import PARAMETER_COLUMNS, Parameters
from ..pairing.exchanges import Exchange
from ..pairing.roundtrips import RoundTrips
from ..verdicts.job import Job
from ..verdicts.ranking import RankingOptions

DEADLINE_METRIC = "response"
"""Default metric of a deadline: what a user with a schedule waits for."""

DEADLINE_METRICS = (*METRICS, "outbound", "return")


WHOLE_GROUP_EVENTS = 24_000_000
"""A group with more events is processed in parts of whole runs; this many take 2 GB."""


@dataclass(frozen=True, slots=True, eq=False)
class Grouping:
    """Exchanges by group, start of the run and relay; groups are sorted by their parameters, null last."""

    parameters: pl.DataFrame
    exchanges: tuple[Exchange, ...]
    group_of_exchange: NDArray[np.uint32]

    def not_applied(self) -> tuple[int, ...]:
        barred = {
            int(group)
            for exchange, group in zip(self.exchanges, self.group_of_exchange, strict=True)
            for session in (exchange.ping, exchange.relay)
            if session is not None and words_not_applied(session)
        }
        return tuple(sorted(barred))

    def members(self) -> list[list[int]]:
        members: list[list[int]] = [[] for _ in range(self.parameters.height)]
        for exchange, group in enumerate(self.group_of_exchange.tolist()):
            members[group].append(exchange)
        return members


def group_exchanges(exchanges: Sequence[Exchange]) -> Grouping:
    keys = [exchange.parameters() for exchange in exchanges]
    groups = sorted(set(keys), key=Parameters.order)
    number = {key: group for group, key in enumerate(groups)}
    group_of_exchange = np.array([number[key] for key in keys], np.uint32)
    order = np.argsort(group_of_exchange, kind="stable")
    return Grouping(
        pl.DataFrame([key.values() for key in groups], schema=schema_of(PARAMETER_COLUMNS), orient="row"),
        tuple(exchanges[index] for index in order.tolist()),
        group_of_exchange[order],
    )


@dataclass(frozen=True, slots=True)
class AnalysisOptions:
    rows: bool = True
    details: bool = True
    deadline_ns: int | None = None
    deadline_metric: str = DEADLINE_METRIC
    job: Job | None = None
    ranking: RankingOptions = field(default_factory=RankingOptions)


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Some groups, to be processed on any machine; their events are fetched by `event_keys`.

    `all_exchanges` of the campaign share the points of a drawing. A batch that is not `whole` has some runs of a group
    larger than memory; frames that need a whole group are then empty.
    """

    exchanges: tuple[Exchange, ...]
    group_of_exchange: NDArray[np.uint32]
    all_exchanges: int
    whole: bool
    options: AnalysisOptions = field(default_factory=AnalysisOptions)

    @property
    def events(self) -> int:
        return sum(sum(exchange.counts) for exchange in self.exchanges)

    def event_keys(self) -> list[EventKey]:
        return list(dict.fromkeys(key for exchange in self.exchanges for key in exchange.event_keys()))


def described_exchanges(batch: Batch) -> pl.DataFrame:
    exchanges = batch.exchanges
    return pl.DataFrame(
        {
            "exchange": np.arange(len(exchanges), dtype=np.uint32),
            "group": batch.group_of_exchange,
            "run_id": pl.Series([exchange.run.run_id for exchange in exchanges], dtype=pl.UInt64),
            "relay_id": pl.Series([exchange.relay_id for exchange in exchanges], dtype=pl.UInt32),
        }
    )


def columns_by_group(batch: Batch, rows: RoundTrips) -> Iterator[tuple[int, Callable[[str], pl.Series], slice]]:
    groups, bounds = batch.group_of_exchange, rows.bounds.tolist()
    offsets = [*np.unique(groups, return_index=True)[1].tolist(), len(groups)] if batch.whole else []
    for start, end in pairwise(offsets):
        first, after = bounds[start], bounds[end]
        yield int(groups[start]), partial(_part_of_column, rows, first, after), slice(first, after)


def _part_of_column(rows: RoundTrips, first: int, after: int, name: str) -> pl.Series:
    return rows.column(name).slice(first, after - first)


def filled(values: pl.Series, missing: int = 0) -> NDArray[np.int64]:
    return (values.fill_null(missing) if values.null_count() else values).to_numpy()


def present(values: pl.Series) -> NDArray[Any]:
    return (values.drop_nulls() if values.null_count() else values).to_numpy()


def is_present(values: pl.Series) -> NDArray[np.bool_]:
    return values.is_not_null().to_numpy() if values.null_count() else np.ones(len(values), np.bool_)
