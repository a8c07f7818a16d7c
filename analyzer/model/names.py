"""What groups are called in findings: what was sent, then no more of the settings than tells them apart."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .parameters import PARAMETER_NAMES

if TYPE_CHECKING:
    import polars as pl

_SENT = ("data_type", "payload_bytes", "rate_hz")
"""Every name starts with these."""

_WANTED = ("vendor", "bridge")
"""What a reader looks for first: named wherever it varies, whatever else would tell the groups apart."""

_PLAIN = frozenset({"vendor", "backend", "reliability", "durability", "connectivity"})
"""Parameters whose values speak for themselves."""


def name_groups(parameters: pl.DataFrame) -> list[str]:
    """The name of each group, as in `binary 33000 B at 10 Hz, fastdds, bridge builtin`.

    Settings that are the same everywhere are left out, and so are those that only follow others: the domains' numbers
    follow the bridge, the RMW its vendor.

    Args:
        parameters: a row per group, the columns of `columns.PARAMETER_COLUMNS`.
    """
    named = [name for name in _WANTED if parameters[name].n_unique() > 1]
    others = [name for name in PARAMETER_NAMES if name not in (*_SENT, *_WANTED)]
    for name in ("domain_mode", *others):
        if _distinct(parameters, [*named, name]) > _distinct(parameters, named):
            named.append(name)
    return [_name(row, named) for row in parameters.iter_rows(named=True)]


def _distinct(parameters: pl.DataFrame, names: list[str]) -> int:
    return parameters.select(names).n_unique() if names else 1


def _name(row: dict[str, Any], named: list[str]) -> str:
    sent = f"{row['data_type']} {row['payload_bytes']} B at {row['rate_hz']:g} Hz"
    return ", ".join([sent, *(_word(name, row[name]) for name in named)])


def _word(name: str, value: object) -> str:
    if name == "domain_mode":
        return f"{value} domain"
    if name == "bridge" and value == "none":
        return "no bridge"
    return str(value) if name in _PLAIN else f"{name} {value}"
