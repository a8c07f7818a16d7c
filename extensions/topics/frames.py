"""Tables of what taps heard, by message, by topic and pair of devices, and by hop of a chain."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from itertools import product

import numpy as np
import polars as pl

from dds_trace.analyzer.clocks.lines import Int64
from dds_trace.analyzer.loading.campaign import Campaign
from dds_trace.analyzer.model.detail_frames import (
    HOP_SCHEMA,
    TOPIC_MESSAGE_SCHEMA,
    TOPIC_SCHEMA,
    TOPIC_STATISTICS,
    Topics,
)
from dds_trace.analyzer.model.metrics import TOPIC_METRICS
from dds_trace.analyzer.model.parameters import PARAMETER_COLUMNS, ParameterValue
from dds_trace.analyzer.model.runs import tap_run_id
from dds_trace.analyzer.pairing.rows import RowStore
from dds_trace.base.units import SECOND_NS
from dds_trace.extensions.bags.chains import share_of_inputs
from dds_trace.extensions.bags.quantiles import named_quantile, spread
from dds_trace.tracefile.format.json_fields import JsonObject, number_of

from .device_clocks import DeviceClocks, Machine, follow_wall_clocks
from .join import Delivery, deliver, find_streams, heard_by_taps, with_ages


def origin_name(delivery: Delivery) -> str:
    return "unknown" if delivery.origin is None else delivery.origin.device


def find_sources(deliveries: Sequence[Delivery]) -> dict[int, int]:
    """Return for each delivery, by index, the one that it was made of: the last one received before it."""
    sources = {}
    for number, later in enumerate(deliveries):
        earlier_ones = []
        for other, earlier in enumerate(deliveries):
            is_here = later.origin is not None and earlier.heard.machine == later.origin
            if earlier.heard.topic == later.heard.topic or not is_here:
                continue
            times, _ = _processing_ns(earlier, later)
            if len(times) and 2 * len(times) >= len(later.messages) and np.median(times) >= 0:
                earlier_ones.append((float(np.median(times)), other))
        if earlier_ones:
            sources[number] = min(earlier_ones)[1]
    return sources


def _path_to(number: int, sources: Mapping[int, int]) -> list[int]:
    path = [number]
    while (earlier := sources.get(path[0])) is not None and earlier not in path:
        path.insert(0, earlier)
    return path


def stamper(number: int, deliveries: Sequence[Delivery], sources: Mapping[int, int]) -> Machine:
    """Return the machine that stamped the messages of a delivery by its clock: the one at which its chain begins."""
    first = deliveries[_path_to(number, sources)[0]]
    return first.heard.machine if first.origin is None else first.origin


def hop_rows(deliveries: Sequence[Delivery], sources: Mapping[int, int]) -> Iterator[dict[str, object]]:
    """Yield rows of `HOP_SCHEMA`, by chain: one for each delivery with ages that is on the way to no other."""
    has_age = [delivery.messages["age_ns"].null_count() < len(delivery.messages) for delivery in deliveries]
    ends = [number for number, is_aged in enumerate(has_age) if is_aged and number not in sources.values()]
    for chain, end in enumerate(ends):
        path = [deliveries[number] for number in _path_to(end, sources)]
        for hop, row in enumerate(_hops(path)):
            yield {"chain": chain, "hop": hop, **row}


def _hops(path: Sequence[Delivery]) -> Iterator[dict[str, object]]:
    for number, hop in enumerate(path):
        topic, origin, device = hop.heard.topic, origin_name(hop), hop.heard.session.device
        if number:
            times, share = _processing_ns(path[number - 1], hop)
            topics = path[number - 1].heard.topic, topic
            yield _hop(topics, ("receive", "publish"), (origin, origin), times) | {"share": share}
        else:
            times = hop.messages["stamp_to_publish_ns"].drop_nulls().to_numpy()
            yield _hop((topic, topic), ("stamp", "publish"), (origin, origin), times)
        times, bound_ns = hop.messages["one_way_ns"].drop_nulls().to_numpy(), hop.messages["bound_ns"].max()
        yield {**_hop((topic, topic), ("publish", "receive"), (origin, device), times), "bound_ns": bound_ns}


def _hop(topics: tuple[str, str], events: tuple[str, str], devices: tuple[str, str], times: Int64) -> dict[str, object]:
    names = ("topic", "next_topic", "from_event", "to_event", "ping_device", "relay_device")
    statistics = {f"{name}_ns": named_quantile(times, name) for name in ("p50", "p99", "max")}
    return {**dict(zip(names, (*topics, *events, *devices), strict=True)), "messages": len(times), **statistics}


def _processing_ns(earlier: Delivery, later: Delivery) -> tuple[Int64, float | None]:
    """Return the times from reception to publishing, and the share of inputs that led to an output."""
    received = earlier.messages.select("header_ns", "relay_in_ns").drop_nulls().unique("header_ns").sort("header_ns")
    published = later.messages.select("header_ns", "publish_ns").drop_nulls().unique("header_ns")
    joined = received.with_row_index("number").join(published, on="header_ns", maintain_order="left")
    times: Int64 = (joined["publish_ns"] - joined["relay_in_ns"]).to_numpy()
    return times, share_of_inputs(joined["number"].to_numpy())


def find_topics(campaign: Campaign, rows: RowStore) -> Topics:
    readings = tuple(follow_wall_clocks(campaign))
    clocks = DeviceClocks(campaign.sessions.values(), campaign.runs.values(), rows, readings)
    deliveries = [delivery for stream in find_streams(heard_by_taps(campaign)) for delivery in deliver(stream, clocks)]
    deliveries = [delivery for delivery in deliveries if len(delivery.messages)]
    sources = find_sources(deliveries)
    deliveries = [
        with_ages(delivery, stamper(number, deliveries, sources), clocks) for number, delivery in enumerate(deliveries)
    ]
    by_result: dict[tuple[str, str, str], list[Delivery]] = defaultdict(list)
    for delivery in deliveries:
        by_result[delivery.heard.topic, origin_name(delivery), delivery.heard.session.device].append(delivery)
    ordered = [by_result[key] for key in sorted(by_result)]
    messages = [_with_parameters(delivery) for parts in ordered for delivery in parts]
    return Topics(
        pl.DataFrame([_topic_row(parts) for parts in ordered], TOPIC_SCHEMA),
        pl.concat(messages) if messages else pl.DataFrame(schema=TOPIC_MESSAGE_SCHEMA),
        pl.DataFrame(list(hop_rows(deliveries, sources)), HOP_SCHEMA),
        readings,
    )


def _with_parameters(delivery: Delivery) -> pl.DataFrame:
    """Return messages with columns of round trips; size and rate, the robot's choice, are no part of the key."""
    session, qos = delivery.heard.session, delivery.heard.qos
    values: dict[str, ParameterValue] = {
        "vendor": session.vendor,
        "backend": session.backend,
        "rmw": session.rmw,
        "bridge": "none",
        "relay_vendor": session.vendor,
        "relay_backend": session.backend,
        "ping_domain_id": session.domain_id,
        "relay_domain_id": session.domain_id,
        "domain_mode": "same",
        "data_type": delivery.heard.topic,
        "payload_bytes": 0,
        "rate_hz": 0.0,
        **{name: str(qos.get(name, "unknown")) for name in ("reliability", "durability", "history")},
        "depth": int(number_of(qos.get("depth")) or 0),
        "serialization": "raw",
        "ping_device": origin_name(delivery),
        "relay_device": session.device,
        "connectivity": session.connectivity,
        "setting": "",
    }
    run_id = tap_run_id(delivery.heard.topic, origin_name(delivery), session.session_id)
    described = [pl.lit(values[column.name], column.dtype).alias(column.name) for column in PARAMETER_COLUMNS]
    messages = delivery.messages.with_columns(
        pl.lit(run_id, pl.UInt64).alias("run_id"), pl.lit(0, pl.UInt32).alias("relay_id"), *described
    )
    missing = [pl.lit(None, dtype).alias(n) for n, dtype in TOPIC_MESSAGE_SCHEMA.items() if n not in messages.columns]
    return messages.with_columns(missing).select(*TOPIC_MESSAGE_SCHEMA)


