"""Hand-made `Analysis` values: say what each group sent and what became of each message, get all the frames."""

import math
import statistics
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from random import Random
from typing import Any

import numpy as np
import polars as pl
from kept import kept
from paired_by_hand import paired
from roundtrip_frames import PLAIN

from dds_trace import Analysis, Details, Finding, Severity, Source
from dds_trace.analyzer.groups.breakdown import breakdown_frame, response_frame
from dds_trace.analyzer.groups.freshness import freshness_frame, outage_frame
from dds_trace.analyzer.groups.host_samples import HOST_SAMPLE_SCHEMA
from dds_trace.analyzer.groups.intervals import INTERVAL_SCHEMA, ONE_WAY_SCHEMA, ONE_WAY_STATISTICS, sample_columns
from dds_trace.analyzer.groups.timeline import run_frame
from dds_trace.analyzer.model.columns import ROUNDTRIP_COLUMNS, SUMMARY_COLUMNS
from dds_trace.analyzer.model.detail_frames import FAN_OUT_FRAMES, RECOVERY_SCHEMA, WIRE_FRAMES
from dds_trace.analyzer.model.metrics import schema_of
from dds_trace.analyzer.pairing.one_way import KNOT_SCHEMA, SEGMENT_SCHEMA
from dds_trace.analyzer.pairing.rows import RowStore
from dds_trace.analyzer.run_statistics.between_runs import estimates_of_runs
from dds_trace.analyzer.run_statistics.runs import Run as Series
from dds_trace.analyzer.run_statistics.runs import Statistic
from dds_trace.analyzer.statistics.percentiles import PERCENTILES, STATISTICS
from dds_trace.analyzer.verdicts.answers import find_answers
from dds_trace.extensions.gates.compare import CompareOptions
from dds_trace.extensions.gates.costs import bridge_cost, find_head_of_line, find_interference
from dds_trace.extensions.wire.analyze import WIRE_CLASS_SCHEMA, WIRE_REPEAT_SCHEMA, WIRE_SCHEMA
from dds_trace.tracefile.format.descriptions import Qos, Run, Session

MS = 1_000_000
WALL_START_NS = 1_790_000_000 * 10**9  # 2026-09-21 14:13:20 UTC
QUANTILES = {percentile.name: percentile.quantile for percentile in PERCENTILES}
NEEDED = {percentile.name: percentile.needs for percentile in PERCENTILES}
RECORDER_COST = {"timer_ns": 60, "record_median_ns": 900, "record_p99_ns": 2000, "record_max_ns": 30_000}
CLOCK_BOUND_NS = 50_000
LOSSES = ("lost_outbound", "lost_in_relay", "lost_return", "lost_unknown")

ROUNDTRIPS = schema_of(ROUNDTRIP_COLUMNS)
DISTRIBUTIONS = {"group": pl.UInt32, "metric": pl.String, "value_ns": pl.Float64, "count": pl.UInt64}
TIMELINE = {
    "group": pl.UInt32,
    "run_id": pl.UInt64,
    "relay_id": pl.UInt32,
    "sequence": pl.UInt64,
    "elapsed_s": pl.Float64,
    "latency_ns": pl.Int64,
    "rtt_ns": pl.Int64,
    "outcome": pl.String,
}

ZENOH = {"vendor": "zenoh", "relay_vendor": "zenoh"}
BRIDGED = {"bridge": "builtin", "domain_mode": "different"}
MIXED = Random(1).sample(range(20), 20)
"""0 to 19 in an order in which neighbours are no more alike than others, so that 20 messages count as 20."""


def around(typical_ns):
    return [typical_ns + n * 1000 for n in MIXED]


