"""What a bridge, other flows or a load cost, and whether settings pay: each setup against itself without."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import polars as pl
from numpy.typing import NDArray

from dds_trace.analyzer.model.detail_frames import HEAD_OF_LINE_SCHEMA, INTERFERENCE_SCHEMA, Overtaking
from dds_trace.analyzer.model.parameters import BRIDGE_MATCH_COLUMNS, MATCH_COLUMNS
from dds_trace.analyzer.model.setting import FLOW, FLOWS, LOAD, WITH, flows_of, parse_setting, write_setting
from dds_trace.analyzer.run_statistics.received import received_interval
from dds_trace.analyzer.statistics.percentiles import PERCENTILES
from dds_trace.analyzer.verdicts.cases import GroupRows, is_too_large, partition_groups
from dds_trace.analyzer.verdicts.judgements import Row

from .compare import CompareOptions, Comparison, compare_groups
from .comparison_rows import with_adjusted_verdicts
from .matching import match_groups

Float64 = NDArray[np.float64]


_MATCH = tuple(name for name in MATCH_COLUMNS if name != "setting")
_SETUP = (*(name for name in _MATCH if name not in ("data_type", "payload_bytes", "rate_hz")), "shared")
_OPTIONS = CompareOptions(metrics=("latency",), statistics=("p50", "p99"), match=_MATCH, paired=True)

_DELIVERY = ("difference", "difference_low", "difference_high", "verdict")
USUAL_TIMES = 2
"""A message is caught after another that stays under way for as many of its usual round trips (p95 by itself)."""

LEAST_CAUGHT = 20
"""Caught messages for a verdict."""


_OF_A_FLOW = ("data", "priority", "when_full")
"""Settings that each flow of a plan may have of its own."""


def _without(setting: str, *keys: str) -> str:
    values = parse_setting(setting)
    return write_setting({key: value for key, value in values.items() if key.removeprefix("relay.") not in keys})


def _with_flows(groups: pl.DataFrame) -> pl.DataFrame:
    settings = groups["setting"].to_list()
    flows = [flows_of(setting) for setting in settings]
    counts = [parse_setting(setting).get(FLOWS, "1") for setting in settings]
    is_planned = [count == str(len(others) + 1) for count, (_, others) in zip(counts, flows, strict=True)]
    return groups.with_columns(
        pl.Series("flow", [flow for flow, _ in flows], pl.String),
        pl.Series("with_flows", ["+".join(others) for _, others in flows], pl.String),
        pl.Series("others", [_without(setting, FLOW, WITH, FLOWS) for setting in settings], pl.String),
        pl.Series("shared", [_without(setting, FLOW, WITH, FLOWS, *_OF_A_FLOW) for setting in settings], pl.String),
        pl.Series("is_planned", is_planned, pl.Boolean),
    ).filter(pl.col("flow") != "", "is_planned")


def _with_loads(groups: pl.DataFrame) -> pl.DataFrame:
    settings = groups["setting"].to_list()
    loads = (parse_setting(setting).get(LOAD) for setting in settings)
    return groups.with_columns(
        pl.lit("").alias("flow"),
        pl.Series("with_flows", [f"{LOAD}={load}" if load else "" for load in loads], pl.String),
        pl.Series("others", [_without(setting, LOAD) for setting in settings], pl.String),
    )


def find_interference(rows: GroupRows, passes: Mapping[int, int] | None = None) -> pl.DataFrame:
    """Compare the latency of each flow with others and by itself, and of all with and without a load, p50 and p99, repeat by repeat.

    Returns:
        `INTERFERENCE_SCHEMA`: the group and the one without, the columns of `COMPARISON_SCHEMA` (times in ns; base without, new with), and the
        change of the received ratio with its interval. Verdicts are adjusted over all rows. Of a load `flow` is empty and `with_flows`
        is `load=KIND`.
    """
    changes = [
        frame
        for groups in (_with_flows(rows.groups), _with_loads(rows.groups))
        for case in partition_groups(groups, (*_MATCH, "others", "flow"))
        for frame in _changes(rows, case, passes)
    ]
    empty = pl.DataFrame(schema=INTERFERENCE_SCHEMA)
    return with_adjusted_verdicts(pl.concat([empty, *changes]), _OPTIONS.confidence)


def _changes(rows: GroupRows, case: pl.DataFrame, passes: Mapping[int, int] | None) -> Iterator[pl.DataFrame]:
    alone = case.filter(pl.col("with_flows") == "")
    if len(alone) != 1 or len(case) == 1 or is_too_large(case):
        return
    base = match_groups(rows.frame(alone), _MATCH)
    for together in case.filter(pl.col("with_flows") != "").partition_by("group", maintain_order=True):
        frame = rows.frame(together)
        comparison = compare_groups(base, match_groups(frame, _MATCH), frame.schema, _OPTIONS, passes)
        names = together.select("group", alone["group"].alias("alone_group"), "flow", "with_flows")
        delivery = comparison.delivery.select(pl.col(_DELIVERY).name.prefix("received_"))
        both = names.join(comparison.rows, how="cross").join(delivery, how="cross")
        yield both.select(pl.col(name).cast(dtype) for name, dtype in INTERFERENCE_SCHEMA.items())


_BRIDGE_OPTIONS = CompareOptions(metrics=("latency",), statistics=tuple(p.name for p in PERCENTILES), paired=True)


def find_bridge_costs(rows: GroupRows, passes: Mapping[int, int] | None = None) -> pl.DataFrame:
    across = (pl.col("domain_mode") == "different").any()
    within = ((pl.col("domain_mode") == "same") & (pl.col("bridge") == "none")).any()
    costs = [
        bridge_cost(rows.frame(case), _BRIDGE_OPTIONS, passes)
        for case in partition_groups(rows.groups, BRIDGE_MATCH_COLUMNS)
        if case.select(across & within).item() and not is_too_large(case)
    ]
    empty = bridge_cost(rows.frame(rows.groups.head(0)), _BRIDGE_OPTIONS)
    return pl.concat([empty, *costs]).sort("bridge", maintain_order=True)


def bridge_cost(
    roundtrips: pl.DataFrame, options: CompareOptions | None = None, passes: Mapping[int, int] | None = None
) -> pl.DataFrame:
    options = options or CompareOptions()
    match = tuple(name for name in options.match if name in BRIDGE_MATCH_COLUMNS)
    within = (pl.col("domain_mode") == "same") & (pl.col("bridge") == "none")
    same = match_groups(roundtrips.filter(within), match)
    different = roundtrips.filter(pl.col("domain_mode") == "different")
    tables = []
    for bridge in [*different["bridge"].unique().sort(), None]:  # None: no rows, but the columns
        through = match_groups(different.filter(pl.col("bridge").eq_missing(pl.lit(bridge, pl.String))), match)
        comparison = compare_groups(same, through, roundtrips.schema, replace(options, match=match), passes)
        tables.append(comparison.rows.select(pl.lit(bridge, pl.String).alias("bridge"), pl.all()))
    return pl.concat(tables)


class Sent(NamedTuple):
    """Messages of one run in the order of T1, ns; T2 of a lost one is infinite."""

    publish_ns: Float64
    receive_ns: Float64


@dataclass(frozen=True, slots=True)
class Caught:
    """The messages of one run that were caught after messages of another flow: overtaken or not, and their round trips in ns."""

    overtook: NDArray[np.bool_]
    rtt_ns: Float64


def caught_after(flow: Sent, ahead: Sent, usual_ns: float) -> Caught:
    """Return what became of the messages that left while the latest message ahead stayed under way for `USUAL_TIMES` of `usual_ns`.

    A lost message ahead has no end, and catches none.
    """
    index = np.searchsorted(ahead.publish_ns, flow.publish_ns, side="right") - 1
    end_ns = np.where(index >= 0, ahead.receive_ns[np.maximum(index, 0)], -np.inf)
    caught = np.isfinite(end_ns) & (end_ns - flow.publish_ns > USUAL_TIMES * usual_ns)
    return Caught(flow.receive_ns[caught] < end_ns[caught], (flow.receive_ns - flow.publish_ns)[caught])


def find_head_of_line(rows: GroupRows, passes: Mapping[int, int] | None = None) -> pl.DataFrame:
    """Judge for each two flows that ran together whether messages of one wait for a message of the other.

    Returns:
        `HEAD_OF_LINE_SCHEMA`: the group and the other flow's, messages caught after a message of `other` (`caught_after`), how
        many returned before it, their share with its interval over runs, and the median of what they took beyond the usual
        (p50 by itself), ns. All flows are of one machine, whose clock they share.
    """
    changes = [
        row
        for case in partition_groups(_with_flows(rows.groups), _SETUP)
        if not is_too_large(case)
        for row in _waits(rows, case, passes or {})
    ]
    return pl.DataFrame(changes, HEAD_OF_LINE_SCHEMA)


def _waits(rows: GroupRows, case: pl.DataFrame, passes: Mapping[int, int]) -> Iterator[dict[str, object]]:
    groups = {
        (row["flow"], frozenset(filter(None, row["with_flows"].split("+")))): row["group"]
        for row in case.iter_rows(named=True)
    }
    sent = {group: _sent_by_pass(rows, case.filter(pl.col("group") == group), passes) for group in groups.values()}
    for (flow, others), group in groups.items():
        usual = _usual_ns(sent.get(groups.get((flow, frozenset()), -1), {}))
        for other in sorted(others):
            other_group = groups.get((other, others - {other} | {flow}))
            if usual is None or other_group is None:
                continue
            common = sent[group].keys() & sent[other_group].keys()
            caught = [
                caught_after(sent[group][number], sent[other_group][number], usual[1]) for number in sorted(common)
            ]
            names = {
                "group": group,
                "other_group": other_group,
                "flow": flow,
                "other": other,
                "with_flows": "+".join(sorted(others)),
            }
            yield {**names, **_judged(caught, usual[0])}


def _sent_by_pass(rows: GroupRows, group: pl.DataFrame, passes: Mapping[int, int]) -> dict[int, Sent]:
    frame = rows.frame(group, ["run_id", "publish_ns", "receive_ns"]).sort("run_id", "publish_ns")
    return {
        passes[int(run_id)]: Sent(
            part["publish_ns"].cast(pl.Float64).to_numpy(),
            part["receive_ns"].cast(pl.Float64).fill_null(np.inf).to_numpy(),
        )
        for (run_id,), part in frame.group_by("run_id", maintain_order=True)
        if int(str(run_id)) in passes
    }


def _usual_ns(alone: Mapping[int, Sent]) -> tuple[float, float] | None:
    times = [sent.receive_ns - sent.publish_ns for sent in alone.values()]
    received = np.concatenate([time[np.isfinite(time)] for time in times]) if times else np.empty(0)
    return (float(np.quantile(received, 0.5)), float(np.quantile(received, 0.95))) if len(received) else None


def _judged(caught: Sequence[Caught], usual_ns: float) -> dict[str, object]:
    share = received_interval([caught_run.overtook for caught_run in caught])
    count = sum(len(caught_run.overtook) for caught_run in caught)
    verdict = Overtaking.UNDECIDED
    if count < LEAST_CAUGHT or share.lower is None or share.upper is None:
        verdict = Overtaking.FEW
    elif share.upper < 1 / 2:
        verdict = Overtaking.WAITS
    elif share.lower > 1 / 2:
        verdict = Overtaking.OVERTAKES
    waits_ns = np.concatenate([caught_run.rtt_ns for caught_run in caught]) - usual_ns if count else np.empty(0)
    waits_ns = waits_ns[np.isfinite(waits_ns)]
    return {
        "runs": len(caught),
        "caught": count,
        "overtook": sum(int(caught_run.overtook.sum()) for caught_run in caught),
        "overtook_ratio": share.value,
        "overtook_ratio_low": share.lower,
        "overtook_ratio_high": share.upper,
        "wait_p50_ns": float(np.median(waits_ns)) if len(waits_ns) else None,
        "verdict": verdict.value,
    }


def speaks_against(changes: Iterable[Row], deliveries: Iterable[Row]) -> tuple[list[Row], list[Row]]:
    """Return the rows with fewer messages received, and the slower rows: by an adjusted verdict, or by their whole interval."""
    fewer = [row for row in deliveries if row["verdict"] == "worse" or (row["difference_high"] or 0.0) < 0]
    return fewer, [row for row in changes if row["verdict"] == "worse" or (row["ratio_low"] or 0.0) > 1]


def pays(comparison: Comparison) -> bool:
    if comparison.barred or len(comparison.only_base) or comparison.delivery["is_dead"].any():
        return False
    rows, delivery = (frame.rows(named=True) for frame in (comparison.rows, comparison.delivery))
    return "better" in {row["verdict"] for row in (*rows, *delivery)} and not any(speaks_against(rows, delivery))


def cost_frames(rows: GroupRows, passes: Mapping[int, int]) -> dict[str, pl.DataFrame]:
    """Return the frames of `Details` that compare a setup with itself without a bridge, other flows or a load."""
    return {
        "bridge_costs": find_bridge_costs(rows, passes),
        "interference": find_interference(rows, passes),
        "head_of_line": find_head_of_line(rows, passes),
    }
