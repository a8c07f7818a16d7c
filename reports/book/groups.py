"""Groups of a report, a row of `Analysis.summary` each: the message is its cell, everything else its series."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

from dds_trace.analyzer.analysis import Analysis
from dds_trace.analyzer.model.metrics import METRICS, TOPIC_METRICS
from dds_trace.analyzer.model.names import Rule, device_pair, is_topic, tell_apart, where_it_helps, where_it_varies
from dds_trace.analyzer.model.parameters import SERIES_COLUMNS, Parameters
from dds_trace.analyzer.model.setting import parse_setting
from dds_trace.analyzer.statistics.percentiles import STATISTICS
from dds_trace.base.extension import load
from dds_trace.base.printable import MAX_FINDING_CHARACTERS, printable
from dds_trace.base.units import (
    MISSING,
    by_number,
    first_of,
    format_duration,
    format_number,
    format_rate,
    format_size,
    joined,
)

_MARKDOWN_PLAIN = frozenset(" ,()%+-=/'.;:?!\"")


def markdown(text: object) -> str:
    """Escape text for GitHub's Markdown, also inside a table cell.

    Punctuation becomes entities. An empty comment follows `@` and `#`, as GitHub looks for mentions and issues after it
    has resolved entities.
    """
    parts = []
    for c in printable(text, MAX_FINDING_CHARACTERS):
        if c.isalnum() or c in _MARKDOWN_PLAIN:
            parts.append(c)
        elif c in "@#":
            parts.append(f"{c}<!-- -->")
        else:
            parts.append(f"&#{ord(c)};")
    # An entity inside an address stops GitHub from turning it into a link.
    return "".join(parts).replace("://", "&#58;//").replace("www.", "www&#46;")


LOST = "lost"


def time_words(value_ns: float | None, unit: str | None = None) -> str:
    return LOST if value_ns is not None and math.isinf(value_ns) else format_duration(value_ns, unit)


def times_words(values_ns: Sequence[float | None]) -> list[str]:
    """Return times in the unit of the largest."""
    finite_ns = [abs(value) for value in values_ns if value is not None and math.isfinite(value)]
    unit = format_duration(max(finite_ns, default=0.0)).rpartition(" ")[2]
    return [time_words(value, unit) for value in values_ns]


def format_count(value: float | None) -> str:
    return MISSING if value is None else f"{int(value):,}"


LATENCY_MEANING = (
    "Latency is (round trip - time in the relay) / 2, each of the two measured on one device's own clock. It is the mean of a "
    "message's two ways, so its tail differs from the tail of one way: a message that was slow one way only counts with half of the delay. "
    "Where the slow moments of the two ways do not coincide, the p99 of the latency is 20 to 50 % below the p99 of one way in simulations. "
    "Read tails of one way from outbound and return with their clock bound, deadlines from the response."
)

METRIC_LABELS = {name: METRICS[name].label for name in ("latency", *METRICS)}

ALL_METRIC_LABELS = {**METRIC_LABELS, **TOPIC_METRICS}

METRIC_MENU = {"intermediate": "Time in relay (the paper's intermediate-process time)"}

STATISTIC_LABELS = {"p50": "", **{statistic.name: statistic.label for statistic in STATISTICS if statistic.label}}
"""In the order of menus: the median first."""

VENDORS = {
    "fastdds": "Fast DDS",
    "cyclonedds": "Cyclone DDS",
    "connext": "RTI Connext",
    "zenoh": "Zenoh",
    "socket": "Socket",
}
"""Labels in the order of a report; sessions have others."""

BRIDGES = {"builtin": "our built-in bridge", "builtin-zenoh": "our built-in Zenoh bridge"}

DATA_TYPES = {"binary": "Binary", "string": "String", "imu": "IMU"}


@dataclass(frozen=True, slots=True)
class VendorLabels:
    labels: Mapping[str, str]

    def of(self, vendor: str) -> str:
        return self.labels.get(vendor, printable(vendor))

    def of_pair(self, vendor: str, relay_vendor: str | None) -> str:
        if relay_vendor is None or relay_vendor == vendor:
            return self.of(vendor)
        return f"{self.of(vendor)} → {self.of(relay_vendor)}"


_NAMED = (
    *("vendor", "relay_vendor", "backend", "relay_backend", "rmw", "domain_mode", "bridge", "ping_domain_id"),
    *("relay_domain_id", "reliability", "durability", "history", "depth", "serialization", "ping_device"),
    *("relay_device", "connectivity", "setting"),
)
"""Parameters with words of their own in a label, in the order in which they sort series."""


@dataclass(frozen=True, slots=True)
class Series(Parameters):
    """What is not the message: its parameters are the same in all series."""

    vendor_label: str = ""

    @property
    def further(self) -> tuple[str, ...]:
        return tuple(f"{name} {getattr(self, name)}" for name in SERIES_COLUMNS if name not in _NAMED)

    def of(self, names: Iterable[str]) -> tuple[object, ...]:
        return tuple(getattr(self, name) for name in names)


@dataclass(frozen=True, slots=True)
class Cell:
    data_type: str
    payload_bytes: int
    rate_hz: float

    @property
    def label(self) -> str:
        if is_topic(self.data_type):
            return printable(self.data_type)
        return f"{data_type_label(self.data_type)} {format_size(self.payload_bytes)} at {format_rate(self.rate_hz)}"


@dataclass(frozen=True, slots=True)
class Group:
    index: int
    series: int
    cell: int
    published: int
    received: int


@dataclass(frozen=True, slots=True)
class Groups:
    groups: tuple[Group, ...]
    series: tuple[Series, ...]
    cells: tuple[Cell, ...]
    labels: tuple[str, ...]
    vendors: VendorLabels

    @property
    def in_order(self) -> list[Group]:
        return sorted(self.groups, key=lambda group: (group.cell, group.series))

    def cell_of(self, group: Group) -> Cell:
        return self.cells[group.cell]

    def series_of(self, group: Group) -> Series:
        return self.series[group.series]


def groups_info(analysis: Analysis) -> Groups:
    return groups_of(analysis.summary.to_dicts(), vendor_labels(analysis))


def groups_of(rows: Sequence[Mapping[str, Any]], vendors: VendorLabels) -> Groups:
    series_rows = [_series(row, vendors) for row in rows]
    cell_rows = [Cell(**{name: row[name] for name in Cell.__dataclass_fields__}) for row in rows]
    series = tuple(sorted(set(series_rows), key=_series_order))
    order = {cell: (*data_type_rank(cell.data_type), cell.payload_bytes, cell.rate_hz) for cell in cell_rows}
    cells = tuple(sorted(order, key=order.__getitem__))
    series_index = {value: index for index, value in enumerate(series)}
    cell_index = {value: index for index, value in enumerate(cells)}
    groups = tuple(
        Group(i, series_index[series_rows[i]], cell_index[cell_rows[i]], row["published"], row["received"])
        for i, row in enumerate(rows)
    )
    return Groups(groups, series, cells, tuple(series_labels(series)), vendors)


def series_labels(series: Sequence[Series]) -> list[str]:
    parts = (*_LABEL_PARTS, (where_it_helps, _setting_part(series)))
    return tell_apart(series, lambda member: member.vendor_label, parts)


def _setting_part(series: Sequence[Series]) -> Callable[[Series], str]:
    word = setting_word(member.setting for member in series)
    return lambda member: word(member.setting)


def setting_word(settings: Iterable[str]) -> Callable[[str], str]:
    """Return how one of some settings is named: by what varies, a file by its name where that is unique."""
    parsed = {setting: _named_once(parse_setting(setting)) for setting in settings}
    keys = sorted({key for setting in parsed.values() for key in setting})
    varying = [key for key in keys if len({setting.get(key) for setting in parsed.values()}) > 1]
    files = {(key, value) for setting in parsed.values() for key, value in setting.items() if _FILE.search(value)}
    names = Counter(_FILE.sub("", value) for _, value in files)

    def words(key: str, value: str) -> str:
        name = _FILE.sub("", value)
        if (key, value) in files and names[name] == 1:
            return name
        return key if value == "true" else value if key == "outage_by" else f"{key}={value}"

    return lambda setting: printable(
        ", ".join(words(key, parsed[setting][key]) for key in varying if key in parsed[setting])
    )


_FILE = re.compile(r"#[0-9a-f]{8}\b")
"""The end of a configuration file's name, of its content."""


