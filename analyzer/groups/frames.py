"""What is computed group by group: the one door between the engine, which brings rows, and the frames made of them.

The engine cuts a campaign into batches of whole groups that fit into memory, on one machine or on many. So every
frame here must come out the same whatever other groups share its batch: a row may depend on its own group alone.
The frames of all batches, put one behind the other in the order of groups, are the frames of the campaign.

A new frame is a function of a `Batch` and a line in `MAKERS`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

from .interval_frames import (
    breakdown_frame,
    freshness_frame,
    interval_frame,
    knot_frame,
    one_way_frame,
    outage_frame,
    response_frame,
)
from .timeline import draw_timeline

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from .batch import Batch

    Frames = dict[str, pl.DataFrame]
    """Name -> frame; the names are those of `MAKERS` and, where asked for, of `DETAIL_MAKERS`."""


def _timeline(batch: Batch) -> pl.DataFrame:
    return draw_timeline(batch.roundtrips, batch.group_of_exchange, batch.all_exchanges)


MAKERS: Mapping[str, Callable[[Batch], pl.DataFrame]] = {
    "timeline": _timeline,
}
"""Name -> how it is made from a batch. A frame of no rows has its columns all the same."""

DETAIL_MAKERS: Mapping[str, Callable[[Batch], pl.DataFrame]] = {
    "intervals": interval_frame,
    "one_way": one_way_frame,
    "breakdown": breakdown_frame,
    "responses": response_frame,
    "freshness": freshness_frame,
    "outages": outage_frame,
    "clock_knots": knot_frame,
}
"""The same for frames that take more time than rows and summary together: made only where they are asked for."""


def frames_of(batch: Batch) -> Frames:
    """Every frame of one batch that is asked for."""
    makers = {**MAKERS, **DETAIL_MAKERS} if batch.wanted.details else MAKERS
    return {name: make(batch) for name, make in makers.items()}


def concatenate_frames(parts: Sequence[Frames]) -> Frames:
    """The frames of the campaign from those of its batches (at least one), in their order."""
    return {name: pl.concat([part[name] for part in parts]) for name in parts[0]}
