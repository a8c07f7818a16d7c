"""The frames about fan-out: when each relay got the same message, what it cost, and how long all took to meet."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from statistics import median

import numpy as np
import polars as pl

from dds_trace.analyzer.clocks.boots import machine_of
from dds_trace.analyzer.groups.batch import Grouping
from dds_trace.analyzer.groups.host_samples import node_percent
from dds_trace.analyzer.model.detail_frames import FAN_OUT_FRAMES, FAN_OUT_TIMES
from dds_trace.analyzer.pairing.exchanges import Exchange
from dds_trace.analyzer.pairing.rows import RowStore
from dds_trace.analyzer.statistics.percentiles import summarize_values
from dds_trace.tracefile.format.json_fields import number_of, object_of, objects_of

_COLUMNS = ("run_id", "relay_id", "sequence", "publish_ns", "receive_ns", "outbound_ns", "clock_bound_ns")
_MESSAGE = ("run_id", "sequence")


def fan_out_frames(grouping: Grouping, rows: RowStore, host_samples: pl.DataFrame) -> dict[str, pl.DataFrame]:
    rows_of: dict[str, list[dict[str, object]]] = {"fan_out": [], "fan_out_positions": []}
    exchanges: dict[int, list[Exchange]] = defaultdict(list)
    groups: dict[int, set[int]] = defaultdict(set)
    for exchange, group in zip(grouping.exchanges, grouping.group_of_exchange.tolist(), strict=True):
        exchanges[exchange.run.run_id].append(exchange)
        groups[exchange.run.run_id].add(group)
    runs: dict[tuple[int, ...], list[list[Exchange]]] = defaultdict(list)
    for run_id, members in exchanges.items():
        runs[tuple(sorted(groups[run_id]))].append(members)
    for together, crowded in sorted(runs.items()):
        frame = rows.frame(rows.groups.filter(pl.col("group").is_in(together)), _COLUMNS)
        own_rows = frame.filter(pl.col("run_id").is_in([exchange_runs[0].run.run_id for exchange_runs in crowded]))
        several = max(map(len, crowded)) > 1
        if several and own_rows.select(_MESSAGE).is_unique().all():  # a relay that was restarted
            continue
        relays = _by_relay(together[0], crowded, own_rows) if several else []
        rows_of["fan_out"].append(
            {
                "group": together[0],
                "groups": " ".join(map(str, together)),
                **_times(own_rows, relays),
                **_costs(crowded, host_samples, _joined_late(own_rows)),
            }
        )
        rows_of["fan_out_positions"] += relays
    return {name: pl.DataFrame(rows_of[name], schema) for name, schema in FAN_OUT_FRAMES.items()}


def _joined_late(rows: pl.DataFrame) -> dict[int, int]:
    first = rows.group_by("run_id", "relay_id").agg(pl.col("sequence").min())
    late = first.filter(pl.col("sequence") > pl.col("sequence").min().over("run_id"))
    return dict(late.group_by("run_id").len().iter_rows())


def _complete(rows: pl.DataFrame) -> pl.DataFrame:
    return rows.filter(pl.col("outbound_ns").is_not_null().all().over(_MESSAGE))


def _by_relay(group: int, runs: Sequence[Sequence[Exchange]], rows: pl.DataFrame) -> list[dict[str, object]]:
    devices = {exchange.relay_id: exchange.relay.device for run in runs for exchange in run if exchange.relay}
    out = pl.col("outbound_ns")
    after_first, before_last = out - out.min().over(_MESSAGE), out.max().over(_MESSAGE) - out
    complete = _complete(rows).with_columns(after_first=after_first, before_last=before_last)
    timed = complete.group_by("relay_id").agg(
        outbound_p50_ns=out.median(),
        after_first_p50_ns=pl.col("after_first").median(),
        first_share=(pl.col("after_first") == 0).mean(),
        last_share=(pl.col("before_last") == 0).mean(),
    )
    counts = rows.group_by("relay_id").agg(messages=pl.len(), received=pl.col("receive_ns").count())
    relays = counts.join(timed, on="relay_id", how="left").sort("relay_id").iter_rows(named=True)
    return [{"group": group, "device": devices.get(relay["relay_id"]), **relay} for relay in relays]


def _times(rows: pl.DataFrame, relays: Sequence[dict[str, object]]) -> dict[str, object]:
    out, reply = pl.col("outbound_ns"), pl.col("receive_ns") - pl.col("publish_ns")
    complete = _complete(rows)
    messages = complete.group_by(_MESSAGE).agg(
        first_receiver=out.min(),
        last_receiver=out.max(),
        spread=out.max() - out.min(),
        first_reply=reply.min(),
        last_reply=reply.max(),
    )
    times = {name: summarize_values(messages[name].sort().to_numpy()) for name in FAN_OUT_TIMES}
    medians = pl.Series([relay["outbound_p50_ns"] for relay in relays], dtype=pl.Float64).drop_nulls().to_numpy()
    bound = complete["clock_bound_ns"]
    return {
        "messages": rows.select(_MESSAGE).n_unique(),
        "complete": messages.height,
        **{f"{name}_{key}_ns": times[name][key] for name in FAN_OUT_TIMES for key in ("p50", "p99")},
        "bound_ns": None if bound.null_count() else bound.max(),
        "position_step_ns": np.polyfit(range(len(medians)), medians, 1)[0] if len(medians) > 1 else None,
    }


def _costs(runs: Sequence[Sequence[Exchange]], samples: pl.DataFrame, late: Mapping[int, int]) -> dict[str, object]:
    values: dict[str, list[float]] = defaultdict(list)
    recorders = []
    for exchanges in runs:
        run, ping = exchanges[0].run, exchanges[0].ping
        relays = {exchange.relay.session_id: exchange.relay for exchange in exchanges if exchange.relay}
        for name, sessions in (("ping", [ping]), ("relay", relays.values())):
            percent = node_percent(samples, sessions, exchanges[0].start_ns, exchanges[0].end_ns)
            values[name] += [] if percent is None else [percent]
        classes = objects_of(object_of(run.extra.get("wire")).get("classes"))
        sent = sum(
            number_of(class_counts.get("bytes")) or 0
            for class_counts in classes
            if class_counts.get("direction") != "received"
        )
        values["wire"] += [sent / run.published / len(exchanges)] if classes and run.published else []
        met = object_of(run.extra.get("discovery"))
        there = len(exchanges) - late.get(run.run_id, 0)
        values["matched"] += [max(times)] if (times := _numbers(met.get("matched_ns"))[:there]) else []
        values["missed"] += [sum(_numbers(met.get("missed"))[:there])] if times else []
        values["discovery"] += filter(None, _numbers([met.get("bytes")]))
        ping_machine = machine_of(ping)
        recorders.append(exchanges[0].flows + sum(machine_of(relay) == ping_machine for relay in relays.values()))
    p50 = {name: median(members) for name, members in values.items() if members}
    return {
        "runs": len(runs),
        "receivers": max(map(len, runs)),
        "senders": runs[0][0].flows,
        "ping_cpu_percent": p50.get("ping"),
        "relay_cpu_percent": p50.get("relay"),
        "wire_bytes_per_receiver": p50.get("wire"),
        "matched_p50_ns": p50.get("matched"),
        "matched_max_ns": max(values["matched"], default=None),
        "missed_p50": p50.get("missed"),
        "discovery_bytes_p50": p50.get("discovery"),
        "recorders": max(recorders),
        "processors": next(iter(_numbers([runs[0][0].ping.host.get("cpu_cores")])), None),
    }


def _numbers(values: object) -> list[float]:
    numbers = map(number_of, values if isinstance(values, list) else [])
    return [number for number in numbers if number is not None and number >= 0]
