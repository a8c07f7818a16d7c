"""The keys of a plan, a table each."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dds_trace.base import limits
from dds_trace.extensions.campaigns.plan.schema import TABLES, axis_choices

from .markdown import code, table

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from dds_trace.base.limits import Limit
    from dds_trace.extensions.campaigns.plan.cells import Key
    from dds_trace.extensions.campaigns.plan.schema import Table

_AXES = TABLES["axes"].keys
_KINDS = {str: "text", int: "whole number", float: "number", bool: "true or false"}
_BOUNDS: Mapping[type[Limit], Callable[..., list[str]]] = {
    limits.Whole: lambda limit: [f"{limit.low} to {limit.high}"],
    limits.Real: lambda limit: [f"{'above ' if limit.is_above else ''}{limit.low:.15g} to {limit.high:.15g}"],
    limits.RealOrMax: lambda limit: [f"{limit.low:.15g} to {limit.high:.15g}, or max"],
    limits.Words: lambda limit: [] if limit is limits.TEXT else [limit.what],
    limits.Flag: lambda _: [],
}
"""Kind of validator -> its bounds in words."""


def plan_keys() -> str:
    """Return a section for each table, and a row for each key: its value, bounds, default and meaning."""
    return "\n".join(_section(name, table) for name, table in TABLES.items())


def _section(name: str, of: Table) -> str:
    has_axes = of.is_repeated and name != "axes"
    title = code(f"[[{name}]]" if has_axes else f"[{name}]") if name else "Before any table"
    rows = [_row(name, word, key) for word, key in of.keys.items() if not (has_axes and word in _AXES)]
    shown = [table(("key", "value", "default", "meaning"), rows)] if rows else []
    return "\n".join([f"## {title}\n", f"{of.meaning}\n", *shown])


def _row(of: str, name: str, key: Key) -> list[str]:
    default = key.default_words or _default(key.default)
    return [code(name), "; ".join(_values(of, name, key)), default, key.meaning]


def _values(of: str, name: str, key: Key) -> Iterator[str]:
    """Yield what a value may be: its choices, or its kind with its unit and its bounds."""
    limit = key.limit
    choices = axis_choices(name) if of == "axes" else []
    if isinstance(limit, limits.OneOf):
        choices = [f"{choice:g}" if isinstance(choice, float) else choice for choice in limit.choices]
    if choices:
        yield ", ".join(map(code, choices))
        return
    kind = _KINDS[key.kind] + (" or a list of them" if key.takes_list and of != "axes" else "")
    yield f"{kind}, {key.unit}" if key.unit else kind
    yield from _BOUNDS[type(limit)](limit)


def _default(value: object) -> str:
    if isinstance(value, bool):
        return code(str(value).lower())
    return "none" if value in (None, ()) else code(f"{value:g}" if isinstance(value, float) else value)
