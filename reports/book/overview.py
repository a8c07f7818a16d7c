"""What was measured, in lines above all figures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import timedelta

import polars as pl

from dds_trace.analyzer.analysis import Analysis
from dds_trace.analyzer.model.setting import condition_of
from dds_trace.base.printable import printable
from dds_trace.base.units import counted, first_of, format_rate, format_size, utc_of

from .groups import (
    VENDORS,
    Groups,
    data_type_label,
    device_label,
    domain_label,
    format_count,
    in_order_of,
    is_of_topics,
    qos_label,
)
from .recording import OwnCost, RunTime, cost_words, discovery_words, setting_words, version_words
from .verdicts import conditions_label

MOST_LISTED = 12


@dataclass(frozen=True, slots=True)
class Fact:
    label: str
    value: str


@dataclass(frozen=True, slots=True)
class Overview:
    facts: tuple[Fact, ...]

    @property
    def messages(self) -> str:
        counts = next((fact.value for fact in self.facts if fact.label == "Messages"), "")
        return counts.replace(" in ", f" {'message' if counts.startswith('1 ') else 'messages'} in ", 1)

    @property
    def brief(self) -> str:
        values = {fact.label: self.messages if fact.label == "Messages" else fact.value for fact in self.facts}
        return "; ".join(values[label] for label in ("Middleware", "Devices", "Messages", "When") if label in values)


def overview_info(analysis: Analysis, groups: Groups, costs: Sequence[OwnCost], times: Sequence[RunTime]) -> Overview:
    if is_of_topics(analysis):  # what beacons sent is not what was measured
        groups = replace(groups, cells=(), series=tuple(replace(member, setting="") for member in groups.series))
    conditions = {conditions_label(condition_of(member.setting)) for member in groups.series}
    devices = dict.fromkeys(device_label(member) for member in groups.series) or sorted(
        {f"{printable(member.device)} ({printable(member.role)})" for member in analysis.sessions}
    )
    vendors = [member.vendor_label for member in groups.series] or [
        groups.vendors.of(member) for member in in_order_of({member.vendor for member in analysis.sessions}, VENDORS)
    ]
    facts = (
        Fact("Devices", _listed(devices)),
        Fact("Link", _listed(sorted({printable(member.connectivity) for member in groups.series}))),
        Fact("Conditions", "; ".join(sorted(conditions - {""}))),
        Fact("Middleware", _listed(dict.fromkeys(vendors))),
        Fact("Domains", _listed(list(dict.fromkeys(domain_label(member) for member in groups.series)))),
        Fact("Messages", _messages(analysis)),
        Fact("Sent", _sent(groups)),
        Fact("Rates", _rates(groups)),
        Fact("When", _when(analysis, times)),
        Fact("Traces", _traces(analysis)),
        Fact("Quality of service", _listed(dict.fromkeys(qos_label(member) for member in groups.series))),
        Fact("Discovery", discovery_words(analysis.sessions)),
        Fact("Settings", setting_words(analysis)),
        Fact("Versions", version_words(analysis)),
        Fact("Cost of measuring", cost_words(costs, analysis.sessions)),
    )
    return Overview(tuple(fact for fact in facts if fact.value))


def _listed(values: Iterable[str]) -> str:
    return ", ".join(first_of([*values], MOST_LISTED))


def _messages(analysis: Analysis) -> str:
    of_topics = is_of_topics(analysis)
    counts = analysis.topics.with_columns(unsent=pl.lit(0)) if of_topics else analysis.summary
    if not counts.height:
        return ""
    published, received, unsent = (int(counts[name].sum()) for name in ("published", "received", "unsent"))
    due, runs = published + unsent, len(analysis.runs)
    share = "all received" if due == received else f"{format_count(received)} received"
    never = f", {format_count(unsent)} never sent" if unsent else ""
    parts = counted(counts["topic"].n_unique(), "topic") if of_topics else counted(runs, "run")
    return f"{format_count(due)} in {parts}, {share}{never}"


def _sent(groups: Groups) -> str:
    sizes: dict[str, dict[int, None]] = {}
    for cell in groups.cells:
        sizes.setdefault(cell.data_type, {})[cell.payload_bytes] = None
    return "; ".join(
        f"{data_type_label(data_type)} {_listed(map(format_size, values))}"
        for data_type, values in list(sizes.items())[:MOST_LISTED]
    )


def _rates(groups: Groups) -> str:
    rates = sorted({cell.rate_hz for cell in groups.cells})
    if not rates:
        return ""
    if len(rates) > MOST_LISTED:
        return f"{len(rates)} rates from {format_rate(rates[0])} to {format_rate(rates[-1])}"
    return ", ".join(format_rate(rate).removesuffix(" Hz") for rate in rates) + (" Hz" if rates[-1] else "")


def _when(analysis: Analysis, times: Sequence[RunTime]) -> str:
    instants = [session.wall_anchor_ns for session in analysis.sessions]
    if not instants:
        return ""
    instants += [run.session.wall_ns(run.last_ns) for run in times if run.session is not None]
    start, end = utc_of(min(instants)), utc_of(max(instants))
    if start is None or end is None:
        return ""
    if end.date() == start.date():
        span = "" if end - start < timedelta(minutes=1) else f" to {end:%H:%M}"
        return f"{start:%Y-%m-%d %H:%M}{span} UTC"
    return f"{start:%Y-%m-%d %H:%M} to {end:%Y-%m-%d %H:%M} UTC"


def _traces(analysis: Analysis) -> str:
    if not analysis.sources:
        return "none found"
    counts = Counter(source.status for source in analysis.sources)
    return ", ".join(f"{count} {printable(status)}" for status, count in counts.items())