def _named_once(setting: dict[str, str]) -> dict[str, str]:
    """Leave out a sweep's word for its configuration where the file of that name is there."""
    stems = {PurePath(_FILE.sub("", value)).stem for value in setting.values() if _FILE.search(value)}
    return {key: value for key, value in setting.items() if key != "configuration" or value not in stems}


def setting_labels(settings: Sequence[Mapping[str, Any]], vendors: VendorLabels) -> list[str]:
    series = [_series({**dict.fromkeys(SERIES_COLUMNS), **setting}, vendors) for setting in settings]
    parts = (*_LABEL_PARTS, (where_it_varies, _setting_part(series)))
    rules = [(where_it_varies if word not in _FOLLOWING else rule, word) for rule, word in parts]
    return tell_apart(series, lambda member: member.vendor_label, rules)


def vendor_labels(analysis: Analysis) -> VendorLabels:
    labels = {session.vendor: session.extra.get("vendor_label") for session in analysis.sessions}
    labelled = {vendor: printable(label) for vendor, label in labels.items() if isinstance(label, str) and label}
    return VendorLabels({**labelled, **VENDORS})


_NO_MESSAGE: dict[str, Any] = {"data_type": "", "payload_bytes": 0, "rate_hz": 0.0}


def _series(row: Mapping[str, Any], vendors: VendorLabels) -> Series:
    label = vendors.of_pair(row["vendor"], row["relay_vendor"])
    return Series(**_NO_MESSAGE, **{name: row[name] for name in SERIES_COLUMNS}, vendor_label=label)


