"""The plan of a run, from the options and the data."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.base.units import SECOND_NS
from dds_trace.tracefile.format.descriptions import Qos, Run
from dds_trace.tracefile.format.json_fields import JsonObject

from ..backends import load_backend
from ..backends.sizes import requested_bytes
from ..choices import Call, Serialization
from ..options import DEFAULT_MESSAGES, DEFAULT_RATE_HZ, MAX_RATE_PING_SHARE, PingOptions, RecordOptions, run_settings
from ..payloads.base import DataType, Payload

MOST_MESSAGES_A_SECOND = 200_000
MOST_TIMED_MESSAGES = 20_000_000
"""Messages that end a run at `--rate max` before its time, with 400 MB of ledger."""


@dataclass(frozen=True, slots=True)
class RunPlan:
    """The messages of a run and their schedule; `warmup` of them do not count, without probes `wake_ns` is 0."""

    payload: Payload
    rate_hz: float
    messages: int
    warmup: int = 0
    qos: Qos = field(default_factory=Qos)
    wake_ns: int = 0
    serialization: Serialization = Serialization.RAW
    ping_every: int = 1
    is_timed: bool = False
    bridge: str = "none"
    relay_domain_id: int | None = None
    clients: int = 1
    call_timeout_s: float = 0.0
    reply_bytes: int | None = None
    labels: Mapping[str, str] = field(default_factory=dict)
    extra: JsonObject = field(default_factory=dict)

    @property
    def total(self) -> int:
        return self.warmup + self.messages

    def scheduled_ns(self, start_ns: int, sequence: int) -> int:
        slot = sequence - sequence % self.clients
        return 0 if math.isinf(self.rate_hz) else start_ns + round(slot * SECOND_NS / self.rate_hz)

    def pinged(self, messages: int) -> int:
        return -(-messages // self.ping_every)

    def describe(self, run_id: int) -> Run:
        more = {"ping_every": self.ping_every} if self.ping_every > 1 else {}
        more |= {} if self.reply_bytes is None else {"reply_bytes": self.reply_bytes}
        return Run(
            run_id=run_id,
            data_type=self.payload.data_type.name,
            payload_bytes=self.payload.payload_bytes,
            rate_hz=0.0 if math.isinf(self.rate_hz) else self.rate_hz,
            planned_messages=self.messages,
            warmup_messages=self.warmup,
            bridge=self.bridge,
            relay_domain_id=self.relay_domain_id,
            serialization=self.serialization.value,
            qos=self.qos,
            labels=self.labels,
            extra={**self.extra, **more},
        )


def plan_run(options: RecordOptions, ping: PingOptions, payload: Payload, *, session_id: int, seed: int) -> RunPlan:
    check_serialization([payload.data_type], options.serialization)
    check_rate(ping, is_live=payload.feed is not None)
    rate_hz = ping.rate_hz or payload.rate_hz or DEFAULT_RATE_HZ
    limits.check(limits.RATE_HZ_OR_MAX, rate_hz, f"rate of {ping.data}")
    share = ping.ping_share or (MAX_RATE_PING_SHARE if math.isinf(rate_hz) else 1.0)
    if ping.wake_ms * rate_hz >= 1000:
        raise OptionError(
            f"-o wake={ping.wake_ms}: at {rate_hz:g} Hz a message leaves every {1e3 / rate_hz:g} ms; give less"
        )
    own_domain_id = options.node.domain_id
    source = {"data_source": payload.source} if payload.source else {"seed": seed}
    running = {"bridge_running": True} if ping.bridge_running else {}
    is_typed = options.node.call is not Call.NONE and load_backend(options.backend).has_ros
    return RunPlan(
        payload=payload,
        rate_hz=rate_hz,
        messages=count_messages(ping.messages, options.duration_s, rate_hz, ping.warmup),
        warmup=ping.warmup,
        wake_ns=ping.wake_ms * SECOND_NS // 1000,
        qos=options.node.qos,
        serialization=Serialization.TYPED if is_typed else options.serialization,
        clients=ping.clients,
        call_timeout_s=ping.call_timeout_s,
        reply_bytes=requested_bytes(options.node.call, options.node.response_bytes),
        ping_every=round(1 / share),
        is_timed=math.isinf(rate_hz) and ping.messages is None,
        bridge=ping.bridge,
        relay_domain_id=own_domain_id if ping.relay_domain_id is None else ping.relay_domain_id,
        labels=ping.labels,
        extra={"session_id": f"{session_id:016x}", **source, **running, "settings": run_settings(ping)},
    )


def count_messages(messages: int | None, duration_s: float | None, rate_hz: float, warmup: int) -> int:
    if messages is not None:
        return messages
    if duration_s is None:
        if math.isinf(rate_hz):
            raise OptionError("--rate max has no end of its own: give --duration 10, or --messages")
        return DEFAULT_MESSAGES
    if math.isinf(rate_hz):
        return min(round(duration_s * MOST_MESSAGES_A_SECOND) + 1, MOST_TIMED_MESSAGES)
    fitting = max(round(duration_s * rate_hz) - warmup, 1)
    limits.check(limits.MESSAGES, fitting, f"--duration {duration_s:g} at {rate_hz:g} Hz are")
    return fitting


def check_rate(ping: PingOptions, *, is_live: bool) -> None:
    if is_live and ping.rate_hz is not None:
        raise OptionError("--rate cannot be given with topic:/NAME: its messages are the schedule")


def check_serialization(data_types: Iterable[DataType], serialization: Serialization) -> None:
    if serialization is Serialization.TYPED:
        for data_type in data_types:
            data_type.object_form()
