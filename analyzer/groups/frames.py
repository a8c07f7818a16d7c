"""The table of frames that are computed group by group.

Frames of batches, made on one machine or many, are concatenated. So a row may depend on its own group only (of the timeline
also on the number of exchanges).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import polars as pl

from ..pairing.roundtrips import RoundTrips
from .batch import Batch
from .breakdown import breakdown_frame, response_frame
from .freshness import freshness_frame, outage_frame
from .intervals import knot_frame
from .sending import sending_frame
from .shapes import shape_frame
from .timeline import run_frame, timeline_frame

Maker = Callable[[Batch, RoundTrips], pl.DataFrame]

Frames = dict[str, pl.DataFrame]
"""Name in `MAKERS` or, where requested, `DETAIL_MAKERS` -> frame."""

MAKERS: Mapping[str, Maker] = {"timeline": timeline_frame, "run_times": run_frame, "sending": sending_frame}
"""Makers of the frames of a batch; an empty frame has its columns, too."""

DETAIL_MAKERS: Mapping[str, Maker] = {
    "freshness": freshness_frame,
    "outages": outage_frame,
    "shapes": shape_frame,
    "breakdown": breakdown_frame,
    "responses": response_frame,
    "clock_knots": knot_frame,
}
"""Frames that take more time than rows and summary together: made only on request, as the frames of `measure_whole` are."""

_BY_RUN_ID = ("freshness", "outages")
"""Frames that order the runs of a group by `run_id`, not by their start."""


def concatenate_frames(parts: Sequence[Frames]) -> Frames:
    frames = {name: pl.concat([part[name] for part in parts]) for name in parts[0]}
    for name in frames.keys() & _BY_RUN_ID:  # a group may come in parts
        frames[name] = frames[name].sort("group", "run_id", "relay_id", maintain_order=True)
    return frames
