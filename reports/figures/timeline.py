"""Latency over time, with the messages that never came back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars as pl
from numpy.typing import NDArray

from ..book.book import Book
from .figure import FigureMaker, Plan, Scope

Float64 = NDArray[np.float64]


POINTS_IN_PAGE = 40_000
"""Most messages in a page (about 1 MB of JSON)."""
FEWEST_POINTS = 80
MOST_OUTAGES = 50


@dataclass(frozen=True, slots=True)
class GroupTimeline:
    """Messages of one group by planned send time; `lost_count` is the number of lost messages of each cross."""

    group: int
    elapsed_s: tuple[float, ...]
    latency_ns: tuple[int | None, ...]
    rtt_ns: tuple[int | None, ...]
    lost_elapsed_s: tuple[float, ...]
    lost_count: tuple[int, ...]


def timeline_plan(book: Book) -> Plan | None:
    frame = book.analysis.timeline.sort("group", "elapsed_s", "run_id", "relay_id", "sequence")
    share = max(FEWEST_POINTS, POINTS_IN_PAGE // max(1, book.analysis.summary.height))
    is_back = pl.col("outcome") == "completed"
    back, lost = frame.filter(is_back), frame.filter(~is_back).partition_by("group", as_dict=True)
    thinned = _thinned(back, share)
    drawn = thinned.partition_by("group", as_dict=True)
    groups = {}
    for (group,) in frame.select("group").unique(maintain_order=True).iter_rows():
        rows = drawn.get((group,), frame.clear())
        lost_at, lost_count = _crosses(lost.get((group,), frame.clear())["elapsed_s"].to_numpy(), share)
        groups[group] = GroupTimeline(
            group,
            tuple(round(value, 4) for value in rows["elapsed_s"].to_list()),
            tuple(rows["latency_ns"].to_list()),
            tuple(rows["rtt_ns"].to_list()),
            lost_at,
            lost_count,
        )
    decimated = book.analysis.timeline_decimated or thinned.height < back.height
    return {"groups": groups, "decimated": decimated, "outages": _outages(book)} if groups else None


FIGURE = FigureMaker(
    name="timeline",
    title="Latency over time",
    how_to_read=(
        "Each dot is a received message; crosses on the line at the top are lost messages at the time they were due, so a row of crosses is "
        "an outage, and outages are shaded."
    ),
    nothing="no message was published.",
    kind="timeline",
    make=timeline_plan,
    scope=Scope.CELL,
)


def _outages(book: Book) -> dict[int, tuple[tuple[float, float], ...]]:
    if not book.analysis.details.outages.height:
        return {}
    origin_ns = {run.run_id: run.origin_ns for run in book.run_times}
    longest = book.analysis.details.outages.sort("duration_ns", descending=True, nulls_last=True)
    spans: dict[int, list[tuple[float, float]]] = {}
    columns = ("group", "run_id", "start_ns", "end_ns")
    for group, run_id, start_ns, end_ns in longest.select(columns).iter_rows():
        group_spans = spans.setdefault(group, [])
        # An outage without an end lasted to the end of its run.
        if run_id in origin_ns and end_ns is not None and len(group_spans) < MOST_OUTAGES:
            start, end = ((ns - origin_ns[run_id]) / 1e9 for ns in (start_ns, end_ns))
            group_spans.append((round(start, 4), round(end, 4)))
    return {group: tuple(sorted(outages)) for group, outages in spans.items() if outages}


def _slices(
    elapsed_s: Float64, start_s: Float64 | np.float64, end_s: Float64 | np.float64, count: int
) -> NDArray[np.int64]:
    duration_s = np.where(end_s > start_s, end_s - start_s, 1.0)  # all at one instant are in the first slice
    index: NDArray[np.int64] = np.minimum((elapsed_s - start_s) / duration_s * count, count - 1).astype(np.int64)
    return index


def _thinned(rows: pl.DataFrame, share: int) -> pl.DataFrame:
    """Keep about `share` rows of each group: the least and the greatest value of each slice of its time."""
    at = pl.col("elapsed_s")
    times = rows.select(at, start=at.min().over("group"), end=at.max().over("group"))
    elapsed_s, start_s, end_s = (column.to_numpy() for column in times)
    ranked = rows.with_row_index("row").with_columns(
        pl.Series("slice", _slices(elapsed_s, start_s, end_s, share // 2)),
        value=pl.coalesce("latency_ns", "rtt_ns"),
        is_many=pl.len().over("group") > share,
    )
    by_value = ranked.filter("is_many").sort("value", "row")
    extremes = [by_value.unique(["group", "slice"], keep=end, maintain_order=True)["row"] for end in ("first", "last")]
    return rows.filter(~ranked["is_many"] | ranked["row"].is_in(pl.concat(extremes).implode()))


def _crosses(lost_s: Float64, share: int) -> tuple[tuple[float, ...], tuple[int, ...]]:
    if len(lost_s) <= share:
        return tuple(round(float(at), 4) for at in lost_s), (1,) * len(lost_s)
    _, first, count = np.unique(
        _slices(lost_s, lost_s.min(), lost_s.max(), share), return_index=True, return_counts=True
    )
    return tuple(round(float(at), 4) for at in lost_s[first]), tuple(int(n) for n in count)
