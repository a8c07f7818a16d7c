"""`Analysis.details` put together: the frames of all batches, and what only the whole campaign can say."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import polars as pl

from .analysis import Details
from .clocks.boots import ping_boots
from .findings.left_out import is_too_large
from .groups.host_samples import host_sample_frame
from .groups.interval_frames import (
    INTERVAL_SCHEMA,
    ONE_WAY_SCHEMA,
    interval_rows,
    one_way_rows,
)
from .model.parameters import BRIDGE_MATCH_COLUMNS, CASE_COLUMNS, CONTENDER_COLUMNS
from .pairing.one_way import fit_devices, segment_table
from .pairing.rows import partition_groups
from .verdicts.answers import (
    ANSWER_COLUMNS,
    answer_case,
    contender_names,
    without_floor,
)
from .verdicts.compare import QUANTILES, CompareOptions, bridge_cost
from .verdicts.recommend import recommend_settings

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from .groups.batch import Wanted
    from .groups.frames import Frames
    from .loading.campaign import Campaign
    from .pairing.rows import RowsByGroup
    from .verdicts.answers import Answer

_COSTS = CompareOptions(metrics=("latency",), statistics=tuple(QUANTILES))


def collect_details(
    campaign: Campaign, frames: Frames, rows: RowsByGroup, in_parts: Sequence[int], wanted: Wanted
) -> Details:
    """The details of a campaign.

    Args:
        campaign: its sessions, runs and traces.
        frames: those of `frames.DETAIL_MAKERS`, of all batches.
        rows: the round trips; what compares groups with each other reads those of a few groups at a time.
        in_parts: groups that no batch held whole: what a column of their rows says is added here.
        wanted: what is asked for.
    """
    boots = ping_boots(campaign.sessions.values(), campaign.runs.values())
    # A job is about one data type; that much of a large campaign is read for it.
    of_job = rows.rows.scan().filter(pl.col("data_type") == wanted.job.data_type) if wanted.job else None
    intervals = pl.DataFrame(
        [row for group in in_parts for row in interval_rows(group, _column_of(rows, group))], INTERVAL_SCHEMA
    )
    one_way = pl.DataFrame(
        [row for group in in_parts for row in one_way_rows(group, _column_of(rows, group))], ONE_WAY_SCHEMA
    )
    return Details(
        intervals=_by_group(frames["intervals"], intervals),
        one_way=_by_group(frames["one_way"], one_way),
        breakdown=frames["breakdown"],
        responses=frames["responses"],
        freshness=frames["freshness"],
        outages=frames["outages"],
        clock_fits=segment_table(fit_devices(frames["clock_knots"], boots)),
        clock_knots=frames["clock_knots"],
        host_samples=host_sample_frame(campaign.traces),
        bridge_costs=_bridge_costs(rows),
        answers=_answers(rows),
        deadline_ns=wanted.deadline_ns,
        recommendation=recommend_settings(of_job.collect(), wanted.job)
        if wanted.job and of_job is not None
        else None,
    )


def _column_of(rows: RowsByGroup, group: int) -> Callable[[str], pl.Series]:
    return lambda name: rows.column(group, name)


def _by_group(*frames: pl.DataFrame) -> pl.DataFrame:
    return pl.concat(frames).sort("group", maintain_order=True)


def _answers(rows: RowsByGroup) -> tuple[Answer, ...]:
    """`answers.find_answers` of the whole campaign, one kind of message after the other."""
    if not rows.has_rows:
        return ()
    contending = without_floor(rows.groups)
    names = contender_names(contending)

    def parts(case: pl.DataFrame) -> Iterator[tuple[dict[str, Any], pl.DataFrame]]:
        for groups in partition_groups(case, CONTENDER_COLUMNS):
            setting = groups.select(CONTENDER_COLUMNS).row(0, named=True)
            yield setting, rows.frame(groups, ANSWER_COLUMNS).sort("run_id", "relay_id", "publish_ns")

    return tuple(
        answer_case(case.select(CASE_COLUMNS).row(0, named=True), parts(case), names)
        for case in partition_groups(contending, CASE_COLUMNS)
        if not is_too_large(case)
    )


def _bridge_costs(rows: RowsByGroup) -> pl.DataFrame:
    """`compare.bridge_cost` of the whole campaign, one kind of message after the other."""
    across = (pl.col("domain_mode") == "different").any()
    within = ((pl.col("domain_mode") == "same") & (pl.col("bridge") == "none")).any()
    costs = [
        bridge_cost(rows.frame(case), _COSTS)
        for case in partition_groups(rows.groups, BRIDGE_MATCH_COLUMNS)
        if case.select(across & within).item() and not is_too_large(case)
    ]
    none = bridge_cost(rows.frame(rows.groups.head(0)), _COSTS)
    return pl.concat([none, *costs]).sort("bridge", maintain_order=True)
