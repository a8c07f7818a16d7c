"""Cases and contenders: the kinds of message, each judged by itself, and the setups compared in each."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

import polars as pl

from ..model.names import tell_apart, where_alike, where_it_varies
from ..model.parameters import CASE_COLUMNS, CONTENDER_COLUMNS, ParameterValue
from ..model.runs import with_unsent
from ..model.setting import choice_of, condition_of
from ..statistics.intervals import Interval
from .judgements import exceeds_lossy_share

Setting = Mapping[str, ParameterValue]
"""Parameter column -> value, of some columns."""
ContenderNames = Mapping[tuple[ParameterValue, ...], str]
"""The values of `CONTENDER_COLUMNS` -> name of the setting."""


MOST_COMPARED_ROWS = 4_000_000
"""Rows of one kind of message that are compared: they are in memory at once, and sorted."""


class GroupRows(Protocol):
    """The round trips of a campaign, read for a few groups at a time."""

    @property
    def groups(self) -> pl.DataFrame:
        """One row per group: the parameter columns and `published`."""

    @property
    def has_rows(self) -> bool:
        """False for a sketch, which has groups only."""

    def frame(self, groups: pl.DataFrame, columns: Sequence[str] = ...) -> pl.DataFrame:
        """Read columns (by default all) of the round trips of some groups, group by group."""


@dataclass(frozen=True, slots=True)
class UnbarredRows:
    """The round trips of a campaign without `barred` groups, and with a row for each message that never left (`unsent`)."""

    rows: GroupRows
    barred: tuple[int, ...] = ()
    unsent: Mapping[int, int] = field(default_factory=dict)

    @property
    def groups(self) -> pl.DataFrame:
        groups = self.rows.groups
        return groups.filter(~pl.col("group").is_in(self.barred)) if self.barred else groups

    @property
    def has_rows(self) -> bool:
        return self.rows.has_rows

    def frame(self, groups: pl.DataFrame, columns: Sequence[str] | None = None) -> pl.DataFrame:
        frame = self.rows.frame(groups) if columns is None else self.rows.frame(groups, columns)
        return with_unsent(frame, self.unsent)


def partition_groups(groups: pl.DataFrame, columns: Sequence[str]) -> list[pl.DataFrame]:
    """Return the rows by the values of some columns, sorted by these, null first."""
    if len(groups) < 2:
        return [groups] if len(groups) else []
    return groups.sort(*columns, maintain_order=True).partition_by(*columns, maintain_order=True)


CONDITIONS = "conditions"


def with_conditions(groups: pl.DataFrame) -> pl.DataFrame:
    """Add what surrounded the runs; a relay's device that no reply names is the only one of the others."""
    conditions = map(condition_of, groups["setting"].to_list())
    devices = pl.col("relay_device").drop_nulls()
    only = pl.when(devices.n_unique() == 1).then(devices.first())
    others = [name for name in (*CASE_COLUMNS, CONDITIONS) if name != "relay_device"]
    return groups.with_columns(pl.Series(CONDITIONS, list(conditions), pl.String)).with_columns(
        pl.col("relay_device").fill_null(only.over(others))
    )


def is_too_large(groups: pl.DataFrame) -> bool:
    return int(groups["published"].sum()) > MOST_COMPARED_ROWS