def group_labels(groups: Groups) -> dict[int, str]:
    vendors = {series.vendor_label for series in groups.series}
    shared = vendors.pop() if len(vendors) == 1 else ""
    short = [label.removeprefix(shared).removeprefix(", ") for label in groups.labels]
    return {
        group.index: ", ".join(filter(None, (groups.cell_of(group).label, short[group.series])))
        for group in groups.groups
    }


def data_type_label(data_type: str) -> str:
    return DATA_TYPES.get(data_type, printable(data_type))


def domain_label(series: Series) -> str:
    if series.domain_mode == "same":
        return "same domain" if series.bridge == "none" else f"same domain {way_words(series.bridge)}"
    return way_words(series.bridge)


def in_domain(label: str) -> str:
    return {"same domain": "in the same domain", "different domains": "across different domains"}.get(label, label)


def way_words(bridge: str) -> str:
    return "different domains" if bridge == "none" else f"through {BRIDGES.get(bridge, printable(bridge))}"


def qos_label(series: Series) -> str:
    return printable(f"{series.reliability}, {series.durability}, {_history_label(series)}")


def _history_label(series: Series) -> str:
    depth = "" if series.history == "keep_all" or series.depth is None else f" {series.depth}"
    return printable(f"{series.history}{depth}")


def device_label(series: Series) -> str:
    return device_pair(series.ping_device, series.relay_device)


def _backend_label(series: Series) -> str:
    return device_pair(series.backend, series.relay_backend)


def _rmw_label(series: Series) -> str:
    return printable(series.rmw or "no rmw")


_LABEL_PARTS: tuple[tuple[Rule, Callable[[Series], str]], ...] = (
    (where_it_varies, domain_label),  # readers look for it first
    (where_it_helps, _backend_label),
    (where_it_helps, lambda s: printable(s.reliability)),
    (where_it_helps, lambda s: printable(s.durability)),
    (where_it_helps, _history_label),
    (where_it_helps, lambda s: printable(s.serialization)),
    (where_it_helps, device_label),
    (where_it_helps, lambda s: printable(s.connectivity)),
    (where_it_helps, lambda s: f"domains {s.ping_domain_id} → {s.relay_domain_id}"),
    (where_it_helps, _rmw_label),
    (where_it_helps, lambda s: printable(", ".join(s.further))),
)

_FOLLOWING = (_backend_label, _rmw_label)
"""Parts that mostly follow from the vendor."""


def in_order_of(values: Iterable[str], order: Iterable[str]) -> list[str]:
    rank = {name: index for index, name in enumerate(order)}
    return sorted(set(values), key=lambda value: (rank.get(value, len(rank)), value))


MOST_NAMED = 3


def some_of(parts: Sequence[str], noun: str, one: str = "") -> str:
    return "; ".join(first_of(parts, MOST_NAMED, one if one and len(parts) == MOST_NAMED + 1 else noun))


def size_span(sizes: Sequence[int], all_sizes: Sequence[int]) -> str:
    if len(sizes) < sum(sizes[0] <= size <= sizes[-1] for size in all_sizes):
        return f"at {joined(map(format_size, sizes))}"
    low, high = format_size(sizes[0]), format_size(sizes[-1])
    if low == high:
        return f"at {low}"
    first, last = sizes[0] == min(all_sizes), sizes[-1] == max(all_sizes)
    if first and last:
        return f"at every size ({low} to {high})"
    return f"from {low} on" if last else f"up to {high}" if first else f"from {low} to {high}"


def factor_words(factors: Sequence[float]) -> str:
    low, high = (format_number(end) for end in (min(factors), max(factors)))
    if high == "1":
        return "less than 1.01 times"
    return f"{high if low == high else f'up to {high}' if low == '1' else f'{low} to {high}'} times"


def _series_order(series: Series) -> tuple[object, ...]:
    vendors = [*VENDORS, series.vendor]
    fields = tuple(by_number(str(value)) for value in (*series.of(_NAMED), series.further, series.vendor_label))
    return (vendors.index(series.vendor), series.vendor, series.domain_mode != "same", series.bridge, fields)


def data_type_rank(data_type: str) -> tuple[int, str]:
    return [*DATA_TYPES, data_type].index(data_type), data_type


def drift_words(fit: Mapping[str, Any]) -> str:
    drift, bound = (round(fit[key] / 1000, 3) for key in ("drift_ppb", "drift_bound_ppb"))
    return f"{'+' if drift > 0 else ''}{format_number(drift)} ± {format_number(max(bound, 0.001))} ppm"


def is_of_topics(analysis: Analysis) -> bool:
    """Return whether topics were recorded, and messages of our own only by beacons, which compare clocks."""
    return analysis.topics.height > 0 and all(run.labels.get("role") == "beacon" for run in analysis.runs)


def topic_parts(analysis: Analysis, part: str) -> tuple[Any, ...]:
    return tuple(load("parts", part)(analysis)) if analysis.topics.height else ()
