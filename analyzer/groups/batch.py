"""What the engine hands to those who make frames: exchanges of some groups, paired, and what is asked for."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ..pairing.roundtrips import RoundTrips
    from ..verdicts.job import Job


@dataclass(frozen=True, slots=True)
class Wanted:
    """What is asked for beside rows and summary.

    Attributes:
        details: one-way times and the frames of `frames.DETAIL_MAKERS`; without, they take no time and have no rows.
        deadline_ns: a message later than this, or lost, misses its deadline; None judges none.
        job: what to recommend settings for.
    """

    details: bool = True
    deadline_ns: int | None = None
    job: Job | None = None


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
        wanted: what is asked for.
    """

    roundtrips: RoundTrips
    group_of_exchange: NDArray[np.uint32]
    all_exchanges: int
    whole: bool = True
    wanted: Wanted = field(default_factory=Wanted)

    def group_of_row(self) -> NDArray[np.uint32]:
        """For each row of `roundtrips.frame` the number of its group."""
        return self.roundtrips.per_row(self.group_of_exchange)
