"""What is computed group by group: the one door between the engine, which brings rows, and the frames made of them.

The engine cuts a campaign into batches of whole groups that fit into memory, on one machine or on many. So every
frame here must come out the same whatever other groups share its batch: a row may depend on its own group alone.
The frames of all batches, put one behind the other in the order of groups, are the frames of the campaign.

A new frame is a function of a `Batch` and a line in `MAKERS`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import polars as pl

from analyzer.timeline import draw_timeline

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from analyzer.roundtrips import RoundTrips

    Frames = dict[str, pl.DataFrame]
    """Name -> frame; the names are those of `MAKERS`."""


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """All exchanges of some groups, paired.

    Attributes:
        roundtrips: their rows by group, then by start of the run, then by relay, then by sequence; each exchange
            in it has its run, its sessions and its events.
        group_of_exchange: uint32, rising: the group of each exchange, numbered throughout the campaign as the
            rows of `summary` are.
        all_exchanges: exchanges of the whole campaign, for what must share something (points to draw).
        whole: False for a part of the one group that is larger than memory: it comes in several batches, each
            with whole runs. What cannot be told from a part of a group gives no rows then.
    """

    roundtrips: RoundTrips
    group_of_exchange: NDArray[np.uint32]
    all_exchanges: int
    whole: bool = True

    def group_of_row(self) -> NDArray[np.uint32]:
        """For each row of `roundtrips.frame` the number of its group."""
        return self.roundtrips.per_row(self.group_of_exchange)


def _timeline(batch: Batch) -> pl.DataFrame:
    return draw_timeline(batch.roundtrips, batch.group_of_exchange, batch.all_exchanges)


MAKERS: Mapping[str, Callable[[Batch], pl.DataFrame]] = {
    "timeline": _timeline,
}
"""Name -> how it is made from a batch. A frame of no rows has its columns all the same."""


def frames_of(batch: Batch) -> Frames:
    """Every frame of one batch."""
    return {name: make(batch) for name, make in MAKERS.items()}


def concatenate_frames(parts: Sequence[Frames]) -> Frames:
    """The frames of the campaign from those of its batches (at least one), in their order."""
    return {name: pl.concat([part[name] for part in parts]) for name in MAKERS}