@dataclass(frozen=True)
class Measured:
    """One group: its parameters, and the latency of each message in ns; a string instead of a number is a loss."""

    messages: Sequence[int | str]
    vendor: str = "fastdds"
    backend: str = "ros2"
    rmw: str | None = "rmw_fastrtps_cpp"
    bridge: str = "none"
    relay_vendor: str | None = "fastdds"
    domain_mode: str = "same"
    data_type: str = "binary"
    payload_bytes: int = 33_000
    rate_hz: float = 10.0
    reliability: str = "reliable"
    ping_device: str = "pi-one"
    relay_device: str | None = "pi-two"
    connectivity: str = "wired"
    setting: str = ""
    unsent: int = 0
    intermediate_ns: int = 100_000
    late_ns: int = 20_000
    """T1 - T0 of every message."""
    runs: int = 1
    """1 or 3: three runs are `messages` as they are, 3 % faster and 3 % slower; intervals then come from the runs."""

    @property
    def relayed(self) -> bool:
        return self.relay_device is not None

    def parameters(self) -> dict[str, Any]:
        no_relay = {} if self.relayed else dict.fromkeys(("relay_vendor", "relay_backend", "relay_domain_id"))
        return {
            **PLAIN,
            **{name: getattr(self, name) for name in PLAIN if hasattr(self, name)},
            "relay_backend": self.backend,
            "ping_domain_id": 10 if self.domain_mode == "same" else 5,
            "relay_domain_id": 10,
            **no_relay,
        }

    def rows(self, run_id: int) -> list[dict[str, Any]]:
        same: dict[str, Any] = dict.fromkeys(ROUNDTRIPS)
        same.update(self.parameters(), run_id=run_id, relay_id=7 if self.relayed else 0)
        same.update(outcome="completed", duplicates=0, reordered=False)
        return [self._row(same, sequence, message) for sequence, message in enumerate(self.messages)]

    def _row(self, same: dict[str, Any], sequence: int, message: int | str) -> dict[str, Any]:
        scheduled = 10**9 + round(sequence / self.rate_hz * 1e9)
        publish = scheduled + self.late_ns
        row = {**same, "sequence": sequence, "scheduled_ns": scheduled, "publish_ns": publish}
        if isinstance(message, str):
            row["outcome"] = message
            return row
        rtt = 2 * message + (self.intermediate_ns if self.relayed else 0)
        row.update(receive_ns=publish + rtt, rtt_ns=rtt, response_ns=rtt + self.late_ns)
        if self.relayed:
            relay_in = 500 + publish + message
            row.update(relay_in_ns=relay_in, relay_out_ns=relay_in + self.intermediate_ns)
            row.update(intermediate_ns=self.intermediate_ns, latency_ns=message)
            # The way out takes a tenth longer than the way back, in whole microseconds.
            longer = message // 20_000 * 1000
            row.update(outbound_ns=message + longer, return_ns=message - longer, clock_bound_ns=CLOCK_BOUND_NS)
        return row


def describe(values: Sequence[int]) -> dict[str, float | None]:
    """Mean, std, extremes and percentiles of a group held whole; null where the sample is too small."""
    ordered = sorted(values)
    count = len(ordered)
    if not count:
        return dict.fromkeys(statistic.name for statistic in STATISTICS)
    found: dict[str, float | None] = {
        "mean": statistics.fmean(ordered),
        "std": statistics.stdev(ordered) if count > 1 else None,
        "min": float(ordered[0]),
        "max": float(ordered[-1]),
    }
    for name, needed in NEEDED.items():
        place = (count - 1) * float(name[1:].replace("_", ".")) / 100
        low = math.floor(place)
        high = min(low + 1, count - 1)
        found[name] = ordered[low] + (ordered[high] - ordered[low]) * (place - low) if count >= needed else None
    for statistic in STATISTICS:  # one that a newcomer adds is not repeated here
        if statistic.name not in found:
            found[statistic.name] = statistic.of_values(np.array(ordered)) if count >= statistic.needs else None
    return found


@dataclass(frozen=True)
class Watched:
    """How closely devices and clocks were watched: samples of each session, and knots of each run, both from its start."""

    sample_s: tuple[float, ...] = (0.0, 1.0, 2.0)
    knot_s: tuple[float, ...] = (0.0, 10.0)


