"""The campaigns that the analysis is timed with: the shapes that folders of traces have, each of ping and relay on two devices."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from event_traces import write_event_trace

if TYPE_CHECKING:
    from pathlib import Path

EVENTS_OF_MESSAGE = 4  # T1 and T2 of the ping, T3 and T4 of the relay


@dataclass(frozen=True, slots=True)
class Shape:
    """One campaign.

    Attributes:
        name: what the tables call it.
        events: number of events in all traces.
        runs: number of runs.
        pairs: number of pings; each has a relay, and each of both a file.
        groups: number of groups of equal parameters that the runs are of, in turn.
        rate_hz: messages a second of every run.
    """

    name: str
    events: int
    runs: int
    pairs: int
    groups: int
    rate_hz: int

    @property
    def hours(self) -> float:
        """Time that the runs of one ping took."""
        return self.events / self.pairs / EVENTS_OF_MESSAGE / self.rate_hz / 3600

    def of(self, events: int) -> Shape:
        """Return the same runs and files with so many events."""
        return replace(self, events=events)

    def times(self, factor: float) -> Shape:
        """Return the same with so many times the events, as many in each run, file and group."""
        return replace(
            self,
            events=int(self.events * factor),
            runs=max(1, int(self.runs * factor)),
            pairs=max(1, int(self.pairs * factor)) if self.pairs > 1 else 1,
            groups=max(1, int(self.groups * factor)),
        )


STUDY = Shape("500 runs in 2 files over 139 hours", 20_000_000, runs=500, pairs=1, groups=100, rate_hz=10)
ONE_RUN = Shape("one run at 1 kHz", 20_000_000, runs=1, pairs=1, groups=1, rate_hz=1000)
SHORT_RUNS = Shape("2,000 short runs in 4,000 files", 20_000_000, runs=2_000, pairs=2_000, groups=400, rate_hz=100)
MANY_GROUPS = Shape("10,000 groups", 2_000_000, runs=10_000, pairs=1, groups=10_000, rate_hz=10)
SHAPES = {
    "1m": STUDY.times(0.05),
    "4m": STUDY.times(0.2),
    "study": STUDY,
    "one_run": ONE_RUN,
    "two_files": Shape("2,000 short runs in 2 files", 400_000, runs=2_000, pairs=1, groups=400, rate_hz=100),
    "short_runs": SHORT_RUNS.of(4_000_000),
}


def write_campaign(folder: Path, shape: Shape) -> list[Path]:
    """Write the traces of a campaign into a new folder."""
    folder.mkdir(parents=True)
    runs_of_pair = max(1, shape.runs // shape.pairs)
    period_ns = 1_000_000_000 // shape.rate_hz
    periods_of_pair = shape.events // shape.pairs // EVENTS_OF_MESSAGE + shape.rate_hz  # a second between two pings
    return [
        write_event_trace(
            folder / f"{'relay' if relay else 'ping'}{pair}.mcap",
            shape.events // shape.pairs // 2,
            "zstd",
            runs=runs_of_pair,
            seed=1 + 2 * pair + relay,
            relay=relay,
            first_run=pair * runs_of_pair,
            groups=shape.groups,
            period_ns=period_ns,
            first_ns=pair * periods_of_pair * period_ns,
        )
        for pair in range(shape.pairs)
        for relay in (False, True)
    ]
