"""Age of information: how old the newest information at a receiver is, over time.

S. Kaul, R. Yates, M. Gruteser, "Real-time status: how often should one update?", INFOCOM 2012.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..pairing.pair import chosen_of

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class AgeOfInformation:
    """Age of the newest information at a receiver, from the first reception to the last.

    Attributes:
        mean_ns: average over time.
        peak_mean_ns: average over the peaks, each just before newer information arrived.
        peak_max_ns: the highest peak.
        updates: receptions that brought newer information than any before.
    """

    mean_ns: float
    peak_mean_ns: float
    peak_max_ns: int
    updates: int


def age_of_information(
    generated_ns: NDArray[np.int64], received_ns: NDArray[np.int64]
) -> AgeOfInformation | None:
    """Compute the age of information from the times at which messages were made and received, on one clock.

    The age rises by a second each second and falls to `received - generated` when a newer message arrives, a
    saw-tooth: between updates k and k + 1 it goes from `r[k] - g[k]` to the peak `r[k+1] - g[k]`. An older
    message that comes late changes nothing.

    Args:
        generated_ns: int64, of the messages that were received.
        received_ns: int64, likewise.

    Returns:
        None with fewer than two updates: there is no time to average over.
    """
    generated, received = generated_ns, received_ns
    if not (_rises(received) and _rises(generated)):
        generated, received = _updates(generated, received)
    if len(received) < 2:
        return None
    peaks = received[1:] - generated[:-1]
    # In place: of a long run each of these arrays has forty megabytes.
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


def _rises(times: NDArray[np.int64]) -> bool:
    return bool((times[1:] > times[:-1]).all())


def _updates(
    generated: NDArray[np.int64], received: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the times of the receptions that brought newer information than any before, in their order."""
    order = np.lexsort((generated, received))
    generated, received = generated[order], received[order]
    newer = np.ones(len(generated), np.bool_)
    newer[1:] = generated[1:] > np.maximum.accumulate(generated)[:-1]
    generated, received = chosen_of(newer, generated), chosen_of(newer, received)
    # Of several updates at one instant the last counts: the others never were the newest for any time.
    last = np.ones(len(received), np.bool_)
    last[:-1] = received[1:] != received[:-1]
    return chosen_of(last, generated), chosen_of(last, received)
