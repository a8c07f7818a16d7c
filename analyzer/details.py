"""`Analysis.details` put together: the frames of all batches, and what only the whole campaign can say."""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

from analyzer.analysis import Details
from analyzer.answers import find_answers
from analyzer.clocks import ping_boots
from analyzer.compare import CompareOptions, bridge_cost
from analyzer.host_samples import host_sample_frame
from analyzer.one_way import fit_devices, segment_table
from analyzer.recommend import recommend_settings
from analyzer.rows import MOST_HELD_ROWS

if TYPE_CHECKING:
    from analyzer.batch import Wanted
    from analyzer.frames import Frames
    from analyzer.load import Campaign
    from analyzer.rows import RoundTripRows

_COSTS = CompareOptions(metrics=("latency",), statistics=("p50", "p99"))
"""A bootstrap takes milliseconds for each statistic of each group; these two are drawn."""


def collect_details(campaign: Campaign, frames: Frames, rows: RoundTripRows, wanted: Wanted) -> Details:
    """The details of a campaign.

    Args:
        campaign: its sessions, runs and traces.
        frames: those of `frames.DETAIL_MAKERS`, of all batches.
        rows: the round trips; what compares groups with each other takes them whole, and is left out of a campaign
            with more than `MOST_HELD_ROWS`.
        wanted: what is asked for.
    """
    boots = ping_boots(list(campaign.sessions.values()), list(campaign.runs.values()))
    few = rows.scan().select(pl.len()).collect().item() <= MOST_HELD_ROWS
    # A job is about one data type; that much of a large campaign is read for it.
    of_job = rows.scan().filter(pl.col("data_type") == wanted.job.data_type) if wanted.job else None
    held = rows.frame() if few else rows.scan().head(0).collect()
    return Details(
        intervals=frames["intervals"],
        one_way=frames["one_way"],
        breakdown=frames["breakdown"],
        responses=frames["responses"],
        freshness=frames["freshness"],
        outages=frames["outages"],
        clock_fits=segment_table(fit_devices(frames["clock_knots"], boots)),
        clock_knots=frames["clock_knots"],
        host_samples=host_sample_frame(campaign.traces),
        bridge_costs=bridge_cost(held, _COSTS),
        answers=find_answers(held),
        deadline_ns=wanted.deadline_ns,
        recommendation=recommend_settings(of_job.collect(), wanted.job)
        if wanted.job and of_job is not None
        else None,
    )
