"""Which groups of two sides are compared (equal parameters, or `--against`), and what was measured of each."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
import polars as pl
from numpy.typing import NDArray

from dds_trace.tracefile.format.descriptions import Run as RunDescription

from ..model.names import group_words, is_topic, value_word, varying_parameters
from ..model.parameters import ParameterValue
from ..model.runs import UNSENT, RunRows, delivered_runs, split_runs
from ..model.setting import without_relay
from ..run_statistics.between_runs import Estimate, Scale, estimates_of_runs, scale_of
from ..run_statistics.runs import Run, Runs, Statistic, joined_runs
from ..run_statistics.setups import RunLogarithms
from .cases import partition_groups

Key = tuple[ParameterValue, ...]
"""Values of the match columns."""

Made = TypeVar("Made")

DEVICE_COLUMNS = ("ping_device", "relay_device")

RELAY_COLUMNS = ("relay_vendor", "relay_backend", "relay_device", "relay_domain_id")
"""Columns that are null without the relay's trace, and match any value then."""

SETTING = "setting"
"""Column with, among others, the relay's options that differ from the ping's, and the number of relays."""

CELL_LABEL = "cell"
"""Label of a run with the name of its cell, without the number of the repeat."""

AGAINST_LABEL = "against"
"""Label of a run with the name of the base's cell that it was interleaved with."""


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


def replaced_devices(base: pl.DataFrame, new: pl.DataFrame) -> Mapping[str, str]:
    """Return column -> name on the base that the only device of the new side takes; empty where a side has several."""
    names = {column: (_names(base, column), _names(new, column)) for column in DEVICE_COLUMNS}
    if any(len(side) > 1 for sides in names.values() for side in sides):
        return {}
    return {column: before[0] for column, (before, after) in names.items() if before and after}


def with_devices(frame: pl.DataFrame, names: Mapping[str, str]) -> pl.DataFrame:
    return frame.with_columns(
        pl.when(pl.col(column).is_not_null()).then(pl.lit(name)).alias(column) for column, name in names.items()
    )


def _names(frame: pl.DataFrame, column: str) -> list[str]:
    return [str(name) for name in frame[column].drop_nulls().unique().sort()]


def match_groups(
    roundtrips: pl.DataFrame, match: Sequence[str], unfinished: Collection[int] = ()
) -> dict[Key, SetupRuns]:
    """Split round trips into groups by the values of the match columns; sorted by these, null first.

    A run that received nothing may have no trace of its relay: it belongs to the only group that agrees in everything else.
    """
    parts = {part.select(match).row(0): part for part in partition_groups(roundtrips, match)}
    for key in [key for key in parts if not knows_relay(key, match)]:
        alike = [other for other in parts if knows_relay(other, match) and _agree(key, other, match)]
        if len(alike) != 1:
            continue
        part = parts.pop(key)
        is_answered = (pl.col("outcome") == "completed").any().over("run_id")
        parts[alike[0]] = pl.concat([parts[alike[0]], part.filter(~is_answered)])
        answered = part.filter(is_answered)
        if not answered.is_empty():
            parts[key] = answered

    ordered = sorted(parts, key=lambda key: [(value is not None, value) for value in key])  # nulls first
    return {key: SetupRuns.of(parts[key], unfinished) for key in ordered}


def pair_keys(before: Mapping[Key, object], after: Mapping[Key, object], match: Sequence[str]) -> dict[Key, Key]:
    """Return which group of the new side each group of the base is compared with.

    A key without a relay trace is paired with the only group left that agrees in everything else.
    """
    pairs = {key: key for key in before if key in after}
    open_after = [key for key in after if key not in pairs]
    open_before = [key for key in before if key not in pairs]
    for key in open_before:
        alike = [other for other in open_after if _agree(key, other, match)]
        if len(alike) == 1 and sum(_agree(column, alike[0], match) for column in open_before) == 1:
            pairs[key] = alike[0]
    return {key: pairs[key] for key in before if key in pairs}


