"""A batch: the exchanges of some groups that are worked at together, and what is asked for."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import polars as pl

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy as np
    from numpy.typing import NDArray

    from ..loading.events import EventKey
    from ..pairing.exchanges import Exchange
    from ..pairing.roundtrips import RoundTrips
    from ..verdicts.job import Job


@dataclass(frozen=True, slots=True)
class Wanted:
    """What is asked for beside the summary.

    Attributes:
        rows: the rows of `roundtrips`; without, groups have histograms only.
        details: one-way times and the frames of `frames.DETAIL_MAKERS`; without, they take no time and have no rows.
        deadline_ns: a message later than this, or lost, misses its deadline; None judges none.
        job: what to recommend settings for.
    """

    rows: bool = True
    details: bool = True
    deadline_ns: int | None = None
    job: Job | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """What it takes to work at some groups, on whatever machine; the events are fetched by `event_keys`.

    Attributes:
        exchanges: by group, then by start of the run, then by relay.
        group_of_exchange: uint32, rising: the group of each exchange, numbered throughout the campaign as the
            rows of `summary` are.
        all_exchanges: exchanges of the whole campaign, for what must share something (points to draw).
        whole: False for a part of the one group that is larger than memory: it comes in several batches, each
            with whole runs. What cannot be told from a part of a group gives no rows then.
        wanted: what is asked for.
    """

    exchanges: tuple[Exchange, ...]
    group_of_exchange: NDArray[np.uint32]
    all_exchanges: int
    whole: bool
    wanted: Wanted = field(default_factory=Wanted)

    def event_keys(self) -> list[EventKey]:
        """Return the keys of its exchanges' events in the event index, each once."""
        return list(dict.fromkeys(key for exchange in self.exchanges for key in exchange.event_keys()))


def grouped_rows(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
    """Return the measured columns with `group`, run_id, relay_id, bridge and rate_hz.

    No other parameters, as texts take more memory than numbers.
    """
    exchange = roundtrips.exchange_of_row()
    return roundtrips.measured.with_columns(
        pl.Series("group", roundtrips.per_row(batch.group_of_exchange)),
        *(roundtrips.described[n].gather(exchange) for n in ("run_id", "relay_id", "bridge", "rate_hz")),
    )


def rows_by_group(batch: Batch, roundtrips: RoundTrips) -> Iterator[tuple[int, pl.DataFrame]]:
    """Yield each group and its measured rows; nothing of a group that is here in part."""
    if not batch.whole:
        return
    groups, bounds = batch.group_of_exchange, roundtrips.bounds
    for group in dict.fromkeys(groups.tolist()):
        members = (groups == group).nonzero()[0]
        first, after = int(bounds[members[0]]), int(bounds[members[-1] + 1])
        yield group, roundtrips.measured.slice(first, after - first)


def with_group(batch: Batch, roundtrips: RoundTrips, of_runs: pl.DataFrame) -> pl.DataFrame:
    """Put the group of each run and relay before the columns of `of_runs`, and sort by it."""
    groups = roundtrips.described.select("run_id", "relay_id").with_columns(
        pl.Series("group", batch.group_of_exchange)
    )
    return (
        of_runs.join(groups, on=["run_id", "relay_id"], how="left", maintain_order="left")
        .sort("group", maintain_order=True)
        .select("group", *of_runs.columns)
    )
