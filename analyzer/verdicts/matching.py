"""The groups of two sides that are the same experiment, and what was measured of each."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import polars as pl

from ..model.runs import delivered_runs, split_runs
from ..model.setting import without_relay
from ..model.unsent import UNSENT
from ..run_statistics.received import received_interval
from ..run_statistics.runs import Runs, joined_runs

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from ..model.parameters import ParameterValue
    from ..run_statistics.runs import Run, Statistic
    from ..statistics.intervals import Interval

    Key = tuple[ParameterValue, ...]
    """Values of the match columns."""


DEVICE_COLUMNS = ("ping_device", "relay_device")


def replaced_devices(base: pl.DataFrame, new: pl.DataFrame) -> Mapping[str, str]:
    """Return the name that a device of the new side takes for a comparison: column -> name on the base.

    Devices are matched by name. Only where each side has a single ping device and a single relay device can no other
    one be meant: then the new device stands for the old one, and what changed with it is part of the comparison. A
    relay without a trace has no name and is no second device.

    Args:
        base: round trips or groups of the base, with `DEVICE_COLUMNS`.
        new: those of the new side.
    """
    names = {column: (_names(base, column), _names(new, column)) for column in DEVICE_COLUMNS}
    if any(len(side) > 1 for sides in names.values() for side in sides):
        return {}
    return {column: before[0] for column, (before, after) in names.items() if before and after}


def with_devices(frame: pl.DataFrame, names: Mapping[str, str]) -> pl.DataFrame:
    """Return a frame whose devices have these names; an unknown device stays unknown."""
    return frame.with_columns(
        pl.when(pl.col(column).is_not_null()).then(pl.lit(name)).alias(column)
        for column, name in names.items()
    )


def _names(frame: pl.DataFrame, column: str) -> list[str]:
    return [str(name) for name in frame[column].drop_nulls().unique().sort()]


RELAY_COLUMNS = ("relay_vendor", "relay_backend", "relay_device", "relay_domain_id")
"""Columns that are null without the relay's trace, and that match any value then."""

SETTING = "setting"
"""Column that holds, among others, what the relay was asked for unlike the ping, and the number of relays."""


class MatchedGroup:
    """The messages of one group by run.

    Args:
        rows: the group's round trips.
    """

    def __init__(self, rows: pl.DataFrame) -> None:
        self.runs = split_runs(rows)
        self._published = int((rows["outcome"] != UNSENT).sum())
        self._delivered: dict[str, Runs] = {}
        self._survivors: dict[str, Run] = {}

    def __len__(self) -> int:
        return self._published

    def delivered(self, metric: str) -> Runs:
        """Return a metric of every message of each run, ns, infinite for a lost one."""
        if metric not in self._delivered:
            self._delivered[metric] = Runs.of(delivered_runs(self.runs, metric))
        return self._delivered[metric]

    def survivors(self, metric: str) -> Run:
        """Return a metric of the messages that have it, all runs as one series, ns."""
        if metric not in self._survivors:
            self._survivors[metric] = joined_runs([run.survivors(metric) for run in self.runs])
        return self._survivors[metric]

    def of_survivors(self, metric: str, statistic: Statistic) -> float | None:
        """Return a statistic of the messages that have the metric, ns; None where they do not support it."""
        series = self.survivors(metric)
        return statistic.of_run(series) if len(series) >= statistic.needs else None

    @cached_property
    def received(self) -> tuple[NDArray[np.bool_], ...]:
        """For each run and message whether its reply came back."""
        return tuple(run.received for run in self.runs)

    def received_ratio(self, confidence: float) -> Interval:
        """Return the share of messages whose reply came back."""
        return received_interval(self.received, confidence)

    @cached_property
    def is_dead(self) -> bool:
        """Whether messages were sent and no reply came back."""
        return bool(self.runs) and all(run.is_lost for run in self.runs)


def match_groups(roundtrips: pl.DataFrame, match: Sequence[str]) -> dict[Key, MatchedGroup]:
    """Cut round trips into groups by the values of the match columns; sorted by these, null first.

    A run of which nothing came back may have left no trace of its relay. It belongs to the only group that agrees in
    everything else: in a group of its own it would be a loss that no comparison counts.
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
    return {key: MatchedGroup(parts[key]) for key in sorted(parts, key=_nulls_first)}


def pair_keys(
    before: Mapping[Key, object], after: Mapping[Key, object], match: Sequence[str]
) -> dict[Key, Key]:
    """Return which group of the new side each group of the base is compared with.

    Equal keys first. A key whose relay left no trace has nulls for it, and a setting that is silent about it: it is
    paired with the only group left on the other side that agrees in everything known; of several nobody knows which it
    was.

    Args:
        before: groups of the base by the values of `match`.
        after: groups of the new side.
        match: names of the columns.
    """
    pairs = {key: key for key in before if key in after}
    open_after = [key for key in after if key not in pairs]
    open_before = [key for key in before if key not in pairs]
    for key in open_before:
        alike = [other for other in open_after if _agree(key, other, match)]
        if len(alike) == 1 and sum(_agree(one, alike[0], match) for one in open_before) == 1:
            pairs[key] = alike[0]
    return {key: pairs[key] for key in before if key in pairs}


def known_key(key: Key, other: Key, match: Sequence[str]) -> Key:
    """Return a key with what the other one knows in place of nulls; of two settings that of the key that has a relay."""
    is_silent = not knows_relay(key, match)
    return tuple(
        theirs if own is None or (name == SETTING and is_silent) else own
        for name, own, theirs in zip(match, key, other, strict=True)
    )


def knows_relay(key: Key, match: Sequence[str]) -> bool:
    """Tell whether the relay of a key left a trace."""
    return all(value is not None for name, value in zip(match, key, strict=True) if name in RELAY_COLUMNS)


def _agree(key: Key, other: Key, match: Sequence[str]) -> bool:
    """Tell whether two keys agree in every column but what one of them does not know of its relay."""
    is_silent = not (knows_relay(key, match) and knows_relay(other, match))
    return all(_equal(name, one, two, is_silent) for name, one, two in zip(match, key, other, strict=True))


def _equal(name: str, one: ParameterValue, two: ParameterValue, is_silent: bool) -> bool:
    if name == SETTING and is_silent:
        return without_relay(str(one)) == without_relay(str(two))
    return one == two or (name in RELAY_COLUMNS and (one is None or two is None))


def _nulls_first(key: Key) -> list[tuple[bool, ParameterValue]]:
    return [(value is not None, value) for value in key]


def unmatched(keys: Mapping[Key, object], matched: Sequence[Key]) -> Iterator[Key]:
    """Yield the keys that were not matched, in their order."""
    known = set(matched)
    yield from (key for key in keys if key not in known)
