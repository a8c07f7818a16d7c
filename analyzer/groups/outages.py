"""Age of information at a receiver, and outages: runs of lost messages and the recovery from them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..pairing.pair import chosen_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Int64 = NDArray[np.int64]
    Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class AgeOfInformation:
    """Age of the newest information at a receiver, from the first reception to the last.

    Attributes:
        mean_ns: average over time.
        peak_mean_ns: average of the peaks, each just before newer information arrived.
        peak_max_ns: highest peak.
        updates: receptions of newer information than any before.
    """

    mean_ns: float
    peak_mean_ns: float
    peak_max_ns: int
    updates: int


def age_of_information(generated: Int64, received: Int64) -> AgeOfInformation | None:
    """Compute the age of information from the times (ns) at which received messages were made and received, on one clock.

    The age is a saw-tooth: between updates k and k + 1 it rises from `r[k] - g[k]` to the peak `r[k+1] - g[k]`. An older
    message that comes late changes nothing. None with fewer than two updates: there is no time to average over.
    """
    if not (_is_ascending(received) and _is_ascending(generated)):
        generated, received = _updates(generated, received)
    if len(received) < 2:
        return None
    peaks = received[1:] - generated[:-1]
    # In place: each of these arrays of a long run takes 40 MB.
    area, fallen = peaks.astype(np.float64), (received - generated)[:-1].astype(np.float64)
    peak_mean_ns = float(area.mean())
    area *= area
    fallen *= fallen
    area -= fallen
    area /= 2
    return AgeOfInformation(
        mean_ns=float(area.sum() / float(received[-1] - received[0])),
        peak_mean_ns=peak_mean_ns,
        peak_max_ns=int(peaks.max()),
        updates=len(received),
    )


def _is_ascending(times: Int64) -> bool:
    return bool((times[1:] > times[:-1]).all())


def _updates(generated: Int64, received: Int64) -> tuple[Int64, Int64]:
    """Return the times of the receptions of newer information than any before, in order."""
    order = np.lexsort((generated, received))
    generated, received = generated[order], received[order]
    newer = np.ones(len(generated), np.bool_)
    newer[1:] = generated[1:] > np.maximum.accumulate(generated)[:-1]
    generated, received = chosen_of(newer, generated), chosen_of(newer, received)
    # Of several updates at one instant the last one counts: the others were never the newest.
    last = np.ones(len(received), np.bool_)
    last[:-1] = received[1:] != received[:-1]
    return chosen_of(last, generated), chosen_of(last, received)


OUTAGE_MESSAGES = 3
"""Lost messages in a row that make an outage: single losses are loss, not an outage."""

RECOVERED_MESSAGES = 5
"""Messages in a row in time that end the recovery from an outage."""


def longest_run(happened: Bools) -> int:
    """Return the length of the longest run of True."""
    return max((stop - start for start, stop in runs_of(happened)), default=0)


def runs_of(happened: Bools) -> list[tuple[int, int]]:
    """Return start and stop (one past the end) of each run of True, in order."""
    changes = np.flatnonzero(np.diff(np.concatenate([[False], happened, [False]]).astype(np.int8)))
    return [(int(start), int(stop)) for start, stop in changes.reshape(-1, 2)]


@dataclass(frozen=True, slots=True)
class Outage:
    """A run of lost messages.

    Attributes:
        first_sequence: first lost message.
        messages: number of messages lost in a row.
        start_ns: planned time of the first one (T0, else T1), ping's monotonic clock.
        end_ns: reception of the next message that got through; None if the run ended first.
        recovery_ns: from `end_ns` to the first of `RECOVERED_MESSAGES` messages in a row in time; None if there are none.
    """

    first_sequence: int
    messages: int
    start_ns: int
    end_ns: int | None
    recovery_ns: int | None

    @property
    def duration_ns(self) -> int | None:
        """Time without a new message at the receiver; None if the run ended first."""
        return None if self.end_ns is None else self.end_ns - self.start_ns


def find_outages(
    sequence: NDArray[np.uint64], planned_ns: Int64, receive_ns: Int64, lost: Bools, in_time: Bools
) -> list[Outage]:
    """Find the outages of one run, in order.

    Args:
        sequence: of every published message, ascending.
        planned_ns: planned time of each.
        receive_ns: reception of its reply; any value where `lost`.
        lost: whether no reply was received.
        in_time: whether it was received in time, by deadline or by the usual time of the run.
    """
    outages = []
    good = in_time & ~lost
    for start, stop in runs_of(lost):
        if stop - start < OUTAGE_MESSAGES:
            continue
        end = int(receive_ns[stop]) if stop < len(lost) else None
        recovery = None
        if end is not None:
            steady = (s for s, e in runs_of(good[stop:]) if e - s >= RECOVERED_MESSAGES)
            first = next(steady, None)
            recovery = None if first is None else max(0, int(receive_ns[stop + first]) - end)
        outages.append(Outage(int(sequence[start]), stop - start, int(planned_ns[start]), end, recovery))
    return outages
