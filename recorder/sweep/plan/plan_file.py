"""A plan's TOML file read into a frozen `Plan`; whatever cannot be meant is an error naming key and remedy."""

from __future__ import annotations

import difflib
import itertools
import sys
from dataclasses import dataclass, fields, replace
from enum import Enum
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

from dds_trace.tracefile import OptionError
from dds_trace.tracefile.units.sizes import parse_size

from .cells import AXES, Cell
from .link import LINK_KEYS, PRESETS, Link
from .plan import PERCENTILES, DeviceSettings, Exclusion, Plan, RunSettings, Search

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Mapping
    from pathlib import Path

    FindInstalled: TypeAlias = Callable[[], Collection[tuple[str, str | None]]]

INSTALLED = "installed"
"""As `backend`: every middleware that this machine has."""


def read_plan(path: Path, installed: FindInstalled = tuple, *, by_hand: bool = False) -> Plan:
    """The plan in a TOML file.

    Args:
        path: the file.
        installed: gives (backend, rmw) of every middleware of this machine; called where the plan asks for it.
        by_hand: a person starts the relay, on another device.

    Raises:
        OptionError: there is no such file, it is no TOML, or something in it cannot be meant.
    """
    try:
        text = path.read_text()
    except OSError as err:
        raise OptionError(
            f"{path}: {err.strerror}; give the path of a plan such as plans/quick.toml"
        ) from err
    return parse_plan(text, path.stem, str(path), installed, by_hand=by_hand)


def parse_plan(
    text: str,
    name: str,
    where: str,
    installed: FindInstalled = tuple,
    *,
    by_hand: bool = False,
) -> Plan:
    """The plan in a TOML text; `where` goes into the error messages, which are those of `read_plan`."""
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as err:
        raise OptionError(f"{where}: {err}") from err
    root = _Table(table, where, "")
    root.allow(
        "name", "description", "axes", "matrix", "exclude", "run", "devices", "network", "link", "search"
    )
    # One [axes] table or several [[axes]], each of them combined with each [[matrix]].
    axes = [_axis_values(table) for table in root.tables("axes")] or [{}]
    matrices = [_axis_values(table) for table in root.tables("matrix")] or [{}]
    exclusions = [
        Exclusion(
            values={axis: tuple(values) for axis, values in _axis_values(rule, ignore=("reason",)).items()},
            reason=str(rule.values.get("reason", "")),
        )
        for rule in root.tables("exclude")
    ]
    combined = [{**shared, **own} for shared in axes for own in matrices]
    listed = [cell for values in combined for cell in _cells(values, installed)]
    if not listed:
        raise OptionError(f"{where}: the plan has no cell; give [axes] or [[matrix]] some values")
    cells, excluded = _apply(exclusions, listed)
    _check_names(cells, where)
    link = _link(root.table("link"))
    devices = root.table("devices")
    devices.allow("ping", "relay", "connectivity")
    relay = _record(DeviceSettings, devices.table("relay"))
    network = _record(_Network, root.table("network"))
    plan = Plan(
        name=root.take("name", str, name),
        description=root.take("description", str, ""),
        cells=tuple(cells),
        excluded=tuple(excluded),
        run=_record(RunSettings, root.table("run")),
        ping=_record(DeviceSettings, devices.table("ping")),
        relay=relay,
        namespaces=network.namespaces or link is not None,
        link=link,
        connectivity=devices.take(
            "connectivity", str, _connectivity(link, network.namespaces, relay, by_hand)
        ),
        by_hand=by_hand,
        search=_record(Search, root.table("search")),
    )
    _check(plan, where)
    return plan


@dataclass(frozen=True, slots=True)
class _Network:
    """The plan's `[network]`."""

    namespaces: bool = False


def _connectivity(link: Link | None, namespaces: bool, relay: DeviceSettings, by_hand: bool) -> str | None:
    if link is not None:
        return link.connectivity
    if relay.ssh is not None or by_hand:
        return None
    return "wired" if namespaces else "loopback"


