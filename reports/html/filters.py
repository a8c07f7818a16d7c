"""Filters of the page, which act on every figure and table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from dds_trace.base.printable import printable
from dds_trace.base.units import format_rate, format_size

from ..book.groups import Cell, Groups, Series, data_type_label, device_label, qos_label
from ..book.verdicts import MODES


@dataclass(frozen=True, slots=True)
class Option:
    value: str
    label: str


@dataclass(frozen=True, slots=True)
class Filter:
    """One filter of a page; `index` has the option of each group."""

    key: str
    label: str
    options: tuple[Option, ...]
    index: tuple[int, ...]


def _same(text: str) -> Option:
    return Option(text, text)


_FILTERS: tuple[tuple[str, str, Callable[[Cell, Series], Option]], ...] = (
    ("vendor", "Vendor", lambda _, s: _same(s.vendor_label)),
    ("domain", "Domains", lambda _, s: Option(s.domain_mode, MODES.get(s.domain_mode, printable(s.domain_mode)))),
    ("bridge", "Bridge", lambda _, s: _same(printable(s.bridge))),
    ("data", "Data", lambda c, _: Option(printable(c.data_type), data_type_label(c.data_type))),
    ("size", "Size", lambda c, _: Option(str(c.payload_bytes), format_size(c.payload_bytes))),
    ("rate", "Rate", lambda c, _: Option(f"{c.rate_hz:g}", format_rate(c.rate_hz))),
    ("qos", "QoS", lambda _, s: _same(qos_label(s))),
    ("device", "Devices", lambda _, s: _same(device_label(s))),
    ("backend", "Backend", lambda _, s: _same(printable(s.backend))),
    ("serialization", "Serialization", lambda _, s: _same(printable(s.serialization))),
    ("link", "Link", lambda _, s: _same(printable(s.connectivity))),
    ("setting", "Setting", lambda _, s: Option(printable(s.setting), printable(s.setting) or "nothing else set")),
)


def filters_info(groups: Groups) -> tuple[Filter, ...]:
    filters = []
    for key, label, option_of in _FILTERS:
        options = [option_of(groups.cell_of(group), groups.series_of(group)) for group in groups.groups]
        distinct = _ordered(groups, option_of)
        if len(distinct) > 1:
            rank = {option: index for index, option in enumerate(distinct)}
            filters.append(Filter(key, label, tuple(distinct), tuple(rank[option] for option in options)))
    return tuple(filters)


def _ordered(groups: Groups, option_of: Callable[[Cell, Series], Option]) -> list[Option]:
    by_series = sorted(groups.groups, key=lambda group: (group.series, group.cell))
    options = list(dict.fromkeys(option_of(groups.cell_of(g), groups.series_of(g)) for g in by_series))
    if all(option.value.replace(".", "", 1).isdigit() for option in options):
        options.sort(key=lambda option: float(option.value))
    return options