def make_analysis(
    *measured: Measured, findings: Sequence[Finding] = (), title: str = "runs", watched: Watched = Watched()
) -> Analysis:
    """The analysis of these groups, one run each, groups sorted as the summary sorts them."""
    ordered = sorted(measured, key=lambda one: tuple(str(value) for value in one.parameters().values()))
    roundtrips, summary, buckets, timeline = [], [], [], []
    for group, one in enumerate(ordered):
        rows = one.rows(run_id=0xA000 + group)
        roundtrips += rows
        summary.append(_summary_row(one, rows))
        for metric in ("rtt", "intermediate", "latency", "response"):
            values = [row[f"{metric}_ns"] for row in rows if row[f"{metric}_ns"] is not None]
            buckets += [
                {"group": group, "metric": metric, "value_ns": float(value), "count": count * one.runs}
                for value, count in sorted(Counter(values).items())
            ]
        timeline += [
            {**{name: row.get(name) for name in TIMELINE}, "group": group, "elapsed_s": row["sequence"] / one.rate_hz}
            for row in rows
        ]
    frame = pl.DataFrame(roundtrips, schema=ROUNDTRIPS)
    return Analysis(
        title=title,
        sources=(Source("ping.mcap", "read", "", 2 * len(roundtrips)),) if ordered else (),
        sessions=_sessions(ordered),
        runs=tuple(_run(group, one, number) for group, one in enumerate(ordered) for number in range(one.runs)),
        rows=RowStore.of(frame),
        summary=pl.DataFrame(summary, schema=schema_of(SUMMARY_COLUMNS)),
        distributions=pl.DataFrame(buckets, schema=DISTRIBUTIONS),
        run_times=run_frame(*paired(_by_group(frame))),
        timeline=pl.DataFrame(timeline, schema=TIMELINE),
        timeline_decimated=False,
        findings=tuple(findings),
        details=_details(ordered, frame, watched),
    )


def _details(ordered: Sequence[Measured], roundtrips: pl.DataFrame, watched: Watched) -> Details:
    """By the functions of the analyzer where they take rows; by hand what rests on other events."""
    rows = _by_group(roundtrips)
    held = paired(rows)
    judged = _judged(ordered, _three_runs(rows).sort("group", "run_id", "relay_id", "sequence"))
    return Details(
        intervals=_intervals(rows, ordered),
        one_way=_one_way(rows),
        breakdown=breakdown_frame(*held),
        responses=response_frame(*held),
        freshness=freshness_frame(*held),
        outages=outage_frame(*held),
        clock_fits=_clock_fits(ordered),
        clock_knots=_clock_knots(ordered, watched.knot_s),
        host_samples=_host_samples(ordered, watched.sample_s),
        bridge_costs=bridge_cost(
            _three_runs(roundtrips), CompareOptions(metrics=("latency",), statistics=tuple(QUANTILES))
        ),
        interference=find_interference(judged),
        head_of_line=find_head_of_line(judged),
        recoveries=pl.DataFrame(schema=RECOVERY_SCHEMA),
        **{name: pl.DataFrame(schema=schema) for name, schema in {**FAN_OUT_FRAMES, **WIRE_FRAMES}.items()},
        answers=find_answers(judged),
    )


def _judged(ordered: Sequence[Measured], rows: pl.DataFrame) -> RowStore:
    """Three runs of each row of the summary that has messages."""
    counts = dict(rows.group_by("group").len().iter_rows())
    parameters = [{**one.parameters(), "published": counts.get(group, 0)} for group, one in enumerate(ordered)]
    schema = {name: dtype for name, dtype in schema_of(SUMMARY_COLUMNS).items() if name in (*PLAIN, "published")}
    store = RowStore.of(rows.drop("group"), pl.DataFrame(parameters, schema))
    store.groups = store.groups.filter(pl.col("published") > 0)
    return store


def _by_group(roundtrips: pl.DataFrame) -> pl.DataFrame:
    return roundtrips.with_columns(group=(pl.col("run_id") - 0xA000).cast(pl.UInt32))


RUN_FACTORS = (1.0, 0.97, 1 / 0.97)
"""Times of three runs of a group against the first of them."""


def _three_runs(roundtrips: pl.DataFrame) -> pl.DataFrame:
    """Each run three times, 3 % faster and slower in turn: what verdicts take."""
    return pl.concat(
        roundtrips.with_columns(
            (pl.col("latency_ns", "rtt_ns") * factor).round().cast(pl.Int64), run_id=pl.col("run_id") + (number << 32)
        )
        for number, factor in enumerate(RUN_FACTORS)
    )


