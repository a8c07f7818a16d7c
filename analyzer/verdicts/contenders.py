"""Contenders: settings that are compared for one kind of message, and the names that tell them apart."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..model.parameters import CONTENDER_COLUMNS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

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
    "relay_backend": ("relay by {}", "relay unknown"),
    "relay_vendor": ("relay {}", "relay unknown"),
}
"""Column -> (text of a value, text of a null); named only if nothing else separates two contenders."""


def contender_names(parameters: pl.DataFrame) -> ContenderNames:
    """Name every setting: `fastdds`, `fastdds via builtin`, `fastdds to cyclonedds, reliability best_effort` ...

    Args:
        parameters: has `CONTENDER_COLUMNS`; any number of rows of each setting.
    """
    settings = [
        dict(zip(CONTENDER_COLUMNS, row, strict=True))
        for row in parameters.select(CONTENDER_COLUMNS).unique(maintain_order=True).iter_rows()
    ]
    varying = _varying(settings)
    short = [_short_name(setting, varying) for setting in settings]
    names = {}
    for setting, name in zip(settings, short, strict=True):
        alike = [other for other, of_other in zip(settings, short, strict=True) if of_other == name]
        apart = []
        for column in _varying(alike):
            known, unknown = _TOLD_LAST.get(column, (f"{column} {{}}", f"no {column}"))
            apart.append(unknown if setting[column] is None else known.format(setting[column]))
        names[tuple(setting.values())] = ", ".join(dict.fromkeys([name, *apart]))
    return names


def _varying(settings: Sequence[Setting]) -> list[str]:
    return [column for column in CONTENDER_COLUMNS if len({setting[column] for setting in settings}) > 1]


def _short_name(setting: Setting, varying: Sequence[str]) -> str:
    name = str(setting["vendor"])
    if setting["relay_vendor"] not in {None, setting["vendor"]}:
        name += f" to {setting['relay_vendor']}"
    if setting["bridge"] != "none":
        name += f" via {setting['bridge']}"
    told = {"vendor", "bridge", *_TOLD_LAST}
    return ", ".join([name, *(f"{column} {setting[column]}" for column in varying if column not in told)])
