"""`Analysis.details`: the frames of all batches, and what takes the whole campaign."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from dds_trace.base.extension import load

from .analysis import Details
from .clocks.boots import ping_boots, ping_wall_offsets
from .groups.batch import DEADLINE_METRIC, AnalysisOptions, Batch, Grouping
from .groups.frames import DETAIL_MAKERS, Frames
from .groups.host_samples import host_sample_frame
from .groups.intervals import INTERVAL_SCHEMA, ONE_WAY_SCHEMA, measure_whole, one_way_rows, rows_of_groups
from .loading.campaign import Campaign
from .model.detail_frames import COST_FRAMES, FAN_OUT_FRAMES, RECOVERY_SCHEMA, WIRE_FRAMES
from .model.runs import pass_numbers
from .model.setting import FLOW, LOAD, parse_setting
from .pairing.one_way import fit_devices, segment_table
from .pairing.roundtrips import pair_exchanges
from .pairing.rows import RowStore
from .verdicts.answers import find_answers
from .verdicts.cases import GroupRows

_BATCH_FRAMES = ("intervals", "one_way", "breakdown", "responses", "freshness", "outages", "clock_knots")
"""Frames of batches that are details; others are for findings."""


def collect_details(
    campaign: Campaign,
    grouping: Grouping,
    frames: Frames,
    rows: RowStore,
    in_parts: Sequence[int],
    options: AnalysisOptions,
    judged: GroupRows,
) -> Details:
    """Make the details of a campaign, empty if not requested; `judged` are the messages by which groups are compared."""
    host_samples = host_sample_frame(campaign.traces)
    if not options.details:
        return replace(details_not_requested(), host_samples=host_samples)
    passes = pass_numbers(campaign.runs.values())
    boots = ping_boots(campaign.sessions.values(), campaign.runs.values())
    groups = ((group, _column_of(rows, group), _run_of_row(rows, group)) for group in in_parts)
    intervals = list(rows_of_groups(groups))
    one_way = [row for group in in_parts for row in one_way_rows(group, _column_of(rows, group))]
    frames = {
        **frames,
        "intervals": _by_group(frames["intervals"], pl.DataFrame(intervals, INTERVAL_SCHEMA)),
        "one_way": _by_group(frames["one_way"], pl.DataFrame(one_way, ONE_WAY_SCHEMA)),
    }
    recoveries = pl.DataFrame(schema=RECOVERY_SCHEMA)
    if any("outage" in sample for trace in campaign.traces for sample in trace.host_samples):
        recoveries = load("details", "recoveries")(campaign.traces, grouping, rows)
    # When an outage began, and when the first reply after it came; None where none came.
    outages = recoveries.select("run_id", "began_ns", pl.col("ended_ns") + pl.col("back_ns")).iter_rows()
    recommendation = None
    if options.job is not None:
        messages = judged.frame(judged.groups.filter(data_type=options.job.data_type))
        estimate = load("parts", "estimator")(messages, options.job)
        recommendation = load("parts", "recommend")(
            messages, options.job, runs=campaign.runs.values(), estimate=estimate
        )
    with ThreadPoolExecutor(1, thread_name_prefix="clocks") as pool:
        clock_fits = pool.submit(lambda: segment_table(fit_devices(frames["clock_knots"], boots)))
        answers = find_answers(
            judged,
            passes=passes,
            wall_offsets_ns=ping_wall_offsets(campaign.sessions.values(), campaign.runs.values()),
            outages_ns={run_id: (began_ns, ended_ns) for run_id, began_ns, ended_ns in outages},
            options=options.ranking,
        )
    was_captured = any(run.extra.get("wire") for run in campaign.runs.values())
    more = _empty_frames(FAN_OUT_FRAMES, COST_FRAMES, WIRE_FRAMES)
    if _has_costs(judged.groups):
        more |= load("details", "costs")(judged, passes)
    if rows.has_rows and _is_crowded(grouping):
        more |= load("details", "fan_out")(grouping, rows, host_samples)
    if was_captured:
        more |= load("details", "wire")(campaign.traces, campaign.runs, grouping, rows)
    return Details(
        **{name: frames[name] for name in _BATCH_FRAMES},
        clock_fits=clock_fits.result(),
        host_samples=host_samples,
        recoveries=recoveries,
        **more,
        answers=answers,
        deadline_ns=options.deadline_ns,
        deadline_metric=options.deadline_metric,
        recommendation=recommendation,
        requested=True,
    )


@cache
def details_not_requested() -> Details:
    no_batch = Batch((), np.empty(0, np.uint32), all_exchanges=0, whole=True)
    no_roundtrips = pair_exchanges([], {}, details=False)
    frames = {name: make(no_batch, no_roundtrips) for name, make in DETAIL_MAKERS.items()}
    _, frames["intervals"], frames["one_way"] = measure_whole(no_batch, no_roundtrips)
    return Details(
        **{name: frames[name] for name in _BATCH_FRAMES},
        clock_fits=segment_table(()),
        host_samples=host_sample_frame(()),
        recoveries=pl.DataFrame(schema=RECOVERY_SCHEMA),
        **_empty_frames(FAN_OUT_FRAMES, COST_FRAMES, WIRE_FRAMES),
        answers=(),
        deadline_ns=None,
        deadline_metric=DEADLINE_METRIC,
        recommendation=None,
        requested=False,
    )


def _has_costs(groups: pl.DataFrame) -> bool:
    """Return whether a setup can be compared with itself: across domains, with other flows, or under a load."""
    return groups["domain_mode"].n_unique() > 1 or any(
        {FLOW, LOAD} & parse_setting(setting).keys() for setting in groups["setting"].unique().to_list()
    )


def _is_crowded(grouping: Grouping) -> bool:
    """Return whether a run had several relays or pings, or was one of several topics."""
    settings = map(parse_setting, grouping.parameters["setting"].unique().to_list())
    return any(exchange.relays > 1 for exchange in grouping.exchanges) or any(
        {"pings", "topics"} & s.keys() for s in settings
    )


def _empty_frames(*tables: Mapping[str, Any]) -> Frames:
    return {name: pl.DataFrame(schema=schema) for table in tables for name, schema in table.items()}


def _column_of(rows: RowStore, group: int) -> Callable[[str], pl.Series]:
    return lambda name: rows.frame(rows.groups[group], [name]).to_series()


def _run_of_row(rows: RowStore, group: int) -> NDArray[np.int64]:
    run_ids = rows.frame(rows.groups[group], ["run_id"])["run_id"].to_numpy()
    return np.cumsum(np.diff(run_ids, prepend=run_ids[:1]) != 0)


def _by_group(*frames: pl.DataFrame) -> pl.DataFrame:
    return pl.concat(frames).sort("group", maintain_order=True)