def _intervals(rows: pl.DataFrame, ordered: Sequence[Measured]) -> pl.DataFrame:
    found = []
    metrics = ("rtt", "intermediate", "latency", "response")
    asked = [Statistic(quantile) for quantile in QUANTILES.values()]
    held = rows.select("group", *(f"{metric}_ns" for metric in metrics))
    for (group,), part in held.group_by(["group"], maintain_order=True):
        factors = RUN_FACTORS[: ordered[int(str(group))].runs]
        for metric in metrics:
            values = part[f"{metric}_ns"].drop_nulls().to_numpy()
            if not len(values):
                continue
            estimates = estimates_of_runs([Series(values * factor) for factor in factors], asked)
            for (name, quantile), estimate in zip(QUANTILES.items(), estimates, strict=True):
                interval = estimate.interval
                found.append(
                    {
                        "group": group,
                        "metric": metric,
                        "percentile": name,
                        "quantile": quantile,
                        "estimate_ns": interval.value,
                        "low_ns": interval.lower,
                        "high_ns": interval.upper,
                        "method": "order_statistics" if interval.is_two_sided else None,
                        "between": None,
                        "within": None,
                        **sample_columns(interval),
                    }
                )
    return pl.DataFrame(found, schema=INTERVAL_SCHEMA)


def _one_way(rows: pl.DataFrame) -> pl.DataFrame:
    found = []
    for (group,), part in rows.select("group", "outbound_ns", "return_ns").group_by(["group"], maintain_order=True):
        for metric in ("outbound", "return"):
            values = part[f"{metric}_ns"].drop_nulls().to_list()
            if values:
                described = describe(values)
                found.append(
                    {"group": group, "metric": metric, "messages": len(values)}
                    | {f"{name}_ns": described[name] for name in ONE_WAY_STATISTICS}
                    | {"bound_p50_ns": CLOCK_BOUND_NS, "bound_max_ns": CLOCK_BOUND_NS}
                )
    return pl.DataFrame(found, schema=ONE_WAY_SCHEMA)


def _pairs(ordered: Sequence[Measured]) -> list[tuple[str, str]]:
    return sorted({(one.ping_device, one.relay_device) for one in ordered if one.relay_device is not None})


def _clock_fits(ordered: Sequence[Measured]) -> pl.DataFrame:
    """Every relay's clock is 500 ns ahead at the first second and gains 20 ppm."""
    rows = [
        {
            "ping_device": ping,
            "relay_device": relay,
            "boot": 0,
            "same_clock": False,
            "segment": 0,
            "start_ns": 10**9,
            "end_ns": 11 * 10**9,
            "at_ns": 10**9,
            "offset_ns": 500,
            "bound_ns": CLOCK_BOUND_NS,
            "drift_ppb": 20_000.0,
            "drift_bound_ppb": 1_000.0,
            "residual_ns": 100,
        }
        for ping, relay in _pairs(ordered)
    ]
    return pl.DataFrame(rows, schema=SEGMENT_SCHEMA)


def _clock_knots(ordered: Sequence[Measured], knot_s: Sequence[float]) -> pl.DataFrame:
    rows = [
        {
            "group": group,
            "run_id": 0xA000 + group,
            "relay_id": 7,
            "ping_device": one.ping_device,
            "relay_device": one.relay_device,
            "messages": len(one.messages),
            "at_ns": round((1 + second) * 10**9),
            "offset_ns": round(500 + 20_000 * second),
            "bound_ns": CLOCK_BOUND_NS,
        }
        for group, one in enumerate(ordered)
        if one.relayed and any(not isinstance(message, str) for message in one.messages)
        for second in knot_s
    ]
    return pl.DataFrame(rows, schema=KNOT_SCHEMA)


def _host_samples(ordered: Sequence[Measured], sample_s: Sequence[float]) -> pl.DataFrame:
    rows = [
        {
            "session_id": session.session_id,
            "role": session.role,
            "device": session.device,
            "wall_ns": WALL_START_NS + round(second * 10**9),
            "monotonic_ns": round((1 + second) * 10**9),
            "cpu_percent": 10.0 + second % 50,
            "cpu_busiest_percent": (20.0 if session.role == "ping" else 40.0) + second % 50,
            "bridge_cpu_percent": 30.0 if session.role == "ping" else None,
            "wifi_signal_dbm": -50.0 - second % 30 if session.connectivity == "wireless" else None,
        }
        for session in _sessions(ordered)
        for second in sample_s
    ]
    return pl.DataFrame(rows, schema=HOST_SAMPLE_SCHEMA)


