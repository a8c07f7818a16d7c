"""Which groups of two sides are compared (equal parameters, or `--against`), and what was measured of each."""

from __future__ import annotations

from collections import defaultdict
from functools import cached_property
from typing import TYPE_CHECKING

import polars as pl

from ..model.names import group_words, is_topic, value_word, varying_parameters
from ..model.runs import UNSENT, delivered_runs, split_runs
from ..model.setting import without_relay
from ..run_statistics.between_runs import Estimate, estimates_of_runs
from ..run_statistics.received import received_interval
from ..run_statistics.runs import Run, Runs, Statistic, joined_runs

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from dds_trace.tracefile.format.descriptions import Run as RunDescription

    from ..model.parameters import ParameterValue
    from ..statistics.intervals import Interval

    Key = tuple[ParameterValue, ...]
    """Values of the match columns."""

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


class MatchedGroup:
    """The round trips of one group by run; `unfinished` counts the runs of `unfinished` ids, the fragments left out included.

    Of a topic they are the messages that a tap heard, and `bound_ns` the largest error of their times.
    """

    def __init__(self, rows: pl.DataFrame, unfinished: Collection[int] = ()) -> None:
        runs = split_runs(rows)
        least = LEAST_OF_A_RUN * max((len(run.rows) for run in runs), default=0)
        self.runs = tuple(run for run in runs if run.run_id not in unfinished or len(run.rows) >= least)
        self.unfinished = sum(run.run_id in unfinished for run in runs)
        self.is_topic = "bound_ns" in rows.columns and len(rows) > 0 and is_topic(rows["data_type"][0])
        bound_ns = rows["bound_ns"].max() if self.is_topic else None
        self.bound_ns = int(bound_ns) if isinstance(bound_ns, int) else 0
        self._published = int((rows["outcome"] != UNSENT).sum())
        self._delivered: dict[str, Runs] = {}
        self._survivors: dict[str, Run] = {}
        self._estimates: dict[tuple[str, tuple[Statistic, ...], float], list[Estimate]] = {}

    def __len__(self) -> int:
        return self._published

    def delivered(self, metric: str) -> Runs:
        if metric not in self._delivered:
            self._delivered[metric] = Runs.of(delivered_runs(self.runs, metric))
        return self._delivered[metric]

    def estimates(self, metric: str, statistics: Sequence[Statistic], confidence: float) -> list[Estimate]:
        key = metric, tuple(statistics), confidence
        if key not in self._estimates:
            self._estimates[key] = estimates_of_runs(self.delivered(metric), statistics, confidence)
        return self._estimates[key]

    def survivors(self, metric: str) -> Run:
        if metric not in self._survivors:
            self._survivors[metric] = joined_runs([run.survivors(metric) for run in self.runs])
        return self._survivors[metric]

    def of_survivors(self, metric: str, statistic: Statistic) -> float | None:
        series = self.survivors(metric)
        return statistic.of_run(series) if len(series) >= statistic.needs else None

    @cached_property
    def received(self) -> tuple[NDArray[np.bool_], ...]:
        return tuple(run.received for run in self.runs)

    def received_ratio(self, confidence: float) -> Interval:
        return received_interval(self.received, confidence)

    @cached_property
    def is_dead(self) -> bool:
        return bool(self.runs) and all(run.is_lost for run in self.runs)


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
) -> dict[Key, MatchedGroup]:
    """Split round trips into groups by the values of the match columns; sorted by these, null first.

    A run that received nothing may have no trace of its relay: it belongs to the only group that agrees in everything else.
    """
    parts = {
        part.select(match).row(0): part
        for part in roundtrips.sort(*match, nulls_last=False, maintain_order=True).partition_by(
            *match, maintain_order=True
        )
    }
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
    return {key: MatchedGroup(parts[key], unfinished) for key in ordered}


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
    return all(_equal(name, first, two, is_silent) for name, first, two in zip(match, key, other, strict=True))


def _equal(name: str, first: ParameterValue, two: ParameterValue, is_silent: bool) -> bool:
    if name == SETTING and is_silent:
        return without_relay(str(first)) == without_relay(str(two))
    return first == two or (name in RELAY_COLUMNS and (first is None or two is None))


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