def _by_session(deliveries: Sequence[Delivery], name: str) -> list[Int64]:
    sessions: dict[int, list[pl.Series]] = defaultdict(list)
    for delivery in deliveries:
        sessions[delivery.heard.session.session_id].append(delivery.messages[name].drop_nulls())
    return [np.sort(pl.concat(parts).to_numpy()) for parts in sessions.values()]


def _reliability(policies: Sequence[JsonObject]) -> str:
    return ", ".join(sorted({str(qos.get("reliability", "unknown")) for qos in policies}))


def _topic_row(deliveries: Sequence[Delivery]) -> dict[str, object]:
    messages = pl.concat([delivery.messages for delivery in deliveries])
    arrivals, sent = (_by_session(deliveries, name) for name in ("relay_in_ns", "publish_ns"))
    periods = np.concatenate([np.diff(part) for part in arrivals])
    lasted_ns, sending_ns = (int(sum(part[-1] - part[0] for part in times)) for times in (arrivals, sent))
    outcomes = dict(messages["outcome"].value_counts().iter_rows())
    received = outcomes.get("completed", 0)
    received_bytes = messages.filter(outcome="completed")["message_bytes"]
    return {
        "topic": deliveries[0].heard.topic,
        "message_type": deliveries[0].heard.message_type,
        "ping_device": origin_name(deliveries[0]),
        "relay_device": deliveries[0].heard.session.device,
        "clock": ", ".join(sorted({delivery.clock for delivery in deliveries})),
        "publishers": len({delivery.heard.publisher for delivery in deliveries}),
        "runs": len({delivery.heard.session.session_id for delivery in deliveries}),
        "published": len(messages),
        "received": received,
        **{name: outcomes.get(name, 0) for name in ("lost_outbound", "lost_unknown")},
        "offered": _reliability([delivery.heard.qos for delivery in deliveries]),
        "subscribed": _reliability([delivery.heard.subscribed for delivery in deliveries]),
        **{name: int(messages[name].sum()) for name in ("duplicates", "reordered")},
        "received_ratio": received / len(messages),
        "duration_ns": lasted_ns,
        "rate_hz": (len(messages) - len(sent)) * SECOND_NS / sending_ns if sending_ns else None,
        "message_bytes": received_bytes.mean(),
        "transfer_rate_bytes_per_s": int(received_bytes.sum()) * SECOND_NS / lasted_ns if lasted_ns else None,
        "period_p50_ns": named_quantile(periods, "p50"),
        "period_p99_ns": named_quantile(periods, "p99"),
        "jitter_ns": spread(periods) if len(periods) > 1 else None,
        **{
            f"{metric}_{statistic}_ns": named_quantile(messages[f"{metric}_ns"].drop_nulls().to_numpy(), statistic)
            for metric, statistic in product(TOPIC_METRICS, TOPIC_STATISTICS)
        },
        "bound_ns": messages["bound_ns"].max(),
    }