def completed_key(key: Key, other: Key, match: Sequence[str]) -> Key:
    is_silent = not knows_relay(key, match)
    return tuple(
        theirs if value is None or (name == SETTING and is_silent) else value
        for name, value, theirs in zip(match, key, other, strict=True)
    )


def knows_relay(key: Key, match: Sequence[str]) -> bool:
    return all(value is not None for name, value in zip(match, key, strict=True) if name in RELAY_COLUMNS)


def _agree(key: Key, other: Key, match: Sequence[str]) -> bool:
    is_silent = not (knows_relay(key, match) and knows_relay(other, match))
    return all(
        without_relay(str(first)) == without_relay(str(two))
        if name == SETTING and is_silent
        else first == two or (name in RELAY_COLUMNS and None in (first, two))
        for name, first, two in zip(match, key, other, strict=True)
    )


def unmatched(keys: Mapping[Key, object], matched: Iterable[Key]) -> Iterator[Key]:
    excluded = set(matched)
    yield from (key for key in keys if key not in excluded)


def interleaved_keys(
    base: pl.DataFrame,
    new: pl.DataFrame,
    base_runs: Iterable[RunDescription],
    new_runs: Iterable[RunDescription],
    match: Sequence[str],
) -> dict[int, Key]:
    cells = {run.run_id: run.labels[CELL_LABEL] for run in base_runs if CELL_LABEL in run.labels}
    groups: dict[str, set[Key]] = defaultdict(set)
    for run_id, *key in base.select("run_id", *match).unique().iter_rows():
        if run_id in cells:
            groups[cells[run_id]].add(tuple(key))
    partners: dict[str, Key] = {}
    for cell, keys in groups.items():
        keys = {key for key in keys if knows_relay(key, match)} or keys  # noqa: PLW2901 - a run that lost all has no relay
        if len(keys) == 1:
            (partners[cell],) = keys
    measured = set(new["run_id"].unique().to_list())
    return {
        run.run_id: partners[cell]
        for run in new_runs
        if run.run_id in measured and (cell := run.labels.get(AGAINST_LABEL, "")) in partners
    }


def with_partners(new: pl.DataFrame, partners: Mapping[int, Key], match: Sequence[str]) -> pl.DataFrame:
    schema = {name: new.schema[name] for name in ("run_id", *match)}
    rows = [(run_id, *key) for run_id, key in partners.items()]
    theirs = pl.DataFrame(rows, schema=schema, orient="row")
    unpaired = new.join(theirs, on="run_id", how="anti", maintain_order="left")
    renamed = new.drop(match).join(theirs, on="run_id", how="inner", maintain_order="left")
    return pl.concat([unpaired, renamed.select(new.columns)])


def partner_groups(new: pl.DataFrame, partners: Mapping[int, Key], match: Sequence[str]) -> dict[Key, Key]:
    rows = new.select("run_id", *match).unique(maintain_order=True).iter_rows()
    return {tuple(key): partners[run_id] for run_id, *key in rows if run_id in partners}


def partner_differences(groups: Mapping[Key, Key], match: Sequence[str]) -> tuple[str, ...]:
    if not groups:
        return ()
    partners = pl.DataFrame(list(groups.values()), schema=list(match), orient="row")
    names = varying_parameters(partners, match)
    sentences = []
    for group_key, partner in groups.items():
        values = {name: sides for name, *sides in zip(match, group_key, partner, strict=True)}
        listed = [
            f"{name} {value_word(new)} instead of {value_word(base)}"
            for name, (new, base) in values.items()
            if new != base
        ]
        if listed and knows_relay(group_key, match):
            words = group_words(dict(zip(match, partner, strict=True)), names)
            sentences.append(f"{words}: the new side has {', '.join(listed)}.")
    return tuple(sentences)
