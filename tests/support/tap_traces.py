"""Traces of taps and a beacon on two devices whose clocks are known: what was measured can be held against the truth."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np
import trace_files
from event_cdr import pack_event

from dds_trace.tracefile.format.descriptions import Session
from dds_trace.tracefile.format.events import PUBLISHER_TOPIC, SESSION_TOPIC, TAP_DEFINITION, Stage

MS, SECOND = 1_000_000, 1_000_000_000
FAR_NS, NEAR_NS = 900_000, 60_000
"""Least ways to another device, and on one."""
EPOCH_NS = 1_700_000_000 * SECOND
TAP = ("dds_trace_msgs/msg/TapEvent", TAP_DEFINITION)


@dataclass(frozen=True)
class Clock:
    """A device's clocks as functions of the true time in ns: both run `ppm` too fast, the wall clock is off by `wall_off_ns`,
    gains `slew_ppm` on the monotonic one, and is set by `set_ns` at `set_at_ns`."""

    device: str
    boot_id: str
    since_boot_ns: int = 50 * SECOND
    wall_off_ns: int = 0
    ppm: int = 0
    slew_ppm: int = 0
    set_ns: int = 0
    set_at_ns: int = 20 * SECOND

    def monotonic(self, true_ns: Any) -> Any:
        return true_ns + self.since_boot_ns + true_ns * self.ppm // 1_000_000

    def wall(self, true_ns: Any) -> Any:
        set_ns = (true_ns >= self.set_at_ns) * self.set_ns + true_ns * self.slew_ppm // 1_000_000
        return self.monotonic(true_ns) - self.since_boot_ns + EPOCH_NS + self.wall_off_ns + set_ns

    def session(self, make: Any, session_id: int, **changes: Any) -> Session:
        return make(
            session_id=session_id,
            device=self.device,
            wall_anchor_ns=self.wall(0),
            monotonic_anchor_ns=self.monotonic(0),
            extra={"boot_id": self.boot_id},
            connectivity="wired",
            **changes,
        )


ROBOT = Clock("robot", "11111111-1111-1111-1111-111111111111")
LAPTOP = Clock("laptop", "22222222-2222-2222-2222-222222222222", 2_050 * SECOND, -2 * SECOND, 200)


@dataclass(frozen=True)
class Published:
    """Messages of one publisher: true times in ns, equally long; `headers` are as its stamps say."""

    topic: str
    clock: Clock
    sent_ns: np.ndarray
    headers: np.ndarray
    guid: str = "01" * 16
    message_type: str = "sensor_msgs/msg/Image"
    sizes: int = 1000
    contents: np.ndarray = field(default_factory=lambda: np.empty(0))

    def content(self, number: int) -> int:
        text = f"{self.topic} {self.contents[number] if len(self.contents) else number}"
        return int.from_bytes(blake2b(text.encode(), digest_size=8).digest(), "little") or 1


@dataclass(frozen=True)
class Hearing:
    """What a tap hears of a publisher: true reception of each message in ns, -1 for a lost one."""

    published: Published
    arrived_ns: np.ndarray
    has_sequence: bool = True
    has_source: bool = True
    guid: str | None = None
    first_sequence: int = 1


def write_tap(path: Path, clock: Clock, hearings: Sequence[Hearing], *, session_id: int, end_ns: int = 0) -> Path:
    session = clock.session(trace_files.ping_session, session_id, role="tap")
    messages = [
        trace_files.RawMessage(
            SESSION_TOPIC, trace_files.string_cdr(session.to_json()), session.wall_anchor_ns, trace_files.STRING
        )
    ]
    events = []
    for publisher_id, one in enumerate(hearings, 1):
        record = {
            "session_id": f"{session_id:016x}",
            "publisher_id": publisher_id,
            "state": "closed",
            "topic": one.published.topic,
            "type": one.published.message_type,
            "publisher": one.published.guid if one.guid is None else one.guid or None,
            "node": "/a_node",
            "qos": {"reliability": "reliable", "durability": "volatile", "history": "keep_last", "depth": 10},
            "subscribed": {},
            "header": "header",
            "sequence_is_given": one.has_sequence,
            "monotonic_ns": int(clock.monotonic(max(end_ns, int(one.arrived_ns.max())))),
            "messages": int((one.arrived_ns >= 0).sum()),
            "missing": None,
        }
        messages.append(
            trace_files.RawMessage(
                PUBLISHER_TOPIC, trace_files.string_cdr(json.dumps(record)), session.wall_anchor_ns, trace_files.STRING
            )
        )
        for number, (arrived_ns, sent_ns, header_ns) in enumerate(
            zip(one.arrived_ns.tolist(), one.published.sent_ns.tolist(), one.published.headers.tolist(), strict=True)
        ):
            if arrived_ns >= 0:
                fields = (
                    one.published.content(number),
                    number + one.first_sequence if one.has_sequence else 0,
                    int(clock.monotonic(arrived_ns)),
                    header_ns,
                    int(one.published.clock.wall(sent_ns)) if one.has_source else 0,
                    int(clock.wall(arrived_ns)),
                    one.published.sizes,
                    publisher_id,
                )
                events.append((arrived_ns, fields))
    for _, fields in sorted(events):
        messages.append(trace_files.RawMessage(Stage.TAP.topic, pack_event(*fields), session.wall_ns(fields[2]), TAP))
    return trace_files.write_messages(path, messages)


def write_beacon(folder: Path, ping: Clock, relay: Clock, *, seconds: int, rate_hz: int = 4, number: int = 0) -> None:
    """Write the traces of a ping and a relay that exchange short messages over a wired link."""
    draw = np.random.default_rng(5 + number)
    sent = np.arange(seconds * rate_hz) * (SECOND // rate_hz) + 3 * MS
    out, back = (120_000 + draw.exponential(80_000, len(sent)).astype(np.int64) for _ in range(2))
    times = np.stack([sent, sent + out, sent + out + 40_000, sent + out + 40_000 + back])
    relay_id, run_id = trace_files.RELAY_ID + number, trace_files.RUN_ID + number
    described = trace_files.run(
        run_id=run_id,
        extra={"session_id": f"{0xA1 + 256 * number:016x}"},
        data_type="beacon",
        payload_bytes=64,
        rate_hz=float(rate_hz),
        planned_messages=len(sent),
        published=len(sent),
    )
    t1, t3, t4, t2 = (
        clock.monotonic(one).tolist() for clock, one in zip((ping, relay, relay, ping), times, strict=True)
    )
    numbers = range(len(sent))
    trace_files.write_trace(
        folder / "beacon-ping.mcap",
        ping.session(trace_files.ping_session, 0xA1 + 256 * number),
        [described],
        {
            Stage.T1: [
                trace_files.event(n, t1[n], run_id=run_id, scheduled_ns=t1[n], payload_bytes=64) for n in numbers
            ],
            Stage.T2: [
                trace_files.event(n, t2[n], run_id=run_id, relay_id=relay_id, payload_bytes=64) for n in numbers
            ],
        },
    )
    trace_files.write_trace(
        folder / "beacon-relay.mcap",
        relay.session(trace_files.relay_session, 0xB2 + 256 * number, relay_id=relay_id),
        (),
        {
            stage: [trace_files.event(n, at[n], run_id=run_id, relay_id=relay_id, payload_bytes=64) for n in numbers]
            for stage, at in ((Stage.T3, t3), (Stage.T4, t4))
        },
    )


def camera(*, seconds: int = 60, rate_hz: int = 30, age_ns: int = 5 * MS, **more: Any) -> Published:
    """A camera of the robot: its header is stamped some time before it publishes."""
    sent = np.arange(seconds * rate_hz) * (SECOND // rate_hz) + SECOND
    return Published("/camera/image", ROBOT, sent, ROBOT.wall(sent - age_ns), **more)


def arrivals(published: Published, least_ns: int, *, lost: Sequence[int] = (), seed: int = 7) -> np.ndarray:
    """Return true times of reception: the least way and an exponential rest, -1 where lost."""
    draw = np.random.default_rng(seed)
    arrived = published.sent_ns + least_ns + draw.exponential(least_ns / 3, len(published.sent_ns)).astype(np.int64)
    arrived[list(lost)] = -1
    return arrived
