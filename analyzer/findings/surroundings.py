"""Loads of a machine, links that replay a file, flows that ran together, and messages to several relays."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

import polars as pl

from dds_trace.base.printable import printable
from dds_trace.base.units import SECOND_NS
from dds_trace.tracefile.format.json_fields import number_of, object_of

from ..model.finding import Subject
from ..run_statistics.change import Verdict
from .evidence import Evidence, Observation, note, percent, warning
from .rows import Rows, frame_of, in_recording, in_result

_LEAST_BUSY = {"cpu": 0.5, "memory": 0.3, "network": 0.01, "awake": 0.01, "emulated-pi3": 0.5}
"""Processors that a working load uses at least."""


def _loads(evidence: Evidence) -> pl.DataFrame:
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
        {
            "session_id": session_id,
            "file": names[session_id],
            "late_ns": late_ns[session_id],
            "least_delay_ns": min(delay_ms for _, delay_ms, _ in rows) * 1e6,
            "spans": _spans(rows),
        }
        for session_id, rows in values.items()
        if names.get(session_id)
    )


def _spans(rows: list[tuple[float, float, float]]) -> str:
    columns = zip(("rate", "delay", "loss"), zip(*rows, strict=True), ("Mbit/s", "ms", "%"), strict=True)
    return ", ".join(
        f"{name} {min(values):g} to {max(values):g} {unit}" for name, values, unit in columns if max(values)
    )


LINKS = Rows(Subject.RECORDING, _links, in_recording)


FAN_OUT = Rows(Subject.RESULT, lambda evidence: evidence.details.fan_out, in_result)
HEAD_OF_LINE = Rows(Subject.RESULT, lambda evidence: evidence.details.head_of_line, in_result)

SLOW_MATCH_NS = 2 * SECOND_NS
"""More than the fastest discovery of 20 participants took on a busy machine."""


@warning(
    "interference",
    Subject.RESULT,
    "Read this flow's numbers by itself as its best case. A link or processors of its own, a priority, or a lower rate or size of the other "
    "may help: measure it as another setup.",
)
def disturbed_flows(evidence: Evidence) -> Iterator[Observation]:
    """A flow is slower, or loses more, with others than by itself."""
    return _worse(evidence, pl.col("flow") != "")


@note(
    "slower_under_load",
    Subject.RESULT,
    "Processors of its own (-o cpu_affinity) or real-time priority (-o realtime) may help: measure them as another setup under the same load.",
)
def slowed_results(evidence: Evidence) -> Iterator[Observation]:
    """A result is slower, or loses more, under a load than without."""
    return _worse(evidence, pl.col("flow") == "")


def _worse(evidence: Evidence, which: pl.Expr) -> Iterator[Observation]:
    worse = pl.col("verdict") == Verdict.WORSE.value
    loses = pl.col("received_verdict") == Verdict.WORSE.value
    rows = evidence.details.interference.filter(which, worse | loses)
    for _, changes in rows.group_by("group", maintain_order=True):
        parts = [
            f"{row['statistic']} of the latency {row['ratio']:.3g} times ({row['ratio_low']:.3g} to {row['ratio_high']:.3g}) the usual one"
            for row in changes.filter(worse).iter_rows(named=True)
        ]
        row = changes.row(0, named=True)
        if row["received_verdict"] == Verdict.WORSE.value:
            parts.append(f"{percent(-row['received_difference'], 1)} more of its messages lost")
        ratios = [ratio for ratio in changes["ratio"].to_list() if ratio]
        effect = max([1 - 1 / max(ratios, default=1.0), -(row["received_difference"] or 0.0)])
        words = (
            f"With {printable(row['with_flows'])}, {printable(row['flow']) or 'this result'} has {', '.join(parts)}."
        )
        yield evidence.result(row["group"], words, effect)