def _cells(axes: Mapping[str, list[Any]], installed: FindInstalled) -> Iterator[Cell]:
    """Every combination of the values, the axis that is written last running fastest."""
    if axes.get("backend") == [INSTALLED]:
        others = {axis: values for axis, values in axes.items() if axis not in ("backend", "rmw")}
        for backend, rmw in installed():
            yield from _cells({"backend": [backend], "rmw": [rmw], **others}, installed)
        return
    for values in itertools.product(*axes.values()):
        yield Cell(**dict(zip(axes, values, strict=True)))


def _apply(exclusions: list[Exclusion], listed: list[Cell]) -> tuple[list[Cell], list[tuple[Cell, str]]]:
    kept: list[Cell] = []
    excluded: list[tuple[Cell, str]] = []
    for cell in listed:
        rule = next((rule for rule in exclusions if rule.covers(cell)), None)
        if rule is None:
            kept.append(cell)
        else:
            excluded.append((cell, rule.reason))
    return kept, excluded


def _check_names(cells: list[Cell], where: str) -> None:
    seen: set[str] = set()
    for cell in cells:
        if cell.name in seen:
            raise OptionError(f"{where}: the cell {cell.name} is there twice; two [[matrix]] overlap")
        seen.add(cell.name)


def _check(plan: Plan, where: str) -> None:
    """Rules that concern more than one key.

    Raises:
        OptionError: one of them is broken.
    """
    run = plan.run
    rules = (
        (
            (run.messages > 0) == (run.seconds > 0),
            "[run] takes either messages or seconds, and it is above zero",
        ),
        (
            run.warmup < 0 or run.repeats < 1 or run.attempts < 1,
            "[run] counts messages, repeats and attempts",
        ),
        (any(cell.rate <= 0 for cell in plan.cells), "a rate is above zero"),
        (run.discovery not in (None, "localhost", "subnet"), "[run] discovery is localhost or subnet"),
        (
            any(cell.crosses_domains for cell in plan.cells) and run.domain == run.ping_domain,
            "[run] domain and ping_domain are the same, and a bridge joins two",
        ),
        (plan.has_two_devices and plan.namespaces, "[link] and [network] need both devices on this machine"),
        (
            plan.has_two_devices and not plan.relay.reached_at and any(map(plan.needs_address, plan.cells)),
            "the ping has to be told where the relay is; give [devices.relay] its address",
        ),
        (plan.ping.ssh is not None, "the ping is always on this machine; give [devices.relay] the ssh"),
        (
            plan.search.percentile not in PERCENTILES,
            f"[search] percentile is one of {', '.join(f'{percentile:g}' for percentile in PERCENTILES)}",
        ),
        (plan.search.resolution <= 1, "[search] resolution is a factor above 1"),
        (not 0 < plan.search.min_rate < plan.search.max_rate, "[search] min_rate is below max_rate"),
    )
    for broken, rule in rules:
        if broken:
            raise OptionError(f"{where}: {rule}")


def _link(table: _Table) -> Link | None:
    if not table.values:
        return None
    preset = table.take("preset", str, None)
    table.allow("preset", "name", *LINK_KEYS)
    if preset is not None and preset not in PRESETS:
        raise OptionError(f"{table.where}: there is no link {preset!r}{_nearest(preset, PRESETS)}")
    values = {key: table.take(key, float, None) for key in LINK_KEYS}
    changed = {key: value for key, value in values.items() if value is not None}
    base = PRESETS[preset] if preset else Link()
    # A preset with other values is no longer that preset, and the trace should not call it so.
    name = table.take("name", str, f"{base.name}-changed" if preset and changed else base.name)
    link = replace(base, name=name, **changed)
    if (
        min(changed.values(), default=0) < 0
        or link.loss_percent > 100
        or (link.outage_ms > 0) != (link.outage_every_s > 0)
    ):
        raise OptionError(
            f"{table.where}: no value is below zero, loss_percent not above 100, and an outage has both "
            "outage_every_s and outage_ms",
        )
    return link