def _summary_row(one: Measured, rows: list[dict[str, Any]]) -> dict[str, Any]:
    received = [row for row in rows if row["outcome"] == "completed"]
    span_s = (received[-1]["receive_ns"] - received[0]["receive_ns"]) / 1e9 if len(received) > 1 else None
    sent_s = (rows[-1]["publish_ns"] - rows[0]["publish_ns"]) / 1e9 if len(rows) > 1 else None
    row = {
        **one.parameters(),
        "published": len(rows) * one.runs,
        "received": len(received) * one.runs,
        **{loss: sum(row["outcome"] == loss for row in rows) * one.runs for loss in LOSSES},
        "duplicates": 0,
        "reordered": 0,
        "received_ratio": len(received) / len(rows) if rows else None,
        "achieved_rate_hz": (len(rows) - 1) / sent_s if sent_s else None,
        "transfer_rate_bytes_per_s": one.payload_bytes * len(received) / span_s if span_s else None,
        "runs": one.runs,
        "planned": (len(rows) + one.unsent) * one.runs,
        "unsent": one.unsent * one.runs,
        "sent": len(rows) * one.runs,
        "reached": len(received) * one.runs,
        "environment": "0123abcd",
        "own_cost_ns": 50_000.0,
        "own_share": 0.05,
    }
    for metric in ("rtt", "intermediate", "latency", "response"):
        values = [r[f"{metric}_ns"] for r in rows if r[f"{metric}_ns"] is not None]
        row.update({f"{metric}_{name}_ns": value for name, value in describe(values).items()})
    return row


def _sessions(measured: Sequence[Measured]) -> tuple[Session, ...]:
    pings = sorted({(one.ping_device, one.vendor, one.backend, one.connectivity) for one in measured})
    relays = sorted({(one.relay_device, one.vendor, one.backend, one.connectivity) for one in measured if one.relayed})
    return tuple(
        Session(
            session_id=0xB000 + number,
            role=role,
            device=str(device),
            backend=backend,
            vendor=vendor,
            rmw=None,
            domain_id=10,
            relay_id=7 if role == "relay" else None,
            connectivity=connectivity,
            wall_anchor_ns=WALL_START_NS,
            monotonic_anchor_ns=10**9,
            host={"cpu_model": "Cortex-A76", "cores": 4, "kernel": "6.6.31"},
            state="closed",
            extra={"recorder_cost": RECORDER_COST},
        )
        for number, (role, (device, vendor, backend, connectivity)) in enumerate(
            [("ping", one) for one in pings] + [("relay", one) for one in relays]
        )
    )


def _run(group: int, one: Measured, number: int) -> Run:
    return Run(
        run_id=0xA000 + group + (number << 32),
        data_type=one.data_type,
        payload_bytes=one.payload_bytes,
        rate_hz=one.rate_hz,
        planned_messages=len(one.messages),
        warmup_messages=0,
        bridge=one.bridge,
        relay_domain_id=10,
        qos=Qos(reliability=one.reliability),
        published=len(one.messages),
        state="finished",
        extra={"session_id": f"{0xB000:016x}"},
    )


# The analyses that every figure and every reporter must accept.


def empty_folder() -> Analysis:
    return make_analysis()


def one_message() -> Analysis:
    return make_analysis(Measured([2 * MS]))


def ping_without_relay() -> Analysis:
    messages = [MS + 1000 * i for i in range(30)] + ["lost_unknown"] * 2
    return make_analysis(
        Measured(messages, relay_device=None),
        Measured(messages, relay_device=None, rate_hz=20.0),
        findings=[
            Finding(Severity.WARNING, "no_relay_trace", "run a000", "No relay trace.", "Copy the relay's trace here.")
        ],
    )


def nothing_came_back() -> Analysis:
    return make_analysis(Measured(["lost_outbound"] * 20), Measured(["lost_return"] * 20, vendor="zenoh"))


HOSTILE = (
    "<script>window.pwned=1</script>",
    "</script><img src=x onerror=window.pwned=1>",
    '=HYPERLINK("http://evil.invalid","x")',
    "\x1b[31mred\x1b]0;title\x07",
    "a|b`c`**d** @everyone [x](http://evil.invalid) #1",
    "line\u2028separator\u2029and\u202egnp.exe",
)


