"""Dimensions along which a report spreads its groups, with the label of each value."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from dds_trace.analyzer.model.setting import LOAD, parse_setting, write_setting
from dds_trace.base.printable import printable
from dds_trace.base.units import format_rate, format_size

from .groups import Cell, Groups, Series, data_type_label, device_label, domain_label, qos_label, series_labels
from .verdicts import MODES

MADE_OF = {
    "choice": ("vendor", "way", "rest"),
    "place": ("device", "link"),
    "cell": ("data", "size", "rate"),
    "plane": ("size", "rate"),
    "load": ("size", "rate"),
}
"""What each dimension is made of; the last three are only positions on an axis."""

LABELS = {
    "data": "data",
    "size": "size",
    "rate": "frequency",
    "vendor": "middleware",
    "way": "bridge",
    "rest": "other settings",
    "device": "devices",
    "link": "link",
    "choice": "middleware and bridge",
    "place": "devices and link",
}


@dataclass(frozen=True, slots=True)
class Dimension:
    label: str
    options: tuple[str, ...]
    index: tuple[int, ...]
    short: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Facets:
    dimensions: Mapping[str, Dimension]
    choices: tuple[Series, ...]

    def option(self, key: str, group: int) -> int:
        return self.dimensions[key].index[group]

    def label(self, key: str, group: int) -> str:
        return self.dimensions[key].options[self.option(key, group)]

    def varies(self, key: str) -> bool:
        return len(self.dimensions[key].options) > 1


def facets_info(groups: Groups) -> Facets:
    apart = {series: _apart_from_place(series) for series in groups.series}
    choices = tuple(dict.fromkeys(choice for choice, _ in apart.values()))
    names = dict(zip(choices, series_labels(choices), strict=True))
    bridging = len({choice.vendor_label for choice in choices if choice.domain_mode == "different"}) > 1

    links = {(series.connectivity, apart[series][1].get("link")) for series in groups.series}
    several_links = len(links) > len({connectivity for connectivity, _ in links})

    def choice(series: Series) -> Value:
        name, way = names[apart[series][0]], domain_label(series)
        bridge = SHORT_BRIDGES.get(series.bridge, printable(series.bridge))
        brief = f"{series.vendor_label}, {bridge}" if bridging else bridge
        at_home = series.domain_mode == "same" or series.bridge == "none"
        short = name.replace(", same domain", "") if at_home else name.replace(f"{series.vendor_label}, {way}", brief)
        return Value(apart[series][0], name, short)

    def rest(series: Series) -> Value:
        name = names[apart[series][0]].removeprefix(series.vendor_label)
        return _named(name.replace(f", {domain_label(series)}", "", 1).removeprefix(", "))

    def device(series: Series) -> Value:
        return _named(", ".join(filter(None, (device_label(series), printable(apart[series][1].get(LOAD, ""))))))

    def link(series: Series) -> Value:
        emulated = printable(apart[series][1].get("link", "")) if several_links else ""
        return _named(", ".join(filter(None, (printable(series.connectivity), emulated))))

    values_of_cells: dict[str, Callable[[Cell], Value]] = {
        "data": lambda cell: _named(data_type_label(cell.data_type)),
        "size": lambda cell: Value(cell.payload_bytes, format_size(cell.payload_bytes)),
        "rate": lambda cell: Value(cell.rate_hz, format_rate(cell.rate_hz)),
    }
    values_of_series: dict[str, Callable[[Series], Value]] = {
        "vendor": lambda series: _named(series.vendor_label),
        "way": lambda series: _named(domain_label(series)),
        "rest": rest,
        "device": device,
        "link": link,
        "choice": choice,
        "place": lambda series: _named(f"{device(series).label}, {link(series).label}"),
    }
    dimensions = {}
    for key, name in LABELS.items():
        if key in values_of_cells:
            own = [values_of_cells[key](cell) for cell in groups.cells]
            values = [own[group.cell] for group in groups.groups]
        else:
            own = [values_of_series[key](series) for series in groups.series]
            values = [own[group.series] for group in groups.groups]
        distinct = {value.value: value for value in own}
        if key in ("size", "rate"):
            distinct = dict(sorted(distinct.items()))
        rank = {value: index for index, value in enumerate(distinct)}
        dimensions[key] = Dimension(
            name,
            tuple(value.label for value in distinct.values()),
            tuple(rank[value.value] for value in values),
            tuple(value.short or value.label for value in distinct.values()),
        )
    return Facets(dimensions, choices)


SHORT_BRIDGES = {"builtin": "built-in", "builtin-zenoh": "built-in Zenoh"}


@dataclass(frozen=True, slots=True)
class Value:
    value: Any
    label: str
    short: str = ""


def _named(label: str) -> Value:
    return Value(label, label)


def _apart_from_place(series: Series) -> tuple[Series, Mapping[str, str]]:
    """Return the choice, and the settings that are part of the place."""
    setting = parse_setting(series.setting)
    emulated = {
        key: value for key, value in setting.items() if key == "link" or (key == LOAD and value.startswith("emulated-"))
    }
    choice = write_setting({key: value for key, value in setting.items() if key not in emulated})
    return replace(series, ping_device="", relay_device=None, connectivity="", setting=choice), emulated


@dataclass(frozen=True, slots=True)
class Filter:
    """One filter of a page; `index` has the option of each group."""

    key: str
    label: str
    options: tuple[Value, ...]
    index: tuple[int, ...]


_FILTERS: tuple[tuple[str, str, Callable[[Cell, Series], Value]], ...] = (
    ("vendor", "Vendor", lambda _, s: _named(s.vendor_label)),
    ("domain", "Domains", lambda _, s: Value(s.domain_mode, MODES.get(s.domain_mode, printable(s.domain_mode)))),
    ("bridge", "Bridge", lambda _, s: _named(printable(s.bridge))),
    ("data", "Data", lambda c, _: Value(printable(c.data_type), data_type_label(c.data_type))),
    ("size", "Size", lambda c, _: Value(str(c.payload_bytes), format_size(c.payload_bytes))),
    ("rate", "Rate", lambda c, _: Value(f"{c.rate_hz:g}", format_rate(c.rate_hz))),
    ("qos", "QoS", lambda _, s: _named(qos_label(s))),
    ("device", "Devices", lambda _, s: _named(device_label(s))),
    ("backend", "Backend", lambda _, s: _named(printable(s.backend))),
    ("serialization", "Serialization", lambda _, s: _named(printable(s.serialization))),
    ("link", "Link", lambda _, s: _named(printable(s.connectivity))),
    ("setting", "Setting", lambda _, s: Value(printable(s.setting), printable(s.setting) or "nothing else set")),
)


def filters_info(groups: Groups) -> tuple[Filter, ...]:
    filters = []
    for key, label, option_of in _FILTERS:
        options = [option_of(groups.cell_of(group), groups.series_of(group)) for group in groups.groups]
        by_series = sorted(groups.groups, key=lambda group: (group.series, group.cell))
        distinct = list(dict.fromkeys(options[group.index] for group in by_series))
        if all(option.value.replace(".", "", 1).isdigit() for option in distinct):
            distinct.sort(key=lambda option: float(option.value))
        if len(distinct) > 1:
            rank = {option: index for index, option in enumerate(distinct)}
            filters.append(Filter(key, label, tuple(distinct), tuple(rank[option] for option in options)))
    return tuple(filters)
