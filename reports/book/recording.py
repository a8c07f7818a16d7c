"""Who recorded in which environment, what was read, and what measuring cost."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter

import polars as pl

from dds_trace.analyzer.analysis import Analysis
from dds_trace.analyzer.groups.timeline import run_rows
from dds_trace.analyzer.model import applied
from dds_trace.analyzer.model.environment import middleware_version, versions_of
from dds_trace.base.printable import printable
from dds_trace.base.units import counted, first_of, format_duration, format_ratio, three_digits
from dds_trace.tracefile.format.descriptions import Session
from dds_trace.tracefile.format.json_fields import JsonObject, number_of, object_of

from ..blocks import EVERYWHERE, Block, Column, Fold, Row, Sentence, Span, Table
from .groups import VENDORS, Groups, VendorLabels, format_count, in_order_of, qos_label, vendor_labels
from .numbers import whole_ns


@dataclass(frozen=True, slots=True)
class RunTime:
    """One run; `published` and `received` count messages times relays."""

    run_id: int
    group: int
    origin_ns: int
    last_ns: int
    session: Session | None
    published: int = 0
    received: int = 0
    p50_ns: int | None = None
    max_ns: int | None = None


def run_times(analysis: Analysis) -> tuple[RunTime, ...]:
    frame = run_rows(analysis.run_times, analysis.scan_roundtrips())
    rows = {row["run_id"]: row for row in frame.iter_rows(named=True)}
    sessions = {f"{session.session_id:016x}": session for session in analysis.sessions}
    session_of = {run.run_id: sessions.get(str(run.extra.get("session_id"))) for run in analysis.runs}
    drawn = analysis.timeline.group_by("run_id", maintain_order=True).agg(pl.first("group"))
    return tuple(
        RunTime(group=group, session=session_of.get(run_id), **{**row, "p50_ns": whole_ns(row["p50_ns"])})
        for run_id, group in drawn.iter_rows()
        if (row := rows.get(run_id)) and None not in (row["origin_ns"], row["last_ns"])
    )


MOST_ROWS = 200
"""The JSON report has all rows."""

FLEETING = "wifi"


_LONGEST_SETTING = 40

_WAYS = {applied.SHARED_MEMORY: "shared memory", applied.UNKNOWN: "an unknown way"}


def file_table(analysis: Analysis) -> Iterator[Fold]:
    rows = [
        Row([printable(source.path), printable(source.status), format_count(source.events), printable(source.detail)])
        for source in sorted(analysis.sources, key=lambda source: source.status == "read")
    ]
    if rows:
        columns = [*map(Column, ("File", "Status", "Events", "Detail"))]
        parts: list[Block] = [Table(columns, rows[:MOST_ROWS], label="Files")]
        if len(rows) > MOST_ROWS:
            parts.append(Sentence(f"{len(rows) - MOST_ROWS} more rows are in the JSON report (--report json).", "note"))
        yield Fold(f"Files ({len(rows)})", parts)


@dataclass(frozen=True, slots=True)
class OwnCost:
    """Cost of measuring with one vendor and backend: the slowest of its sessions, null if no session measured it.

    Attributes:
        record_median_ns: median time to record one event.
        floor_median_ns: median time of a short message from a node to itself, the floor of every latency through this library.
        floor_messages: smallest number of messages of a floor.
        single_executor_ns: as `floor_median_ns`, with rclpy's single-threaded executor in place of the default one.
    """

    vendor: str
    backend: str
    record_median_ns: int | None
    record_p99_ns: int | None
    floor_median_ns: int | None
    floor_p99_ns: int | None
    floor_messages: int | None
    single_executor_ns: int | None = None


def own_costs(analysis: Analysis) -> tuple[OwnCost, ...]:
    by_backend: dict[tuple[str, str], list[Session]] = {}
    for session in analysis.sessions:
        by_backend.setdefault((session.vendor, session.backend), []).append(session)
    order = in_order_of({vendor for vendor, _ in by_backend}, VENDORS)
    costs = []
    for vendor, backend in sorted(by_backend, key=lambda pair: (order.index(pair[0]), pair[1])):
        sessions = by_backend[vendor, backend]
        cost = OwnCost(
            vendor,
            backend,
            max(_numbers(sessions, "recorder_cost", "record_median_ns"), default=None),
            max(_numbers(sessions, "recorder_cost", "record_p99_ns"), default=None),
            max(_numbers(sessions, "client_library_floor", "median_ns"), default=None),
            max(_numbers(sessions, "client_library_floor", "p99_ns"), default=None),
            min(_numbers(sessions, "client_library_floor", "messages"), default=None),
            max(_numbers(sessions, "single_executor_floor", "median_ns"), default=None),
        )
        if cost.record_median_ns is not None or cost.floor_median_ns is not None:
            costs.append(cost)
    return tuple(costs)


def cost_words(costs: Sequence[OwnCost], sessions: Sequence[Session]) -> str:
    parts = (
        ("recording an event", "record_median_ns", "record_p99_ns"),
        ("a message from a node to itself", "floor_median_ns", "floor_p99_ns"),
    )
    words = []
    for what, median, p99 in parts:
        measured = [cost for cost in costs if getattr(cost, median) is not None]
        if measured:
            slowest = max(measured, key=attrgetter(median))
            tail = getattr(slowest, p99)
            within = "" if tail is None else f" (p99 {format_duration(tail)})"
            words.append(f"{what} {format_duration(getattr(slowest, median))}{within}")
    floors = [(cost.single_executor_ns, cost.floor_median_ns) for cost in costs]
    added_ns = [single - default for single, default in floors if single is not None and default is not None]
    words += [f"through rclpy with -o executor=single +{format_duration(max(added_ns))}"] if added_ns else []
    words += ["not subtracted"] if words else []
    used_ns = zip(*(_numbers(sessions, "own_cost", name) for name in ("cpu_ns", "duration_ns")), strict=False)
    shares = [cpu_ns / max(duration_ns, 1) for cpu_ns, duration_ns in used_ns]
    words += [f"a tap {format_ratio(max(shares))} of one core"] if shares else []
    return "; ".join(words)


def discovery_words(sessions: Sequence[Session]) -> str:
    by_setup: dict[tuple[str, float], list[JsonObject]] = {}
    for session in sessions:
        nodes = object_of(session.extra.get("nodes"))
        if (number := number_of(nodes.get("number"))) is not None:
            name = VENDORS.get(session.vendor, session.vendor)
            by_setup.setdefault((printable(f"{name} {middleware_version(session)}"), number), []).append(nodes)
    words = []
    for (name, number), measured in sorted(by_setup.items()):
        met_s, packets, size_bytes = (
            statistics.median(math.inf if (value := number_of(nodes.get(key))) is None else value for nodes in measured)
            for key in ("met_s", "packets_per_second", "bytes_per_second")
        )
        rest = f"at rest {packets:.0f} packets and {three_digits(size_bytes / 1000)} KB a second"
        met = f"all met {met_s:.2g} s after the last one opened, " if math.isfinite(met_s) else "not all met, "
        words.append(f"{name}, {counted(int(number), 'node')}: {met if number > 1 else ''}{rest}")
    return "; ".join(words)


def setting_words(analysis: Analysis) -> str:
    pairs = []
    for session in analysis.sessions:
        for name, value in object_of(session.host.get("middleware")).items():
            text = printable(value, _LONGEST_SETTING)
            is_xml = text.startswith("<")  # it would fill the screen
            pairs.append(("configuration", "in XML") if is_xml else (printable(name), text or "none"))
        path = applied.payload_path(session)
        if path is not None:
            pairs.append(("payload carried by", _WAYS.get(path, printable(path))))
    return "; ".join(_each(pairs))


def version_words(analysis: Analysis) -> str:
    versions = [versions_of(session).items() for session in analysis.sessions]
    return ", ".join(_each((printable(name), printable(value)) for packages in versions for name, value in packages))


def _each(pairs: Iterable[tuple[str, str]]) -> Iterator[str]:
    values: dict[str, dict[str, None]] = {}
    for name, value in pairs:
        values.setdefault(name, {})[value] = None
    return (f"{name} {' or '.join(texts)}" for name, texts in values.items())


def _numbers(sessions: Sequence[Session], part: str, name: str) -> list[int]:
    parts = [fields for session in sessions if isinstance(fields := session.extra.get(part), dict)]
    return [round(value) for fields in parts if (value := number_of(fields.get(name))) is not None and value >= 0]


MOST_COLUMNS = 16
_MOST_VALUES = 4

_VARIED, _USED = "Sessions", "Seen in use"
_SECTIONS = {
    "versions": "Versions",
    "middleware": "Settings of the middleware",
    "settings": "Environment variables",
    "configuration": "Configuration",
    "socket_buffers": "Limits of socket buffers (bytes)",
    "mtu": "MTU of interfaces (bytes)",
}
"""Headings of parts of a fingerprint; others are under the machine."""
_NAMES = {
    "cpu_model": "processor",
    "cpu_cores": "processors",
    "cpu_cores_physical": "cores",
    "cpu_governor": "governor",
    "cpu_max_mhz": "highest MHz",
    "os": "system",
    "kernel_realtime": "realtime kernel",
    "memory_bytes": "memory (bytes)",
}


def recorded_environment(analysis: Analysis, groups: Groups) -> tuple[Block, ...]:
    vendors = vendor_labels(analysis)
    described: dict[tuple[str, str], dict[str, dict[str, None]]] = {}
    columns: dict[str, list[Session]] = {}
    for session in sorted(analysis.sessions, key=lambda member: (member.device, member.role)):
        column = f"{printable(session.device)} ({printable(session.role)})"
        for section, name, value in _described(session, vendors):
            described.setdefault((section, name), {}).setdefault(column, {}).setdefault(value)
        columns.setdefault(column, []).append(session)
    for column, sessions in columns.items():
        counts = {"sessions": len(sessions), "dropped events": sum(session.dropped_events for session in sessions)}
        for name, count in counts.items():
            described.setdefault((_VARIED, name), {})[column] = {format_count(count): None}
    if not columns:
        return ()
    shown = [*columns][:MOST_COLUMNS]
    sections: dict[str, list[Row]] = {}
    for (section, name), by_column in described.items():
        values = [" or ".join(first_of([*by_column.get(column, {})], _MOST_VALUES)) for column in shown]
        distinct = [tuple(sorted(texts)) for texts in by_column.values()]
        # Middleware, domain and link are what a campaign varies on purpose.
        unlike = section != _VARIED and (len(set(distinct)) > 1 or any(len(texts) > 1 for texts in distinct))
        words = [Span("≠ ", "unlike"), Span(name, "")] if unlike else name
        sections.setdefault(section, []).append(Row([words, *values], part=section))
    ordered = [_VARIED, "Machine", _USED, *_SECTIONS.values()]
    rows = [row for section in ordered for row in sections.get(section, ())]
    quality = "; ".join(dict.fromkeys(qos_label(member) for member in groups.series))
    how = "Rows marked ≠ differ between devices or between sessions."
    if more := len(columns) - len(shown):
        how += f" {counted(more, 'more column is', 'more columns are')} in the JSON report."
    label, look = "How it was recorded, by device and role", "data recorded keeps-1"
    return (
        Sentence(f"{how} Quality of service: {quality}." if quality else how, "how"),
        Table([*map(Column, ("Setting", *shown))], rows, label=label, look=look, parted=EVERYWHERE),
    )


def _described(session: Session, vendors: VendorLabels) -> Iterator[tuple[str, str, str]]:
    yield _VARIED, "middleware", vendors.of(session.vendor)
    yield _VARIED, "backend", printable(session.backend)
    if session.rmw:
        yield _VARIED, "RMW", printable(session.rmw)
    yield _VARIED, "domain", str(session.domain_id)
    yield _VARIED, "link", printable(session.connectivity)
    yield _VARIED, "end", "clean" if session.state == "closed" else "cut off"
    if (path := applied.payload_path(session)) is not None:
        yield _USED, "payload carried by", _WAYS.get(path, printable(path))
        for control in applied.congestion_controls(session):
            yield _USED, "TCP congestion control", printable(control)
        if (buffer_bytes := applied.udp_receive_buffer_bytes(session)) is not None:
            yield _USED, "UDP receive buffer (bytes)", format_count(buffer_bytes)
    for name, value in session.host.items():
        if name == FLEETING or value is None or value in ({}, []):
            continue
        if isinstance(value, dict):
            for inner, item in value.items():
                yield _SECTIONS.get(name, "Machine"), printable(inner), _text(item)
        else:
            yield "Machine", _NAMES.get(name, printable(name).replace("_", " ")), _text(value)


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return format_count(value) if isinstance(value, int) else printable(value, 200)
