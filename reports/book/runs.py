"""Start and end of each run, what came back of it, and the load of the bridges in between."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from dds_trace.analyzer.groups.run_rows import run_rows

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dds_trace.analyzer.analysis import Analysis
    from dds_trace.tracefile import Session


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