def hostile() -> Analysis:
    """Every string that can come from a trace holds something that means harm in some medium."""
    groups = [
        Measured(
            [MS + 1000 * i for i in range(12)],
            vendor=text if number % 2 else "fastdds",
            bridge=text if number % 3 == 0 else "none",
            domain_mode="different" if number % 3 == 0 else "same",
            data_type=text if number % 2 == 0 else "binary",
            reliability=text,
            ping_device=text,
            relay_device=text,
            connectivity=text,
            rate_hz=10.0 * (1 + number % 2),
        )
        for number, text in enumerate(HOSTILE)
    ]
    findings = [Finding(Severity.ERROR, "loss", text, f"{text} lost messages.", f"Look at {text}.") for text in HOSTILE]
    return make_analysis(*groups, findings=findings, title=HOSTILE[0])


SIZES = (33_000, 67_000, 87_000, 145_000, 294_000, 502_000, 1_000_000, 2_000_000, 4_000_000)
RATES = (1.0, 5.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 80.0, 100.0)


@dataclass
class Campaign:
    """A made-up campaign in the shape of the paper's; latencies follow no real middleware."""

    vendors: tuple[str, ...] = ("fastdds", "cyclonedds")
    messages: int = 120
    sizes: tuple[int, ...] = SIZES
    rates: tuple[float, ...] = RATES
    strings: tuple[int, ...] = (4, 91, 1405, 2675)
    bridged: bool = True
    watched: Watched = Watched()
    random: Random = field(default_factory=lambda: Random(5))

    def analysis(self, findings: Sequence[Finding] = ()) -> Analysis:
        groups = [
            self._group(vendor, bridge, data_type, size, rate)
            for vendor in self.vendors
            for bridge in (("none", "builtin") if self.bridged else ("none",))
            for data_type, sizes, rates in (
                ("binary", self.sizes, self.rates),
                ("string", self.strings, self.rates[:8]),
                ("imu", (296,), self.rates[:8]),
            )
            for size in sizes
            for rate in rates
        ]
        return make_analysis(*groups, findings=findings, title="campaign", watched=self.watched)

    def _group(self, vendor: str, bridge: str, data_type: str, size: int, rate: float) -> Measured:
        base = {"fastdds": 0.42, "cyclonedds": 0.36, "zenoh": 0.30, "socket": 0.12}.get(vendor, 0.5)
        per_mb = {"fastdds": 4.6, "cyclonedds": 2.4, "zenoh": 1.6, "socket": 0.8}.get(vendor, 3.0)
        step = 6.0 if vendor == "fastdds" and size > 500_000 else 0.0
        typical_ms = (base + per_mb * size / 1e6 + step + 0.6 / rate) * (1.9 if bridge != "none" else 1.0)
        full = size * rate > 1.2e8
        messages: list[int | str] = []
        for _ in range(self.messages):
            if self.random.random() < (0.08 if full else 0.0004):
                messages.append(self.random.choice(("lost_outbound", "lost_return")))
            else:
                messages.append(round(typical_ms * MS * self.random.lognormvariate(0.0, 0.35 if full else 0.12)))
        return Measured(
            messages,
            vendor=vendor,
            rmw=None,
            relay_vendor=vendor,
            bridge=bridge,
            domain_mode="same" if bridge == "none" else "different",
            data_type=data_type,
            payload_bytes=size,
            rate_hz=rate,
            connectivity="wireless",
            intermediate_ns=round(80_000 + size * 0.05),
        )


