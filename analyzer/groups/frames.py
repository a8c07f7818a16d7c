"""The table of frames that are computed group by group.

The engine cuts a campaign into batches of whole groups that fit into memory, on one machine or on many. So every
frame here must be the same whatever other groups share its batch: a row may depend on its own group alone, those of
`CAMPAIGN_MAKERS` also on how many exchanges the campaign has.
The frames of all batches, put one behind the other in the order of groups, are the frames of the campaign.

A new frame is a function of a batch and its round trips, and a line in one of the three tables.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

from .breakdown import breakdown_frame, response_frame
from .freshness import freshness_frame, outage_frame
from .intervals import interval_frame, knot_frame, one_way_frame
from .run_rows import run_frame
from .sending import sending_frame
from .shapes import shape_frame
from .timeline import timeline_frame

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from concurrent.futures import Executor

    from ..pairing.roundtrips import RoundTrips
    from .batch import Batch

    Frames = dict[str, pl.DataFrame]
    """Name -> frame; the names are those of `CAMPAIGN_MAKERS`, `MAKERS` and, where asked for, `DETAIL_MAKERS`."""

    Maker = Callable[[Batch, RoundTrips], pl.DataFrame]

CAMPAIGN_MAKERS: Mapping[str, Maker] = {"timeline": timeline_frame}
"""Name -> how it is made from a batch, one of a campaign of so many exchanges (`Batch.all_exchanges`)."""

MAKERS: Mapping[str, Maker] = {"run_times": run_frame, "sending": sending_frame}
"""Name -> how it is made from a batch. A frame of no rows has its columns all the same."""

DETAIL_MAKERS: Mapping[str, Maker] = {
    "intervals": interval_frame,
    "one_way": one_way_frame,
    "breakdown": breakdown_frame,
    "responses": response_frame,
    "freshness": freshness_frame,
    "outages": outage_frame,
    "clock_knots": knot_frame,
    "shapes": shape_frame,
}
"""The same for frames that take more time than rows and summary together: made only where they are asked for."""


def make_frames(makers: Mapping[str, Maker], batch: Batch, roundtrips: RoundTrips) -> Frames:
    """Make the frames of one batch that one of the tables names."""
    return {name: make(batch, roundtrips) for name, make in makers.items()}


def detail_frames(batch: Batch, roundtrips: RoundTrips, pool: Executor) -> Frames:
    """Make the frames of one batch that take time; they depend on its exchanges, their events and the deadline alone.

    Args:
        batch: the batch.
        roundtrips: its rows.
        pool: makes each of them.
    """
    begun = {name: pool.submit(make, batch, roundtrips) for name, make in DETAIL_MAKERS.items()}
    return {name: frame.result() for name, frame in begun.items()}


def concatenate_frames(parts: Sequence[Frames]) -> Frames:
    """Return the frames of the campaign from those of its batches (at least one), in their order."""
    return {name: pl.concat([part[name] for part in parts]) for name in parts[0]}
