"""Load of the devices (`details.host_samples`) at the times of each run."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dds_trace.analyzer.analysis import Analysis

    from .run_times import RunTime


def bridge_loads(analysis: Analysis, times: Sequence[RunTime]) -> dict[int, float]:
    """Mean load of the bridges' processes during the runs of each group, percent of one processor, by group."""
    if analysis.details is None:
        return {}
    samples = analysis.details.host_samples.filter(pl.col("bridge_cpu_percent").is_not_null())
    of_session = {key[0]: part for key, part in samples.partition_by("session_id", as_dict=True).items()}
    found: dict[int, list[float]] = {}
    for run in times if of_session else ():
        if run.session is not None and run.session.session_id in of_session:
            part = of_session[run.session.session_id]
            at_ns = part["monotonic_ns"].to_numpy()
            during = (at_ns >= run.origin_ns) & (at_ns <= run.last_ns)
            found.setdefault(run.group, []).extend(part["bridge_cpu_percent"].to_numpy()[during].tolist())
    return {group: round(float(np.mean(loads)), 1) for group, loads in found.items() if loads}
