"""What was measured of one setup with one message, or of one topic, by run."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
import polars as pl
from numpy.typing import NDArray

from ..model.names import is_topic
from ..model.parameters import ParameterValue
from ..model.runs import UNSENT, RunRows, delivered_runs, split_runs
from ..run_statistics.between_runs import Estimate, Scale, estimates_of_runs, scale_of
from ..run_statistics.runs import Run, Runs, Statistic, joined_runs
from ..run_statistics.setups import RunLogarithms

Made = TypeVar("Made")

LEAST_OF_A_RUN = 0.5
"""Share of the messages of a group's longest run below which an unfinished run is left out: it would weigh like a whole one."""


@dataclass(frozen=True, eq=False)
class SetupRuns:
    """What was measured of one setup with one message, or of one topic that a tap heard, by run.

    Attributes:
        estimates: of the latency, by percentile: what setups are ranked by, and remains where `runs` are left out.
        received: of each message of each run whether it came back; `outside` without the ones that an outage of the sweep took.
        repeats: of the sweep, of each run; empty where two are equal or one is unknown.
        starts_ns: of the runs, by one clock; empty where one is unknown.
        groups: rows of `summary`.
        published: messages that were sent.
        unfinished: runs without an end, the fragments that are left out included.
        bound_ns: largest error of the times of a topic.
    """

    estimates: Mapping[str, Estimate] = field(default_factory=dict)
    runs: tuple[RunRows, ...] = ()
    received: tuple[NDArray[np.bool_], ...] = ()
    outside: tuple[NDArray[np.bool_], ...] = ()
    repeats: tuple[int, ...] = ()
    starts_ns: tuple[int, ...] = ()
    survivors_ns: Mapping[str, float | None] = field(default_factory=dict)
    setting: Mapping[str, ParameterValue] = field(default_factory=dict)
    groups: tuple[int, ...] = ()
    published: int = 0
    unfinished: int = 0
    is_topic: bool = False
    bound_ns: int = 0
    _made: dict[object, Any] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, rows: pl.DataFrame, unfinished: Collection[int] = ()) -> SetupRuns:
        runs = split_runs(rows)
        least = LEAST_OF_A_RUN * max((len(run.rows) for run in runs), default=0)
        whole = tuple(run for run in runs if run.run_id not in unfinished or len(run.rows) >= least)
        heard = "bound_ns" in rows.columns and len(rows) > 0 and is_topic(rows["data_type"][0])
        bound_ns = rows["bound_ns"].max() if heard else None
        return cls(
            runs=whole,
            received=tuple(run.received for run in whole),
            published=int((rows["outcome"] != UNSENT).sum()),
            unfinished=sum(run.run_id in unfinished for run in runs),
            is_topic=heard,
            bound_ns=bound_ns if isinstance(bound_ns, int) else 0,
        )

    @property
    def group(self) -> int | None:
        return self.groups[0] if self.groups else None

    def _once(self, key: object, make: Callable[[], Made]) -> Made:
        if key not in self._made:
            self._made[key] = make()
        made: Made = self._made[key]
        return made

    def delivered(self, metric: str) -> Runs:
        return self._once(metric, lambda: Runs.of(delivered_runs(self.runs, metric)))

    def estimates_of(self, metric: str, statistics: Sequence[Statistic], confidence: float) -> list[Estimate]:
        key = metric, tuple(statistics), confidence
        return self._once(key, lambda: estimates_of_runs(self.delivered(metric), statistics, confidence))

    def survivors(self, metric: str) -> Run:
        if all(run.is_whole(metric) for run in self.runs):  # sorted already
            return self.delivered(metric).joined.runs[0]
        return self._once(("survivors", metric), lambda: joined_runs([run.survivors(metric) for run in self.runs]))

    def of_survivors(self, metric: str, statistic: Statistic) -> float | None:
        series = self.survivors(metric)
        return statistic.of_run(series) if len(series) >= statistic.needs else None

    @property
    def received_share(self) -> float:
        messages = sum(map(len, self.received))
        return sum(int(run.sum()) for run in self.received) / messages if messages else 0.0

    @property
    def is_dead(self) -> bool:
        return bool(self.received) and not any(run.any() for run in self.received)

    def logarithms(self, percentile: str) -> RunLogarithms | None:
        """Return the logarithms of the runs' percentiles; None below three runs, and where one is infinite or not above zero."""
        units = self.estimates[percentile].units
        if units is None or scale_of(units.values) is not Scale.LOGARITHM:
            return None
        logarithms = np.log(units.values)
        if len(self.repeats) != len(units):
            return RunLogarithms(logarithms, tuple(range(len(units))))
        order = np.argsort(self.repeats)
        return RunLogarithms(logarithms[order], tuple(sorted(self.repeats)))
