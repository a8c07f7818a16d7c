"""Contenders: settings that are compared for one kind of message, and the names that tell them apart."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from ..model.names import tell_apart, where_alike, where_it_varies
from ..model.parameters import CONTENDER_COLUMNS

if TYPE_CHECKING:
    from collections.abc import Mapping

    import polars as pl

    from ..model.parameters import ParameterValue
    from ..statistics.intervals import Interval
    from .cases import Setting

    ContenderNames = Mapping[tuple[ParameterValue, ...], str]
    """The values of `CONTENDER_COLUMNS` -> name of the setting."""


@dataclass(frozen=True, slots=True)
class Contender:
    """One setting in one case.

    Attributes:
        name: what tells it apart from the others of the campaign: vendor, bridge, and what else varies.
        setting: value of each of `CONTENDER_COLUMNS`.
        latency: the compared percentile with its interval, ns.
        received: share of messages whose reply came back, with its interval.
    """

    name: str
    setting: Setting
    latency: Interval
    received: Interval

    def order(self) -> tuple[float, float, str]:
        """Return the key by which contenders are ranked: estimate, upper end (both infinite if unknown), name."""
        value, upper = (math.inf if v is None else v for v in (self.latency.value, self.latency.upper))
        return value, upper, self.name


_TOLD_LAST: Mapping[str, tuple[str, str]] = {
    "rmw": ("{}", "no rmw"),
    "relay_vendor": ("relay {}", "relay unknown"),
    "relay_backend": ("relay by {}", "relay unknown"),
}
"""Column -> (text of a value, text of a null); named only if nothing else separates two contenders."""


def contender_names(parameters: pl.DataFrame) -> ContenderNames:
    """Name every setting: `fastdds`, `fastdds via builtin`, `fastdds to cyclonedds, reliability best_effort` ...

    Args:
        parameters: has `CONTENDER_COLUMNS`; any number of rows of each setting.
    """
    settings = parameters.select(CONTENDER_COLUMNS).unique(maintain_order=True).to_dicts()
    told = {"vendor", "bridge", *_TOLD_LAST}
    parts = [(where_it_varies, partial(_word, name)) for name in CONTENDER_COLUMNS if name not in told]
    short = tell_apart(settings, _pair, parts)
    words_of = [[name] for name in short]
    for column in _TOLD_LAST:  # of settings that are alike by their short names every difference is told
        words = [_word(column, setting) for setting in settings]
        for position in where_alike(short, words):
            words_of[position].append(words[position])
    names = (", ".join(dict.fromkeys(words)) for words in words_of)
    return {tuple(setting.values()): name for setting, name in zip(settings, names, strict=True)}


def _pair(setting: Setting) -> str:
    name = str(setting["vendor"])
    if setting["relay_vendor"] not in {None, setting["vendor"]}:
        name += f" to {setting['relay_vendor']}"
    return name if setting["bridge"] == "none" else f"{name} via {setting['bridge']}"


def _word(column: str, setting: Setting) -> str:
    known, unknown = _TOLD_LAST.get(column, (f"{column} {{}}", f"{column} None"))
    return unknown if setting[column] is None else known.format(setting[column])
