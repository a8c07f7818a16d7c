"""Who recorded, what was read, and what measuring cost."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from dds_trace.analyzer.groups.timeline import run_rows
from dds_trace.analyzer.model.applied import (
    SHARED_MEMORY,
    UNKNOWN,
    congestion_controls,
    payload_path,
    udp_receive_buffer_bytes,
)
from dds_trace.base.printable import printable
from dds_trace.base.units import format_duration

from .groups import VENDORS, format_count, known_first, vendor_labels

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dds_trace.analyzer.analysis import Analysis
    from dds_trace.tracefile.format.descriptions import Session


@dataclass(frozen=True, slots=True)
class RunTime:
    """Start and end of one run, and what came back.

    Attributes:
        group: index of its group; the first one if several relays answered.
        origin_ns: planned send time of its first counted message, on the ping's monotonic clock; 0 of `elapsed_s`.
        last_ns: publish time of its last message, on the same clock.
        session: session of the ping; None if the run names none.
        published: messages sent, times the relays that took part; `received` likewise.
        p50_ns: median of the latency, or of the round trip where no relay stamped; None where nothing came back.
        max_ns: the slowest of it.
    """

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
    """Collect start and end of the runs of `analysis.timeline`, in its order."""
    of_runs = run_rows(analysis.run_times, analysis.scan_roundtrips())
    rows = {row["run_id"]: row for row in of_runs.iter_rows(named=True)}
    sessions = {f"{session.session_id:016x}": session for session in analysis.sessions}
    session_of = {run.run_id: sessions.get(str(run.extra.get("session_id"))) for run in analysis.runs}
    drawn = analysis.timeline.group_by("run_id", maintain_order=True).agg(pl.first("group"))
    return tuple(
        RunTime(
            run_id,
            group,
            row["origin_ns"],
            row["last_ns"],
            session_of.get(run_id),
            row["published"],
            row["received"],
            None if row["p50_ns"] is None else round(row["p50_ns"]),
            row["max_ns"],
        )
        for run_id, group in drawn.iter_rows()
        if (row := rows.get(run_id)) and None not in (row["origin_ns"], row["last_ns"])
    )


def bridge_loads(analysis: Analysis, times: Sequence[RunTime]) -> dict[int, float]:
    """Average the load of the bridges' processes over the runs of each group.

    Returns:
        Group -> load in percent of one processor; groups without samples are missing.
    """
    samples = analysis.details.host_samples.filter(pl.col("bridge_cpu_percent").is_not_null())
    of_session = {key[0]: part for key, part in samples.partition_by("session_id", as_dict=True).items()}
    loads_of_group: dict[int, list[float]] = {}
    for run in times if of_session else ():
        if run.session is not None and run.session.session_id in of_session:
            part = of_session[run.session.session_id]
            at_ns = part["monotonic_ns"].to_numpy()
            during = (at_ns >= run.origin_ns) & (at_ns <= run.last_ns)
            loads_of_group.setdefault(run.group, []).extend(
                part["bridge_cpu_percent"].to_numpy()[during].tolist()
            )
    return {group: round(float(np.mean(loads)), 1) for group, loads in loads_of_group.items() if loads}


MOST_ROWS = 200
"""Most rows of a table. A campaign of 500 cells has 1,000 sessions and files; the JSON report lists them all."""

FLEETING = "wifi"
"""Part of a fingerprint that differs between any two sessions; the figure of the load shows it over time."""


@dataclass(frozen=True, slots=True)
class RecordTable:
    """Table of strings that are `printable` but not escaped for a format.

    Attributes:
        count: number of sessions or files, including those left out.
        left_out: number of rows beyond `MOST_ROWS`.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    count: int
    left_out: int


def record_tables(analysis: Analysis) -> tuple[RecordTable, ...]:
    """Tabulate the sessions with their environment, and the files."""
    return tuple(table for table in (_sessions(analysis), _sources(analysis)) if table.rows)


def _sessions(analysis: Analysis) -> RecordTable:
    """Tabulate the sessions; those that were alike share a row, because a sweep starts one process per cell."""
    alike: dict[tuple[str, ...], list[Session]] = {}
    vendors = vendor_labels(analysis)
    for one in analysis.sessions:
        surroundings = [
            f"{printable(name)} {printable(value)}" for name, value in one.host.items() if name != FLEETING
        ]
        key = (
            printable(one.device),
            printable(one.role),
            vendors.of(one.vendor),
            printable(one.backend),
            printable(one.rmw or "-"),
            str(one.domain_id),
            printable(one.connectivity),
            "clean" if one.state == "closed" else "cut off",
            ", ".join([*surroundings, *applied_words(one)]),
        )
        alike.setdefault(key, []).append(one)
    rows = [
        (*key[:-2], format_count(len(held)), format_count(sum(one.dropped_events for one in held)), *key[-2:])
        for key, held in alike.items()
    ]
    columns = (
        "Device",
        "Role",
        "Vendor",
        "Backend",
        "RMW",
        "Domain",
        "Link",
        "Sessions",
        "Dropped events",
        "End",
        "Host",
    )
    return _table("Recording sessions", columns, rows, len(analysis.sessions))


def applied_words(session: Session) -> list[str]:
    """Describe what the process was seen to use; nothing of an older session, which does not tell."""
    path = payload_path(session)
    if path is None:
        return []
    buffer_bytes = udp_receive_buffer_bytes(session)
    buffers = (
        [] if buffer_bytes is None else [f"UDP receive buffer as granted {format_count(buffer_bytes)} B"]
    )
    controls = [f"TCP by {printable(name)}" for name in congestion_controls(session)]
    return [f"payload carried by {_WAYS.get(path, printable(path))}", *controls, *buffers]


