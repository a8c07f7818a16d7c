"""The frame `recoveries`: how a run came back from an outage that a sweep made within it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TypedDict

import polars as pl

from dds_trace.analyzer.groups.batch import Grouping
from dds_trace.analyzer.model.detail_frames import RECOVERY_SCHEMA
from dds_trace.analyzer.pairing.rows import RowStore
from dds_trace.base.limits import STORED_TIME_NS
from dds_trace.tracefile.format.json_fields import number_of, object_of
from dds_trace.tracefile.reading.trace import Trace

_COLUMNS = ("run_id", "sequence", "publish_ns", "relay_in_ns", "receive_ns", "reordered", "duplicates")


class OutageTimes(TypedDict):
    """One outage, on the monotonic clock of the machine of both sides, ns; `limit_ns`: how long the run waited after it."""

    by: str
    began_ns: int
    ended_ns: int
    limit_ns: int


def read_outages(traces: Iterable[Trace]) -> dict[int, OutageTimes]:
    outages: dict[int, OutageTimes] = {}
    for trace in traces:
        for sample in trace.host_samples:
            outage = object_of(sample.get("outage"))
            began_ns, ended_ns, limit_s = (number_of(outage.get(name)) for name in ("began_ns", "ended_ns", "limit_s"))
            try:
                run_id = int(str(outage.get("run_id")), 16)
            except ValueError:
                continue
            if None in (began_ns, ended_ns, limit_s):
                continue
            times = int(began_ns or 0), int(ended_ns or 0), round((limit_s or 0) * 1e9)
            if all(STORED_TIME_NS.fault(time_ns) is None for time_ns in times):
                by = str(outage.get("by"))
                outages[run_id] = OutageTimes(by=by, began_ns=times[0], ended_ns=times[1], limit_ns=times[2])
    return outages


def recovery_frame(traces: Iterable[Trace], grouping: Grouping, rows: RowStore) -> pl.DataFrame:
    """Return a row for each run with an outage (docs/how-to/axes.md); times in ns from its end on."""
    outages = read_outages(traces)
    group_of_run = dict(
        zip((exchange.run.run_id for exchange in grouping.exchanges), grouping.group_of_exchange.tolist(), strict=True)
    )
    recoveries = []
    for run_id, outage in outages.items():
        group = group_of_run.get(run_id)
        if group is None or not rows.has_rows:
            continue
        messages = rows.frame(rows.groups.filter(group=group), _COLUMNS).filter(run_id=run_id)
        recoveries.append({"group": group, "run_id": run_id, **outage, **recovery_of(messages, outage)})
    return pl.DataFrame(recoveries, RECOVERY_SCHEMA).sort("group", "began_ns")


def recovery_of(rows: pl.DataFrame, outage: OutageTimes) -> Mapping[str, object]:
    """Return how one run came back, from its round trips; a message that several relays had counts once."""
    began_ns, ended_ns = outage["began_ns"], outage["ended_ns"]
    messages = rows.group_by("sequence").agg(
        pl.col("publish_ns", "relay_in_ns", "receive_ns").min(), pl.col("reordered").any(), pl.col("duplicates").sum()
    )
    back_ns = _first_after(rows["receive_ns"], outage)
    is_lost = pl.col("receive_ns").is_null()
    within = messages.filter(pl.col("publish_ns").is_between(began_ns, ended_ns, closed="left"))
    later = messages.filter(pl.col("publish_ns") >= ended_ns)
    arrived = messages.filter(pl.col("receive_ns") > ended_ns)
    return {
        "outage_ns": ended_ns - began_ns,
        "never": back_ns is None or back_ns > outage["limit_ns"],
        "out_ns": _first_after(rows["relay_in_ns"], outage),
        "back_ns": back_ns,
        "lost_within": within.filter(is_lost).height,
        "replayed": within.filter(pl.col("receive_ns") > ended_ns).height,
        "lost_after": later.filter(is_lost).height,
        "reordered": arrived["reordered"].sum(),
        "duplicates": arrived["duplicates"].sum(),
    }


_COMMAND_NS = 100_000_000
"""How long the command that ends an outage may take after the link is up."""


def _first_after(times_ns: pl.Series, outage: OutageTimes) -> int | None:
    """Return when the first message came, from the stated end on; 0 where the link was up a little before it."""
    ended_ns = outage["ended_ns"]
    up_ns = max(ended_ns - _COMMAND_NS, (outage["began_ns"] + ended_ns) // 2)
    first_ns = times_ns.filter(times_ns > up_ns).min()
    return max(int(first_ns) - ended_ns, 0) if isinstance(first_ns, int) else None