FINGERPRINT = {
    "machine": "aarch64",
    "board": "Raspberry Pi 5 Model B Rev 1.0",
    "cpu_model": "Cortex-A76",
    "cpu_cores": 4,
    "cpu_governor": "performance",
    "cpu_max_mhz": 2400.0,
    "os": "Ubuntu 24.04.1 LTS",
    "kernel": "6.8.0-1018-raspi",
    "memory_bytes": 8_323_653_632,
    "python": "CPython 3.12.3",
    "versions": {"rclpy": "7.1.6", "fastrtps": "2.14.5", "rmw_fastrtps_cpp": "8.4.3"},
    "settings": {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"},
    "socket_buffers": {
        f"net.core.{name}": 212_992 for name in ("rmem_default", "rmem_max", "wmem_default", "wmem_max")
    },
    "mtu": {"lo": 65536, "wlan0": 1500},
    "clock_source": "arch_sys_counter",
}


def five_hundred_groups() -> Analysis:
    """The paper's full space for two vendors, 520 groups: as large as a page of so many groups gets.

    Each run has two samples a second of either device, ten knots of its clocks, two sessions and two files of its own,
    and six findings, which is more than a page shows one by one of each.
    """
    watched = Watched(tuple(n / 2 for n in range(260)), tuple(float(n) for n in range(10)))
    analysis = Campaign(watched=watched).analysis(_campaign_findings())
    groups = range(analysis.summary.height)
    further = [
        replace(
            one, session_id=0xC000 + 2 * group + place, host=FINGERPRINT | {"wifi": {"wlan0": {"signal_dbm": -group}}}
        )
        for group in groups
        for place, one in enumerate(analysis.sessions[:2])
    ]
    sources = [
        Source(f"traces/ros2_builtin_binary-33KB_{group}Hz.{role}.mcap", "read", "", 240)
        for group in groups
        for role in ("ping", "relay")
    ]
    found = [
        Finding(
            Severity.WARNING,
            f"kind_{kind}",
            "one of twenty groups",
            "91 of 150 messages (60.7 %) did not come back: 71 lost_outbound, 20 lost_return.",
            "Read percentiles here as those of the messages that survived.",
            (group,) if group < 20 else tuple(groups[20:]),
            1 if group < 20 else len(groups) - 20,
        )
        for kind in "abcdef"
        for group in range(21)
    ]
    return replace(
        analysis, sessions=(*analysis.sessions, *further), sources=tuple(sources), findings=(*analysis.findings, *found)
    )


def small_campaign() -> Analysis:
    return Campaign(
        vendors=("fastdds", "zenoh"), sizes=(33_000, 1_000_000), rates=(10.0, 20.0), strings=(1405,)
    ).analysis(_campaign_findings())


def _campaign_findings() -> list[Finding]:
    return [
        Finding(
            Severity.WARNING,
            "size_step",
            "Fast DDS, binary 1 MB",
            "The median latency rises from 2.9 ms at 502 KB to 11 ms at 1 MB, more than the size explains.",
            "Check the shared-memory segment (512 KiB by default) and net.core.rmem_default.",
        ),
        Finding(
            Severity.INFO,
            "few_samples",
            "all groups",
            "p99.9 is left out: it takes 1,000 messages.",
            "Record at least 1000 messages a group to see all of them.",
        ),
    ]


# Frozen values, so every test of a process may share them.
def over_a_lossy_wire() -> Analysis:
    """Two middlewares recorded with `--wire`: the first repeated messages, of the second the kernel dropped packets."""
    analysis = make_analysis(
        Measured([MS, 2 * MS, 30 * MS]), Measured([MS, 3 * MS], vendor="cyclonedds", relay_vendor="cyclonedds")
    )
    shares = {"data": 0.5, "data_frag_again": 0.3, "heartbeat": 0.1, "sedp": 0.05, "secure": 0.05}
    counts = {
        name: 0 if kind in (pl.UInt32, pl.UInt64) else 0.25 for name, kind in WIRE_SCHEMA.items() if kind != pl.Boolean
    }
    wire = [
        {**counts, "group": 0, "complete": False, "kernel_drops": 3, "bytes_per_payload_byte": 1.5},
        {**counts, "group": 1, "complete": True, "bytes_per_payload_byte": 1.1, "match_p50_ns": 4e7}
        | {"tcp_rtt_p50_ns": None},
    ]
    classes = [
        {"group": group, "wire_class": name, "packets": 5, "bytes": round(100_000 * share), "share": share}
        for group in (0, 1)
        for name, share in shares.items()
    ]
    times = ("rtt_p50_ns", "rtt_max_ns", "latency_p50_ns", "latency_max_ns")
    repeats = [
        {"group": 1, "repeats": n, "messages": 3 - n, "returned": 1} | dict.fromkeys(times, float(MS * (1 + 29 * n)))
        for n in (0, 1)
    ]
    details = replace(
        analysis.details,
        wire=pl.DataFrame(wire, WIRE_SCHEMA),
        wire_classes=pl.DataFrame(classes, WIRE_CLASS_SCHEMA),
        wire_repeats=pl.DataFrame(repeats, WIRE_REPEAT_SCHEMA),
    )
    return replace(analysis, details=details)


EVERY_ANALYSIS = {
    "empty folder": cache(empty_folder),
    "one message": cache(one_message),
    "ping without relay": cache(ping_without_relay),
    "nothing came back": cache(nothing_came_back),
    "hostile strings": cache(hostile),
    "small campaign": kept(small_campaign),
    "over a lossy wire": cache(over_a_lossy_wire),
    "500 groups": kept(five_hundred_groups),
}
