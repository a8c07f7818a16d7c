"""The ping role: sends on an open-loop schedule, stamps T1 and T2, and waits for late replies at the end."""

from __future__ import annotations

import secrets
import threading
from array import array
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from dds_trace.tracefile import Qos, Run

from ..backends.base import Serialization
from ..host.clock import SystemClock, sharpen_sleep
from ..host.steady import steady_interpreter
from ..payloads.stamp import PROBE_RUN_ID
from .progress import PingProgress, rtt_percentiles_ns

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from dds_trace.tracefile import TraceSink

    from ..backends.base import Node
    from ..host.clock import Clock
    from ..payloads.base import Feed, Payload

SECOND_NS = 1_000_000_000
LEAD_NS = SECOND_NS // 20
"""From the end of the preparations to the first planned send."""
PROBE_PERIODS_NS = (SECOND_NS // 10, SECOND_NS // 5, SECOND_NS // 2, SECOND_NS)
"""Between readiness probes; the last one repeats. They are as large as the messages, so they must not pile up."""
SETTLE_NS = SECOND_NS // 5
"""No echo of a probe for so long: the run may begin."""
DRAIN_NS = 2 * SECOND_NS
"""Without a reply for so long, or for twice the longest round trip, what is missing is given up."""
LOOK_NS = SECOND_NS // 50
T1, T2 = 1, 2


@dataclass(frozen=True, slots=True)
class RunPlan:
    """One run of a ping.

    Attributes:
        payload: what is sent.
        rate_hz: messages a second.
        messages: messages that count.
        warmup: messages sent before them on the same schedule, kept out of every statistic.
        extra: further fields for the trace's description of the run.
    """

    payload: Payload
    rate_hz: float
    messages: int
    warmup: int = 0
    qos: Qos = field(default_factory=Qos)
    serialization: Serialization = Serialization.RAW
    bridge: str = "none"
    relay_domain_id: int | None = None
    labels: Mapping[str, str] = field(default_factory=dict)
    extra: Mapping[str, Any] = field(default_factory=dict)

    @property
    def total(self) -> int:
        """Messages of the schedule, warm-up included."""
        return self.warmup + self.messages

    def scheduled_ns(self, start_ns: int, sequence: int) -> int:
        """T0 of message `sequence`: known before the run, whatever happens in it."""
        return start_ns + round(sequence * SECOND_NS / self.rate_hz)

    def describe(self, run_id: int) -> Run:
        """The trace's description of the run at its start."""
        return Run(
            run_id=run_id,
            data_type=self.payload.data_type.name,
            payload_bytes=self.payload.payload_bytes,
            rate_hz=self.rate_hz,
            planned_messages=self.messages,
            warmup_messages=self.warmup,
            bridge=self.bridge,
            relay_domain_id=self.relay_domain_id,
            serialization=self.serialization.value,
            qos=self.qos,
            labels=self.labels,
            extra=self.extra,
        )


class Ping:
    """One run on one node: `wait_for_echo`, then `run`, then `close`.

    Args:
        node: where to publish; its thread calls `_receive`.
        plan: what to send.
        clock: this device's time.
    """

    def __init__(self, node: Node, plan: RunPlan, clock: Clock | None = None) -> None:
        self.plan = plan
        self.run_id = secrets.randbits(64) or 1
        self._clock = clock or SystemClock()
        self._now = self._clock.monotonic_ns
        data_type, typed = plan.payload.data_type, plan.serialization is Serialization.TYPED
        self._stamps = data_type.stamps[plan.serialization]
        self._feed = plan.payload.feed
        self._messages = [
            node.message_from_cdr(data_type.type_name, message.data) if typed else message.data
            for message in plan.payload.messages
        ]

        self._nonces: dict[int, int] = {}  # of a probe -> when it was sent
        self._echoes: set[int] = set()  # relays that sent a probe back
        self._echoed_ns = 0
        self._longest_rtt_ns = 0  # probes included
        self._record: Any = None
        self._published = 0
        self._ended = False  # nothing that is missing will come any more
        self._publish_ns = array("q", bytes(8 * plan.total))
        self._payload_bytes = array("I", bytes(4 * plan.total))
        self._rtt_ns = array("q", bytes(8 * plan.total))  # of the first reply; 0 while there is none
        self._received = 0
        self._highest = -1
        self._last_reply_ns = 0
        self._replies: dict[int, int] = {}  # relay -> messages that it has answered
        self._answered: dict[int, bytearray] = {}  # relay -> a byte for each message, 1 if answered

        self._subscription = node.create_subscription(
            data_type.relay_topic, data_type.type_name, self._receive, qos=plan.qos, typed=typed
        )
        self._publisher = node.create_publisher(
            data_type.topic, data_type.type_name, qos=plan.qos, typed=typed
        )

    def close(self) -> None:
        """Take the endpoints off their topics."""
        self._publisher.close()
        self._subscription.close()

    def _receive(self, message: Any, source_ns: int = 0, received_ns: int = 0, /) -> None:
        receive_ns = self._now()
        stamp = self._stamps.read(message)
        if stamp is None:
            return
        run_id, sequence, relay_id = stamp
        if run_id != self.run_id or sequence >= self.plan.total:
            if run_id == PROBE_RUN_ID and sequence in self._nonces:
                self._echoed_ns = receive_ns
                self._echoes.add(relay_id)
                self._longest_rtt_ns = max(self._longest_rtt_ns, receive_ns - self._nonces[sequence])
            return
        self._record(
            T2,
            run_id,
            sequence,
            receive_ns,
            0,
            source_ns,
            received_ns,
            self._payload_bytes[sequence],
            relay_id,
        )
        answered = self._answered.get(relay_id)
        if answered is None:
            answered = self._answered[relay_id] = bytearray(self.plan.total)
            self._replies[relay_id] = 0
        if not answered[sequence]:
            answered[sequence] = 1
            self._replies[relay_id] += 1
        if not self._rtt_ns[sequence]:
            self._rtt_ns[sequence] = rtt_ns = receive_ns - self._publish_ns[sequence]
            self._longest_rtt_ns = max(self._longest_rtt_ns, rtt_ns)
            self._received += 1
            self._highest = max(self._highest, sequence)
        self._last_reply_ns = receive_ns

    def wait_for_echo(self, timeout_s: float, stop: threading.Event, relays: int = 1) -> bool:
        """Send probes until so many relays have sent one back and all is quiet again.

        Returns:
            False if that did not happen in `timeout_s`, or `stop` was set.
        """
        began_ns = next_ns = self._now()
        message, nonce, sent = self._messages[0], secrets.randbits(63), 0
        while not stop.is_set():
            now_ns = self._now()
            if len(self._echoes) >= relays:
                if now_ns - self._echoed_ns >= SETTLE_NS:
                    return True
            elif now_ns - began_ns > timeout_s * SECOND_NS:
                return False
            elif now_ns >= next_ns:
                self._stamps.write(message, PROBE_RUN_ID, nonce + sent)
                self._nonces[nonce + sent] = now_ns
                self._publisher.publish(message)
                next_ns = now_ns + PROBE_PERIODS_NS[min(sent, len(PROBE_PERIODS_NS) - 1)]
                sent += 1
            self._clock.wait_until(now_ns + LOOK_NS, stop)
        return False

    @property
    def echoing_relays(self) -> int:
        """Relays that have sent a probe back."""
        return len(self._echoes)

    def run(self, sink: TraceSink, stop: threading.Event) -> Run:
        """Send the plan on this thread and collect the replies; the run as it was finished.

        Args:
            sink: where events and the run's description go.
            stop: ends the sending early; replies are waited for all the same.
        """
        description = self.plan.describe(self.run_id)
        sink.write_run(description)
        self._record = sink.record
        sharpen_sleep()
        with steady_interpreter():
            self._send(stop)
            self._drain()
        self._ended = True
        finished = description.finished(
            self._published, **({} if self._feed is None else {"skipped_messages": self._feed.skipped})
        )
        sink.write_run(finished)
        return finished

    def _send(self, stop: threading.Event) -> None:
        run_id, record, now = self.run_id, self._record, self._now
        stamps, publish = self._stamps, self._publisher.publish
        wall_offset_ns = self._clock.anchor().offset_ns
        due = self._planned(stop) if self._feed is None else self._arriving(self._feed, stop)
        for sequence, (message, payload_bytes, scheduled_ns) in enumerate(due):
            self._payload_bytes[sequence] = payload_bytes
            self._publish_ns[sequence] = publish_ns = now()
            stamps.write_time(message, publish_ns + wall_offset_ns)
            publish(message)
            record(T1, run_id, sequence, publish_ns, scheduled_ns, 0, 0, payload_bytes, 0)
            self._published = sequence + 1

    def _planned(self, stop: threading.Event) -> Iterator[tuple[Any, int, int]]:
        """Each message with its bytes and T0, stamped, at the instant that the schedule planned for it."""
        plan, wait_until = self.plan, self._clock.wait_until
        sizes = [message.payload_bytes for message in plan.payload.messages]
        start_ns = self._now() + LEAD_NS
        for sequence in range(plan.total):
            position = sequence % len(sizes)
            message = self._messages[position]
            scheduled_ns = plan.scheduled_ns(start_ns, sequence)
            self._stamps.write(message, self.run_id, sequence)
            if not wait_until(scheduled_ns, stop):
                return
            yield message, sizes[position], scheduled_ns

    def _arriving(self, feed: Feed, stop: threading.Event) -> Iterator[tuple[Any, int, int]]:
        """Likewise for messages of a live source: T0 is when each arrived here."""
        feed.begin()
        for sequence in range(self.plan.total):
            arrival = feed.take(stop)
            if arrival is None:
                return
            message, arrival_ns = arrival
            self._stamps.write(message.data, self.run_id, sequence)
            yield message.data, message.payload_bytes, arrival_ns

    def _drain(self) -> None:
        began_ns, patience = self._now(), threading.Event()  # a wait that nobody cuts short
        while not self._all_answered():
            quiet_ns = self._now() - max(began_ns, self._last_reply_ns)
            if quiet_ns > max(DRAIN_NS, 2 * self._longest_rtt_ns):
                break
            self._clock.wait_until(self._now() + LOOK_NS, patience)

    def _all_answered(self) -> bool:
        """Whether every relay that has answered anything has answered everything."""
        counts = list(self._replies.values())
        return self._published == 0 or (bool(counts) and min(counts) >= self._published)

    def progress(self) -> PingProgress:
        """How far the run is; may be called from any thread."""
        p50_ns, p99_ns = rtt_percentiles_ns(self._rtt_ns)
        received = self._received
        expected = self._published if self._ended else self._highest + 1
        lost = max(expected - received, 0)
        return PingProgress(self.plan.total, self._published, received, lost, p50_ns, p99_ns)

    @property
    def relay_ids(self) -> tuple[int, ...]:
        """Relays that have answered a message of the run."""
        return tuple(self._replies)