@dataclass(frozen=True, slots=True)
class Contender:
    """One setup in one case.

    Attributes:
        name: vendor, bridge, and what else differs between setups.
        setting: value of each of `CONTENDER_COLUMNS`.
        latency: the compared percentile with its interval, ns; a lost message is infinitely late.
        received: share of messages whose reply came back, with its interval.
        survivors_ns: the compared percentile of the received messages; None if they are too few.
        loses_more: whether it receives significantly less than another setup of the case.
        p50_ns: median of a typical run, below three runs of all messages, ns; infinite if a lost message sets it.
        p99_ns: p99, likewise; None where all messages do not support it.
        letters_p50: letters of its tiers at the median: two setups share one exactly if their medians are not shown to differ.
        letters_p99: the same at p99; empty where not all setups have an interval for it.
        groups: rows of `summary`; several where only numbers of domains differ.
    """

    name: str
    setting: Setting
    latency: Interval
    received: Interval
    survivors_ns: float | None = None
    loses_more: bool = False
    p50_ns: float | None = None
    p99_ns: float | None = None
    letters_p50: str = ""
    letters_p99: str = ""
    groups: tuple[int, ...] = ()

    @property
    def lost(self) -> float:
        return 1.0 - (self.received.value or 0.0)

    @property
    def group(self) -> int | None:
        return self.groups[0] if len(self.groups) == 1 else None

    @property
    def is_usable(self) -> bool:
        return not (self.loses_more or exceeds_lossy_share(self.lost))

    def order(self) -> tuple[bool, float, float, str]:
        value, upper = (math.inf if v is None else v for v in (self.latency.value, self.latency.upper))
        return self.loses_more, value, upper, self.name


_NAMED_LAST: Mapping[str, tuple[str, str]] = {
    "rmw": ("{}", "no rmw"),
    "relay_vendor": ("relay {}", "relay unknown"),
    "relay_backend": ("relay by {}", "relay unknown"),
}
"""Column -> (text of a value, text of a null); named only if nothing else separates two setups."""


def contender_names(groups: pl.DataFrame) -> ContenderNames:
    """Name a setup without its relay's trace like the only one that it may be, if no kind of message has both."""
    cases: dict[tuple[ParameterValue, ...], set[tuple[ParameterValue, ...]]] = {}
    for row in groups.select(*CONTENDER_COLUMNS, *CASE_COLUMNS, CONDITIONS).iter_rows():
        cases.setdefault(row[: len(CONTENDER_COLUMNS)], set()).add(row[len(CONTENDER_COLUMNS) :])
    may_be = {
        setting: alike[0]
        for setting in cases
        if all(value is None for name, value in zip(CONTENDER_COLUMNS, setting, strict=True) if name in _RELAY_COLUMNS)
        and len(alike := [other for other in cases if other != setting and _fits(setting, other)]) == 1
        and cases[setting].isdisjoint(cases[alike[0]])
    }
    settings = [dict(zip(CONTENDER_COLUMNS, setting, strict=True)) for setting in cases if setting not in may_be]
    names = _names_of(settings)
    return names | {setting: names[whole] for setting, whole in may_be.items()}


_RELAY_COLUMNS = frozenset({"relay_vendor", "relay_backend"})


def _fits(unknown: tuple[ParameterValue, ...], other: tuple[ParameterValue, ...]) -> bool:
    values = zip(CONTENDER_COLUMNS, unknown, other, strict=True)
    return all(name in _RELAY_COLUMNS or value == other_value for name, value, other_value in values)


def _names_of(settings: Sequence[Setting]) -> dict[tuple[ParameterValue, ...], str]:
    separate = {"vendor", "bridge", *_NAMED_LAST}
    parts = [(where_it_varies, partial(_word, name)) for name in CONTENDER_COLUMNS if name not in separate]
    short = tell_apart(settings, _middleware_words, parts)
    names = [[name] for name in short]
    for column in _NAMED_LAST:
        words = [_word(column, setting) for setting in settings]
        for index in where_alike(short, words):
            names[index].append(words[index])
    return {
        tuple(setting.values()): ", ".join(dict.fromkeys(words)) for setting, words in zip(settings, names, strict=True)
    }


def _middleware_words(setting: Setting) -> str:
    name = str(setting["vendor"])
    if setting["relay_vendor"] not in {None, setting["vendor"]}:
        name += f" to {setting['relay_vendor']}"
    return name if setting["bridge"] == "none" else f"{name} via {setting['bridge']}"


def _word(column: str, setting: Setting) -> str:
    if column == "setting":
        return choice_of(str(setting[column])) or "nothing else set"
    text, null = _NAMED_LAST.get(column, (f"{column} {{}}", f"{column} None"))
    return null if setting[column] is None else text.format(setting[column])
