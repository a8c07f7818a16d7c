"""The first sentences of a report; each rests on verdicts within one device pair and link."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from statistics import median

import polars as pl

from dds_trace.analyzer.analysis import Analysis
from dds_trace.analyzer.model.names import device_pair
from dds_trace.analyzer.model.setting import condition_of, parse_setting, write_setting
from dds_trace.analyzer.statistics.intervals import MIN_RUNS, Basis
from dds_trace.analyzer.verdicts.judgements import PROVEN, Claim
from dds_trace.base.printable import printable
from dds_trace.base.units import counted, format_duration, joined
from dds_trace.tracefile.format.json_fields import object_of

from .fastest import PERCENTILES
from .groups import Groups, VendorLabels, factor_words, some_of, way_words
from .numbers import Values
from .verdicts import link_label, received_words, setup_labels

BUSY_SHARE = 0.25
"""Share of processes with a full processor from which on a report warns."""


def recovery_sentences(analysis: Analysis, groups: Groups) -> list[str]:
    series = {group.index: groups.series_of(group) for group in groups.groups}
    labels = setup_labels({group: asdict(member) for group, member in series.items()}, groups.vendors)
    outages: dict[tuple[str, float, str], dict[str, list[float | None]]] = {}
    for group, by, never, back_ns in analysis.details.recoveries.select("group", "by", "never", "back_ns").iter_rows():
        if group in series:
            planned = parse_setting(series[group].setting).get("outage", "")
            length_s = float(planned.removesuffix("s")) if planned[:1].isdigit() else 0.0
            outage = _OUTAGES.get(by, by), length_s, planned
            outages.setdefault(outage, {}).setdefault(labels[group], []).append(None if never else back_ns)
    return [
        printable(
            f"Back after {planned or 'an outage'} {by}: {joined(_came_back(*setup) for setup in setups.items())}."
        )
        for (by, _, planned), setups in sorted(outages.items())
    ]


_OUTAGES = {
    "link": "with the link down",
    "address": "with the link down and another address",
    "loss": "with all packets lost",
    "relay": "without the relay",
}


def _came_back(name: str, times_ns: Sequence[float | None]) -> str:
    back_ns = sorted(time_ns for time_ns in times_ns if time_ns is not None)
    runs, never = counted(len(times_ns), "run"), len(times_ns) - len(back_ns)
    if not back_ns:
        return f"{name} never ({runs})"
    least, middle, most = (
        format_duration(ns) if ns else "at once" for ns in (back_ns[0], median(back_ns), back_ns[-1])
    )
    ends = f"{least} to {most}, " if least != most else ""
    return (
        f"{name} {'' if middle == 'at once' else 'in '}{middle} ({ends}{runs}{f', never in {never}' if never else ''})"
    )


def interference_sentences(analysis: Analysis, groups: Groups) -> list[str]:
    vendors = {group.index: groups.series_of(group).vendor_label for group in groups.groups}
    is_of_page = pl.col("group").is_in(list(vendors))
    judged = analysis.judgements.filter(is_of_page, claim=Claim.WITH.value)
    is_open = {key for key, rows in _by_flow(judged, "base", "subject") if {*rows["basis"]} == {Basis.WITHIN_RUN.value}}
    cases: dict[tuple[str, str], list[str]] = {}
    for key, rows in _by_flow(judged, "base", "subject"):
        factors: dict[tuple[str, str], list[float]] = {}
        for row in rows.filter(pl.col("value").is_not_null(), verdict=PROVEN).iter_rows(named=True):
            factors.setdefault((vendors[row["group"]], row["statistic"]), []).append(row["value"])
        cases[key] = [f"takes {'; '.join(_as_long(*factor) for factor in factors.items())}"] if factors else []
    changed = pl.col("received_verdict").is_in([*_LOSES])
    for key, rows in _by_flow(analysis.details.interference.filter(is_of_page, changed), "flow", "with_flows"):
        ordered = rows.sort(pl.col("received_difference").abs(), descending=True)
        row = ordered.row(0, named=True)
        cases.setdefault(key, []).append(f"{_LOSES[row['received_verdict']]} (received {received_words(row)})")
    return [
        printable(f"{_WITH_OF[bool(flow)].format(flow=flow, others=others)} {' and '.join(parts)}.")
        if parts
        else _not_slowed(flow, others, is_open=(flow, others) in is_open)
        for (flow, others), parts in cases.items()
    ]


_LOSES = {"worse": "loses more", "better": "loses less"}
_WITH_OF = {True: "The flow {flow} with {others}", False: "A message with {others}"}


def _by_flow(rows: pl.DataFrame, flow: str, others: str) -> Iterator[tuple[tuple[str, str], pl.DataFrame]]:
    for (name, with_flows), part in rows.group_by(flow, others, maintain_order=True):
        yield (str(name), str(with_flows)), part


def _not_slowed(flow: str, others: str, *, is_open: bool) -> str:
    names, what = others.split("+"), flow or "a message"
    is_single = len(names) == 1
    if is_open:
        return printable(
            f"Whether {joined(names)} {'slows' if is_single else 'slow'} {what} is open: a verdict needs {MIN_RUNS} runs of each."
        )
    return printable(f"{joined(names)} {'does' if is_single else 'do'} not measurably slow {what}.")


def _as_long(vendor_statistic: tuple[str, str], factors: Sequence[float]) -> str:
    vendor, statistic = vendor_statistic
    finite = [factor for factor in factors if math.isfinite(factor)]
    where = f"{dict(PERCENTILES)[statistic.removeprefix('latency_')]} ({vendor})"
    lost = [f"longer {where}, as messages were lost"] * (len(finite) < len(factors))
    return "; ".join([f"{factor_words(finite)} as long {where}"] * bool(finite) + lost)


def bridge_sentence(costs: pl.DataFrame, vendors: VendorLabels) -> str:
    facts = bridge_facts(costs, vendors)
    return f"{COMPARED}: {'; '.join(facts)}." if facts else ""


COMPARED = "A message takes, compared with the same domain"


def bridge_facts(costs: pl.DataFrame, vendors: VendorLabels) -> tuple[str, ...]:
    latencies = costs.filter(metric="latency")
    several = latencies["vendor"].n_unique() > 1
    ways = latencies.group_by("bridge", "vendor", "relay_vendor", maintain_order=True)
    parts = []
    for (bridge, vendor, relay_vendor), rows in ways:
        factors = _cost_words(rows)
        if factors:
            pair = vendors.of_pair(str(vendor), None if relay_vendor is None else str(relay_vendor))
            parts.append(f"{way_words(str(bridge))}{f' with {pair}' if several else ''} {factors}")
    return tuple(parts)


def _cost_words(rows: pl.DataFrame) -> str:
    parts = []
    has_time = pl.col("ratio").is_finite().fill_null(value=False) & (pl.col("ratio") > 0)
    is_proven = pl.col("verdict").is_in(["worse", "better"])
    for name, label in PERCENTILES:
        costs = rows.filter(is_proven | pl.col("ratio").is_not_null(), statistic=name)  # others have too few messages
        timed = costs.filter(has_time)
        ratios = {
            words: timed.filter(verdict=verdict)["ratio"].to_list()
            for verdict, words in (("worse", "slower"), ("better", "faster"))
        }
        if factors := " and ".join(factor_words(values) for values in ratios.values() if values):
            counts = {words: len(values) for words, values in ratios.items()} if all(ratios.values()) else {}
            counts |= {
                "lost": len(costs) - len(timed),
                "proven": 0 if counts or timed.filter(~is_proven).is_empty() else len(timed.filter(is_proven)),
            }
            noted = [f"{words} in {count}" for words, count in counts.items() if count]
            of_all = f" ({', '.join(noted)} of {counted(costs.height, 'comparison')})" if noted else ""
            parts.append(f"{factors} as long {label}{of_all}")
    return ", ".join(parts)


_COUNTS = ("flows", "relays")
"""Conditions that are numbers, by default 1."""


def where_sentence(analysis: Analysis, groups: Groups, values: Values) -> str:
    counts_by_link: dict[tuple[str, str, str], list[tuple[int, ...]]] = {}
    with_relay = {series.ping_device for series in groups.series if series.relay_device is not None}
    for series in groups.series:
        if series.relay_device is None and series.ping_device in with_relay:
            continue
        pair = device_pair(series.ping_device, series.relay_device)
        if series.relay_device == series.ping_device:
            pair = f"one machine ({pair})"
        conditions = parse_setting(condition_of(series.setting))
        numbers = tuple(int(conditions.pop(name, "1")) for name in _COUNTS)
        link = pair, series.connectivity, write_setting(conditions)
        counts_by_link.setdefault(link, []).append(numbers)
    links: dict[str, list[str]] = {}
    for (pair, connectivity, others), numbers_there in counts_by_link.items():
        ends = [(min(numbers), max(numbers)) for numbers in zip(*numbers_there, strict=True)]
        ranges = [" to ".join(map(str, dict.fromkeys(end))) if end[1] > 1 else "" for end in ends]
        conditions = {**dict(zip(_COUNTS, ranges, strict=True)), **parse_setting(others)}
        counted_link = write_setting({name: value for name, value in conditions.items() if value})
        links.setdefault(pair, []).append(link_label(connectivity, counted_link, " with "))
    pairs_of: dict[tuple[str, ...], list[str]] = {}
    for pair, link_names in links.items():
        pairs_of.setdefault(tuple(link_names), []).append(pair)
    parts = [
        f"{joined(pairs)}, {'each ' if len(pairs) > 1 and len(own_links) > 1 else ''}{joined(own_links)}"
        for own_links, pairs in pairs_of.items()
    ]
    counts = sorted({round(count) for count in values.plain["runs"] if count})
    fewest = f"{counts[0]} to " if len(counts) > 1 else ""
    runs = f"; {fewest}{counted(counts[-1], 'run')} of each" if counts else ""
    middlewares = [object_of(session.host.get("middleware")) for session in analysis.sessions]
    executors = sorted({str(setting["executor"]) for setting in middlewares if "executor" in setting})
    through_ros, without_ros = (
        sorted({groups.vendors.of(s.vendor) for s in analysis.sessions if (s.backend == "ros2") is is_ros})
        for is_ros in (True, False)
    )
    ros = f"ROS 2 with the {printable(joined(executors))} executor" if executors else ""
    if ros and without_ros:
        ros = f"{joined(through_ros)} through {ros}, {joined(without_ros)} through Python without ROS 2"
    return f"Measured on {some_of(parts, 'more links', 'more link')}{runs}{'; ' * bool(ros)}{ros}."


def limits_words(analysis: Analysis) -> str:
    counts = Counter(code for finding in analysis.findings for code in [finding.code] * finding.count)
    full, samples = counts["cpu_saturated"], analysis.details.host_samples
    processes, words = samples["session_id"].n_unique(), []
    if full and full >= BUSY_SHARE * processes:
        process = f"{joined(sorted(samples['role'].unique()))} process"
        which = counted(processes, process, f"{process}es")
        words = [f"The machine was busy during {full} of {which}: these times include waiting for a processor."]
    if bound := counts["client_bound"]:
        words += [f"The throughput of {counted(bound, 'result')} is that of our ping or relay, not the middleware's."]
    return " ".join(words)
