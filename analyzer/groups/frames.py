"""The table of frames that are computed group by group.

The engine cuts a campaign into batches of whole groups that fit into memory, on one machine or on many. So every
frame here must be the same whatever other groups share its batch: a row may depend on its own group alone, those of
`CAMPAIGN_MAKERS` also on how many exchanges the campaign has.
The frames of all batches, put one behind the other in the order of groups, are the frames of the campaign.

A new frame is a function of a batch and its round trips, and a line in one of the tables.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import polars as pl

from .breakdown import breakdown_frame, response_frame
from .freshness import freshness_frame, outage_frame
from .intervals import interval_frame, knot_frame, one_way_frame
from .sending import sending_frame
from .shapes import shape_frame
from .timeline import run_frame, timeline_frame

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from concurrent.futures import Executor

    from ..pairing.roundtrips import PairedRows, RoundTrips
    from .batch import Batch

    Frames = dict[str, pl.DataFrame]
    """Name -> frame; the names are those of `CAMPAIGN_MAKERS`, `MAKERS` and, where asked for, `DETAIL_MAKERS`."""

    RunMaker = Callable[[Batch, RoundTrips], pl.DataFrame]
    """Rows of a run follow from this run, whose columns are all looked at."""
    GroupMaker = Callable[[Batch, PairedRows], pl.DataFrame]
    """A row follows from all runs of its group, of which a column at a time is looked at."""

Rows = TypeVar("Rows")

CAMPAIGN_MAKERS: Mapping[str, RunMaker] = {"timeline": timeline_frame}
"""Name -> how it is made from a batch, one of a campaign of so many exchanges (`Batch.all_exchanges`)."""

MAKERS: Mapping[str, RunMaker] = {"run_times": run_frame, "sending": sending_frame}
"""Name -> how it is made from a batch. A frame of no rows has its columns all the same."""

RUN_DETAIL_MAKERS: Mapping[str, RunMaker] = {
    "freshness": freshness_frame,
    "outages": outage_frame,
    "shapes": shape_frame,
}
GROUP_DETAIL_MAKERS: Mapping[str, GroupMaker] = {
    "intervals": interval_frame,
    "one_way": one_way_frame,
    "breakdown": breakdown_frame,
    "responses": response_frame,
    "clock_knots": knot_frame,
}
DETAIL_MAKERS: Mapping[str, RunMaker] = {**RUN_DETAIL_MAKERS, **GROUP_DETAIL_MAKERS}
"""The same for frames that take more time than rows and summary together: made only where they are asked for."""

_BY_RUN_ID = ("freshness", "outages")
"""Frames whose runs stand by `run_id` in a group, not by their start."""


def begin_frames(
    makers: Mapping[str, Callable[[Batch, Rows], pl.DataFrame]],
    batch: Batch,
    roundtrips: Rows,
    pool: Executor,
) -> dict[str, Callable[[], pl.DataFrame]]:
    """Begin the frames of one batch that one of the tables names; each waits for its own when it is called.

    Args:
        makers: how they are made.
        batch: the batch.
        roundtrips: its rows.
        pool: makes each of them.
    """
    return {name: pool.submit(make, batch, roundtrips).result for name, make in makers.items()}


def concatenate_frames(parts: Sequence[Frames]) -> Frames:
    """Return the frames of the campaign from those of its batches (at least one), in their order."""
    frames = {name: pl.concat([part[name] for part in parts]) for name in parts[0]}
    for name in frames.keys() & _BY_RUN_ID:  # of a group that came in parts
        frames[name] = frames[name].sort("group", "run_id", "relay_id", maintain_order=True)
    return frames
