"""Loads of a machine, and links that replay a file."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

from dds_trace.base.printable import printable
from dds_trace.tracefile.format.json_fields import number_of, object_of

from ..model.finding import Subject
from .evidence import Evidence
from .rows import Rows, frame_of, in_recording

if TYPE_CHECKING:
    import polars as pl

_LEAST_BUSY = {"cpu": 0.5, "memory": 0.3, "network": 0.01, "awake": 0.01}
"""Processors that a working load uses at least."""


def _loads(evidence: Evidence) -> pl.DataFrame:
    """Sessions that made a load; a second one of the same machine only waits."""
    rows = []
    for session in evidence.campaign.sessions.values():
        load = object_of(session.extra.get("load"))
        cpu_s, elapsed_s = number_of(load.get("cpu_s")), number_of(load.get("elapsed_s"))
        waited_s = number_of(load.get("waited_s")) or 0.0
        if cpu_s is not None and elapsed_s and load.get("program") and waited_s < elapsed_s / 2:
            kind, busy = printable(str(load.get("kind"))), cpu_s / elapsed_s
            rows.append(
                {
                    "session_id": session.session_id,
                    "kind": kind,
                    "program": "our own program" if load["program"] == "own" else printable(str(load["program"])),
                    "busy": float(busy),
                    "works": busy >= _LEAST_BUSY.get(kind, 0.0),
                }
            )
    return frame_of(rows)


LOADS = Rows(Subject.RECORDING, _loads, in_recording)


LATE_SHARE = 0.01
"""Median lateness, as a share of the least delay, up to which delays are as the file says."""


def _links(evidence: Evidence) -> pl.DataFrame:
    """Links that replayed a file; `late_ns` is the median lateness of the worst run."""
    names: dict[int, str] = {}
    late_ns: dict[int, float] = defaultdict(float)
    values: dict[int, list[tuple[float, float, float]]] = defaultdict(list)
    for trace in evidence.campaign.traces:
        for sample in trace.host_samples if trace.sessions else ():
            session_id = trace.sessions[-1].session_id
            now, link = object_of(sample.get("link_now")), object_of(sample.get("link"))
            numbers = [number_of(now.get(name)) for name in ("rate_mbit_s", "delay_ms", "loss_percent")]
            rate, delay, loss = (-1.0 if number is None else number for number in numbers)
            if min(rate, delay, loss) >= 0:
                values[session_id].append((rate, delay, loss))
            if "file" in link:
                names[session_id] = printable(str(link["file"]))
                ways = object_of(sample.get("forwarder")).values()
                late_us = [number_of(object_of(way).get("lateness_p50_us")) or 0.0 for way in ways]
                late_ns[session_id] = max([late_ns[session_id], *(late * 1e3 for late in late_us)])
    return frame_of(
        [
            {
                "session_id": session_id,
                "file": names[session_id],
                "late_ns": late_ns[session_id],
                "least_delay_ns": min(delay_ms for _, delay_ms, _ in rows) * 1e6,
                "spans": _spans(rows),
            }
            for session_id, rows in values.items()
            if names.get(session_id)
        ]
    )


def _spans(rows: list[tuple[float, float, float]]) -> str:
    columns = zip(("rate", "delay", "loss"), zip(*rows, strict=True), ("Mbit/s", "ms", "%"), strict=True)
    return ", ".join(
        f"{name} {min(values):g} to {max(values):g} {unit}" for name, values, unit in columns if max(values)
    )


LINKS = Rows(Subject.RECORDING, _links, in_recording)