def _axis_values(table: _Table, ignore: Collection[str] = ()) -> dict[str, list[Any]]:
    """Axis -> its values as `Cell` holds them, in the order in which the plan has them."""
    table.allow(*AXES, *ignore)
    return {
        axis: [
            _axis_value(table, axis, value) for value in (listed if isinstance(listed, list) else [listed])
        ]
        for axis, listed in table.values.items()
        if axis not in ignore
    }


def _axis_value(table: _Table, axis: str, value: object) -> Any:
    if axis == "size":
        try:
            return parse_size(str(value))
        except OptionError as err:
            raise OptionError(f"{table.where}: {err}") from err
    known = AXES[axis].metadata
    if value == "" and AXES[axis].default is None:
        return None
    if known["choices"] and value not in known["choices"]:
        raise OptionError(f"{table.where}: {axis} is {value!r}{_nearest(str(value), known['choices'])}")
    return table.check(axis, value, known["kind"])


_T = TypeVar("_T")


def _record(kind: type[_T], table: _Table) -> _T:
    """The dataclass `kind` filled from a table, its defaults where the table says nothing."""
    defaults = kind()
    named = [f.name for f in fields(kind)]  # type: ignore[arg-type]  # every kind here is a dataclass
    table.allow(*named)
    values = {
        name: _field_value(table, name, getattr(defaults, name)) for name in named if name in table.values
    }
    return kind(**values)


def _field_value(table: _Table, name: str, default: object) -> Any:
    value = table.values[name]
    if isinstance(default, Enum):
        choices = {choice.value: choice for choice in type(default)}
        if value not in choices:
            raise OptionError(f"{table.where}: {name} is {value!r}{_nearest(str(value), choices)}")
        return choices[value]
    if isinstance(default, tuple):
        items = value if isinstance(value, list) else [value]
        return tuple(table.check(name, item, str) for item in items)
    return table.check(name, value, str if default is None else type(default))


@dataclass(frozen=True, slots=True)
class _Table:
    """One table of the TOML, with its place for the error messages."""

    values: dict[str, Any]
    path: str
    key: str

    @property
    def where(self) -> str:
        return f"{self.path}: [{self.key}]" if self.key else self.path

    def table(self, key: str) -> _Table:
        return _Table(self.take(key, dict, {}), self.path, f"{self.key}.{key}".lstrip("."))

    def tables(self, key: str) -> list[_Table]:
        """The tables of an array of tables; a single table counts as one."""
        if isinstance(self.values.get(key), dict):
            return [self.table(key)]
        return [
            _Table(self.check(f"{key} number {i}", table, dict), self.path, f"[{key}]")
            for i, table in enumerate(self.take(key, list, []), 1)
        ]

    def take(self, key: str, kind: type, default: Any) -> Any:
        return self.check(key, self.values[key], kind) if key in self.values else default

    def check(self, key: str, value: Any, kind: type) -> Any:
        if kind is float and isinstance(value, int) and not isinstance(value, bool):
            return float(value)
        if not isinstance(value, kind) or (kind is not bool and isinstance(value, bool)):
            raise OptionError(f"{self.where}: {key} is {value!r}, not {_KIND_NAMES[kind]}")
        return value

    def allow(self, *keys: str) -> None:
        for key in self.values:
            if key not in keys:
                raise OptionError(f"{self.where}: there is no {key!r}{_nearest(key, keys)}")


_KIND_NAMES = {
    str: "a text",
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    dict: "a table",
    list: "a list of tables",
}


def _nearest(word: str, choices: Collection[str]) -> str:
    """What a message adds after a word that is none of `choices`."""
    near = difflib.get_close_matches(word, choices, n=1)
    listed = ", ".join(choices)
    return f"; did you mean {near[0]!r}?" if near else f"; choose one of {listed}"