_LONGEST_SETTING = 40
"""Characters of a setting among the facts of the first screen."""

_WAYS = {SHARED_MEMORY: "shared memory", UNKNOWN: "an unknown way"}
"""Path of a payload -> its words; any other is the name of an interface."""


def _sources(analysis: Analysis) -> RecordTable:
    """Tabulate the files, those with a problem first."""
    ordered = sorted(analysis.sources, key=lambda one: one.status == "read")
    rows: list[tuple[str, ...]] = [
        (printable(one.path), printable(one.status), format_count(one.events), printable(one.detail))
        for one in ordered
    ]
    return _table("Files", ("File", "Status", "Events", "Detail"), rows, len(rows))


def _table(title: str, columns: tuple[str, ...], rows: list[tuple[str, ...]], count: int) -> RecordTable:
    return RecordTable(title, columns, tuple(rows[:MOST_ROWS]), count, max(0, len(rows) - MOST_ROWS))


@dataclass(frozen=True, slots=True)
class OwnCost:
    """Cost of measuring with one vendor and backend: the slowest of its sessions, None if no session measured it.

    Attributes:
        record_median_ns: median time to record one event; `record_p99_ns` likewise.
        floor_median_ns: median time of a short message from a node to itself, the floor of every latency through this
            client library; `floor_p99_ns` likewise.
        floor_messages: smallest number of messages behind a floor.
    """

    vendor: str
    backend: str
    record_median_ns: int | None
    record_p99_ns: int | None
    floor_median_ns: int | None
    floor_p99_ns: int | None
    floor_messages: int | None


def own_costs(analysis: Analysis) -> tuple[OwnCost, ...]:
    """Collect the costs of each vendor and backend whose sessions measured them."""
    together: dict[tuple[str, str], list[Session]] = {}
    for session in analysis.sessions:
        together.setdefault((session.vendor, session.backend), []).append(session)
    order = known_first({vendor for vendor, _ in together}, VENDORS)
    costs = []
    for vendor, backend in sorted(together, key=lambda pair: (order.index(pair[0]), pair[1])):
        sessions = together[vendor, backend]
        cost = OwnCost(
            vendor,
            backend,
            max(_numbers(sessions, "recorder_cost", "record_median_ns"), default=None),
            max(_numbers(sessions, "recorder_cost", "record_p99_ns"), default=None),
            max(_numbers(sessions, "client_library_floor", "median_ns"), default=None),
            max(_numbers(sessions, "client_library_floor", "p99_ns"), default=None),
            min(_numbers(sessions, "client_library_floor", "messages"), default=None),
        )
        if cost.record_median_ns is not None or cost.floor_median_ns is not None:
            costs.append(cost)
    return tuple(costs)


def cost_words(costs: Sequence[OwnCost]) -> str:
    """Describe in one line what measuring cost with the slowest middleware: `recording an event 2.1 µs (p99 4 µs)`."""
    parts = (
        ("recording an event", "record_median_ns", "record_p99_ns"),
        ("a message from a node to itself", "floor_median_ns", "floor_p99_ns"),
    )
    said = []
    for what, median, p99 in parts:
        slowest = max(
            (cost for cost in costs if getattr(cost, median) is not None),
            key=lambda cost: getattr(cost, median),
            default=None,
        )
        if slowest is not None:
            tail = getattr(slowest, p99)
            within = "" if tail is None else f" (p99 {format_duration(tail)})"
            said.append(f"{what} {format_duration(getattr(slowest, median))}{within}")
    return f"{'; '.join(said)}; not subtracted" if said else ""


def setting_words(analysis: Analysis) -> str:
    """Describe what the middlewares were told, from the sessions: `executor events; transport default; tuned false`."""
    told: dict[str, list[str]] = {}
    for session in analysis.sessions:
        middleware = session.host.get("middleware")
        for name, value in middleware.items() if isinstance(middleware, dict) else ():
            # A configuration in XML would be most of a first screen; whole it stands in the table of the sessions.
            words = printable(value, _LONGEST_SETTING)
            if words not in told.setdefault(printable(name), []):
                told[printable(name)].append(words)
        path = payload_path(session)
        if path is not None:
            ways = told.setdefault("payload carried by", [])
            words = _WAYS.get(path, printable(path))
            ways += [words] if words not in ways else []
    return "; ".join(f"{name} {' or '.join(values)}" for name, values in told.items())


def version_words(analysis: Analysis) -> str:
    """List the versions of all sessions: `rclpy 7.1.6, fastrtps 2.14.5 or 2.14.6`."""
    told: dict[str, list[str]] = {}
    for session in analysis.sessions:
        versions = session.host.get("versions")
        for name, value in versions.items() if isinstance(versions, dict) else ():
            if printable(value) not in told.setdefault(printable(name), []):
                told[printable(name)].append(printable(value))
    return ", ".join(f"{name} {' or '.join(values)}" for name, values in told.items())


def _numbers(sessions: Sequence[Session], part: str, name: str) -> list[int]:
    """Collect the finite, non-negative values of one field of the sessions; foreign traces may hold anything there."""
    parts = [held for session in sessions if isinstance(held := session.extra.get(part), dict)]
    values = [held.get(name) for held in parts]
    return [
        round(value)
        for value in values
        if isinstance(value, (int, float))
        and not isinstance(value, bool)
        and math.isfinite(value)
        and value >= 0
    ]
