"""The ping role: sends on an open-loop schedule, stamps T1 and T2, and waits for late replies at the end."""

from __future__ import annotations

import math
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import replace
from statistics import median
from typing import Any, Generic, Protocol, TypeAlias, TypeVar

from dds_trace.base.units import SECOND_NS
from dds_trace.tracefile.format.descriptions import Run
from dds_trace.tracefile.format.json_fields import Json, JsonObject
from dds_trace.tracefile.writing.sink import TraceSink

from ..applied.applied import Traffic
from ..backends.node import Node
from ..backends.other_side import Strangers
from ..errors import RelayLostError
from ..host.clock import Clock, SystemClock, sharpen_sleep
from ..host.process import start_thread_use, tuned_gc
from ..payloads.base import Feed
from ..payloads.stamp import NO_RELAYS, NO_REPLY, PROBE_RUN_ID, SentT
from .lanes import Clients, Lane, open_lane
from .plan import RunPlan
from .progress import PingProgress, Replies, Silence
from .relay import UNSTAMPED

ReceivedT = TypeVar("ReceivedT")

LEAD_NS = SECOND_NS // 20
"""Time from the end of the preparations to the first planned send."""
PROBE_PERIODS_NS = tuple(SECOND_NS // part for part in (10, 5, 5, 2, 2, 1))
"""Times between readiness probes, which are as large as the messages and must not queue up; the last one repeats."""
QUICK_PROBES, QUICK_NS = 60, SECOND_NS // 20
"""First probes for several relays and their period: when each one is met is known as well."""
SETTLE_NS = SECOND_NS // 5
"""Silence after the last echo of a probe before the run may start."""
DRAIN_NS = 2 * SECOND_NS
"""Silence after which missing replies count as lost, or twice the longest round trip."""
LONGEST_DRAIN_NS = 60 * SECOND_NS
"""Longest wait for missing replies, unless the sending took longer."""
LONGEST_SETTLE_NS = 5 * SECOND_NS
"""Longest wait for echoes to cease once enough relays have echoed."""
GIVE_UP_S = 2.0
"""Time for hopeless work to return, then for it to return after it was interrupted."""
LONGEST_BLOCK_NS = 60 * SECOND_NS
"""Longest time in which the middleware takes no message, where no schedule says when the last one is due."""
POLL_NS = SECOND_NS // 50
MAX_RELAYS = 64
MAX_PENDING = 4096
"""Most replies that wait until their relay is met; the oldest are dropped."""
MEETING_NS = SECOND_NS
"""Shortest time between two probes within a run, which meet relays that came later."""
T1, T2 = 1, 2
UNSENT = "reply to a message that was not sent"
UNMET = "reply of a relay that did not answer a probe"
UNNAMED = "reply that names no relay"


class Record(Protocol):
    def __call__(
        self,
        stage: int,
        run_id: int,
        sequence: int,
        monotonic_ns: int,
        scheduled_ns: int,
        source_ns: int,
        received_ns: int,
        payload_bytes: int,
        relay_id: int,
        /,
    ) -> None: ...


AnyPing: TypeAlias = "Ping[Any, Any]"


def open_ping(node: Node, plan: RunPlan, clock: Clock | None = None) -> AnyPing:
    return Ping(open_lane(node, plan.serialization), plan, node.strangers, clock)


class Ping(Generic[SentT, ReceivedT]):
    """One run: `wait_for_echo`, `run`, `close`; the node's thread calls `_receive`."""

    def __init__(
        self, lane: Lane[SentT, ReceivedT], plan: RunPlan, strangers: Strangers, clock: Clock | None = None
    ) -> None:
        self.plan = plan
        self.run_id = secrets.randbits(64) or 1
        self._clock = clock or SystemClock()
        self._now = self._clock.monotonic_ns
        data_type = plan.payload.data_type
        self._lane = lane
        form = lane.form_of(data_type)
        self._stamps = form.stamp
        self._bytes_of = form.payload_bytes_of if plan.reply_bytes is None else form.whole_bytes_of
        self._messages = [lane.message_of(data_type, message) for message in plan.payload.messages]

        self._nonce = secrets.randbits(63)  # of the first probe
        self._nonces: dict[int, int] = {}  # of a probe -> time of sending
        self._opened_ns = self._now()
        self._met: dict[int, tuple[int, int]] = {}  # relay -> when it first sent a probe back, and probes it had missed
        self._pending: deque[tuple[int, int, int, int, int, int]] = deque(maxlen=MAX_PENDING)  # replies of others
        self._probed_ns = 0  # of the latest probe within the run
        self._probing_ns = 0  # while a probe is being sent
        self._strangers = strangers
        self._echoed_ns = 0
        self._first_echo_ns = 0  # from the first probe on
        self._longest_echo_ns = 0
        self._record: Record = lambda *_event: None
        self._replies = Replies(plan.total)
        self._published = 0
        self._began_ns = self._sent_ns = 0  # of the run: its start, and the end of sending
        self._sender: JsonObject = {}  # processor time of its thread until then
        self._ended = False  # missing replies count as lost

        self._subscription = lane.create_subscription(
            data_type.relay_topic, data_type.type_name, self._receive, plan.qos
        )
        self._publisher = Clients(
            [lane.create_publisher(data_type.topic, data_type.type_name, plan.qos) for _ in range(plan.clients)]
        )

    def close(self) -> None:
        self._publisher.close()
        self._subscription.close()

    def _receive(self, message: ReceivedT, source_ns: int = 0, received_ns: int = 0, /) -> None:
        receive_ns = self._now()
        try:
            stamp = self._stamps.read(message)
            payload_bytes = 0 if stamp is None else self._bytes_of(message)
        except Exception:  # noqa: BLE001 - whatever a peer sends costs only its message
            stamp = None
        if stamp is None:
            self._strangers.count(UNSTAMPED)
            return
        run_id, sequence, relay_id = stamp
        if relay_id in NO_RELAYS:
            self._strangers.count(UNNAMED)
            return
        if run_id != self.run_id:
            if run_id == PROBE_RUN_ID and sequence in self._nonces:
                self._first_echo_ns = self._first_echo_ns or receive_ns - self._nonces[self._nonce]
                self._echoed_ns = receive_ns
                self._longest_echo_ns = max(self._longest_echo_ns, receive_ns - self._nonces[sequence])
                self.meet(relay_id, sequence - self._nonce)
            return
        replies = self._replies
        if sequence >= self.plan.total or not replies.publish_ns[sequence]:
            self._strangers.count(UNSENT)
            return
        if relay_id not in self._met:
            if len(self._pending) == MAX_PENDING:
                self._strangers.count(UNMET)
            self._pending.append((relay_id, sequence, receive_ns, source_ns, received_ns, payload_bytes))
            return
        self._record(T2, run_id, sequence, receive_ns, 0, source_ns, received_ns, payload_bytes, relay_id)
        replies.note(sequence, relay_id, receive_ns)

    def meet(self, relay_id: int, missed: int = 0) -> None:
        """Accept the replies of a relay that has echoed a probe after the `missed` first ones, also earlier ones."""
        if relay_id in self._met or len(self._met) >= MAX_RELAYS:
            return
        self._met[relay_id] = self._echoed_ns - self._opened_ns, missed
        for _ in range(len(self._pending)):
            waiting = self._pending.popleft()
            if waiting[0] != relay_id:
                self._pending.append(waiting)
                continue
            _, sequence, receive_ns, source_ns, received_ns, payload_bytes = waiting
            self._record(T2, self.run_id, sequence, receive_ns, 0, source_ns, received_ns, payload_bytes, relay_id)
            self._replies.note(sequence, relay_id, receive_ns)

    def _probe(self, number: int | None = None) -> None:
        message, nonce = self._messages[0], self._nonce + (len(self._nonces) if number is None else number)
        self._stamps.write(message, PROBE_RUN_ID, nonce)
        self._probing_ns = self._nonces[nonce] = self._now()
        self._publisher.publish(message)
        self._probing_ns = 0

    def _probe_others(self, now_ns: int) -> None:
        if now_ns - self._probed_ns >= MEETING_NS:
            self._probed_ns = now_ns
            self._probe()

    def wait_for_echo(self, timeout_s: float, stop: threading.Event, relays: int = 1) -> bool:
        """Send probes until enough relays echo and echoes have ceased; return whether that happened."""
        began_ns = next_ns = self._now()
        sent = 0
        while not stop.is_set():
            now_ns = self._now()
            if len(self._met) >= relays:
                has_waited_long = now_ns - began_ns > timeout_s * SECOND_NS + LONGEST_SETTLE_NS
                if now_ns - self._echoed_ns >= SETTLE_NS or has_waited_long:
                    return True
            elif now_ns - began_ns > timeout_s * SECOND_NS:
                return False
            elif now_ns >= next_ns and all(caller.is_matched() for caller in self._publisher.callers):
                self._probe()
                is_quick = relays > 1 and sent < QUICK_PROBES
                next_ns = now_ns + (QUICK_NS if is_quick else PROBE_PERIODS_NS[min(sent, len(PROBE_PERIODS_NS) - 1)])
                sent += 1
            self._clock.wait_until(now_ns + POLL_NS, stop)
        return False

    def is_own(self, run_id: int, sequence: int) -> bool:
        return run_id == self.run_id or (run_id == PROBE_RUN_ID and sequence in self._nonces)

    @property
    def probes(self) -> Traffic:
        return Traffic(len(self._nonces), 0, self.plan.payload.messages[0].payload_bytes)

    @property
    def traffic(self) -> Traffic:
        sizes = self._replies.payload_bytes[: self._published]
        return Traffic(self._published, self._replies.received, sum(sizes) // max(len(sizes), 1))

    @property
    def silence(self) -> Silence:
        replies, published = self._replies, self._published
        first = replies.highest + 1
        since_ns = replies.publish_ns[first] if first < published else self._now()
        until_ns = replies.publish_ns[published - 1] if self._ended and published else self._now()
        return Silence(published - first, max(until_ns - since_ns, 0), first, replies.received)

    @property
    def echoing_relays(self) -> int:
        return len(self._met)

    def run(self, sink: TraceSink, stop: threading.Event, hopeless: threading.Event | None = None) -> Run:
        """Send the plan and return the finished run; `stop` ends the sending, `hopeless` the wait for replies."""
        sink.write_run(self.plan.describe(self.run_id))
        self._record = sink.record
        sharpen_sleep()
        with tuned_gc():
            used, self._began_ns = start_thread_use(), self._now()
            self._send(sink, stop)
            self._sent_ns, self._sender = self._now(), {"sender": used()}
            self._drain(hopeless or threading.Event(), self._began_ns)
        return self.finish(sink)

    def finish(self, sink: TraceSink) -> Run:
        """Write the finished run, also while the thread is still sending."""
        if self._pending:
            self._strangers.count(UNMET, len(self._pending))
        self._published += self.blocked_ns > 0 and not self._probing_ns  # the middleware has it
        self._ended = True
        description = self.plan.describe(self.run_id)
        feed = self.plan.payload.feed
        skipped = {} if feed is None else {"skipped_messages": feed.skipped}
        matched = sorted(self._met.values())
        discovery: Json = {"matched_ns": [at_ns for at_ns, _ in matched], "missed": [missed for _, missed in matched]}
        if self.plan.is_timed:
            description = replace(description, planned_messages=max(self._published - self.plan.warmup, 0))
        calls = {"call": self._describe_calls()} if self._publisher.callers else {}
        ended_ns = self._sent_ns or self._now()
        finished = description.finished(
            self._published, ended_ns=ended_ns, discovery=discovery, **skipped, **calls, **self._sender
        )
        sink.write_run(finished)
        return finished

    def _describe_calls(self) -> JsonObject:
        described = [caller.describe() for caller in self._publisher.callers]
        names = dict.fromkeys(name for times in described for name in times)
        times_ns = {name: round(median(times[name] for times in described if name in times)) for name in names}
        timeout_s, measured = self.plan.call_timeout_s, slice(self.plan.warmup, self._published)
        in_time = self._replies.received_of(measured, timeout_s * SECOND_NS)
        timed_out = max(measured.stop - measured.start, 0) - in_time
        return {"timeout_s": timeout_s, "timed_out": timed_out, "first_ns": self._first_echo_ns, **times_ns}

    def _send(self, sink: TraceSink, stop: threading.Event) -> None:
        run_id, stamp = self.run_id, sink.stamp
        now, publish = self._now, self._publisher.publish
        write_second, write_nanoseconds = self._stamps.write_second, self._stamps.write_nanoseconds
        publish_times_ns, sizes = self._replies.publish_ns, self._replies.payload_bytes
        wall_offset_ns = self._clock.anchor().offset_ns
        feed = self.plan.payload.feed
        due = self._planned(stop) if feed is None else self._arriving(feed, stop)
        for sequence, (message, payload_bytes, scheduled_ns) in enumerate(due):
            sizes[sequence] = payload_bytes
            publish_times_ns[sequence] = before_ns = (
                now()
            )  # for a reply that arrives before the exact time is stored below
            second_ns = write_second(message, before_ns + wall_offset_ns) - wall_offset_ns
            # Recorded before the message leaves: a killed ping has T1 of every answered message.
            publish_ns = stamp(T1, run_id, sequence, scheduled_ns, 0, 0, payload_bytes)
            write_nanoseconds(message, publish_ns - second_ns)
            publish(message)
            publish_times_ns[sequence] = publish_ns
            self._published = sequence + 1
            if self._pending:
                self._probe_others(publish_ns)

    def _planned(self, stop: threading.Event) -> Iterator[tuple[SentT, int, int]]:
        plan, wait_until = self.plan, self._clock.wait_until
        sizes = [message.payload_bytes for message in plan.payload.messages]
        start_ns = self._now() + LEAD_NS
        for sequence in range(plan.total):
            position = sequence % len(sizes)
            message = self._messages[position]
            scheduled_ns = plan.scheduled_ns(start_ns, sequence)
            if plan.wake_ns and wait_until(scheduled_ns - plan.wake_ns, stop):
                self._probe(0)
            self._stamps.write(message, self.run_id, sequence, NO_REPLY if sequence % plan.ping_every else 0)
            if not wait_until(scheduled_ns, stop):
                return
            yield message, sizes[position], scheduled_ns

    def _arriving(self, feed: Feed, stop: threading.Event) -> Iterator[tuple[SentT, int, int]]:
        feed.begin()
        for sequence in range(self.plan.total):
            arrival = feed.take(stop)
            if arrival is None:
                return
            raw, arrival_ns = arrival
            message = self._lane.message_of(self.plan.payload.data_type, raw)
            self._stamps.write(message, self.run_id, sequence)
            yield message, raw.payload_bytes, arrival_ns

    @property
    def blocked_ns(self) -> int:
        """Return for how long the middleware has not taken the current message; 0 if none is being sent."""
        sequence = self._published
        since_ns = self._probing_ns or (self._replies.publish_ns[sequence] if sequence < self.plan.total else 0)
        return self._now() - since_ns if since_ns else 0

    @property
    def left_ns(self) -> int:
        """Return the time until all messages are due; without a schedule, until the current one is blocked for long."""
        if self.plan.payload.feed is None and not math.isinf(self.plan.rate_hz):
            return self.plan.scheduled_ns(self._began_ns or self._now(), self.plan.total) - self._now()
        return LONGEST_BLOCK_NS - self.blocked_ns

    @property
    def patience_ns(self) -> int:
        return max(DRAIN_NS, 2 * max(self._longest_echo_ns, self._replies.longest_rtt_ns))

    def _drain(self, hopeless: threading.Event, sending_ns: int) -> None:
        replies = self._replies
        began_ns = self._now()
        deadline_ns = began_ns + max(LONGEST_DRAIN_NS, began_ns - sending_ns)
        while not replies.are_complete(self.plan.pinged(self._published)) and not hopeless.is_set():
            quiet_ns = self._now() - max(began_ns, replies.last_ns)
            if quiet_ns > self.patience_ns or self._now() > deadline_ns:
                break
            if self._pending:
                self._probe_others(self._now())
            self._clock.wait_until(self._now() + POLL_NS, hopeless)

    def progress(self) -> PingProgress:
        replies = self._replies
        p50_ns, p99_ns = replies.percentiles_ns()
        received = replies.received
        expected = self.plan.pinged(self._published if self._ended else replies.highest + 1)
        lost = max(expected - received, 0)
        warmup = self.plan.pinged(self.plan.warmup)
        warmed_up = replies.received_of(slice(self.plan.warmup))
        return PingProgress(
            self._published if self.plan.is_timed else self.plan.total,
            self._published,
            received,
            lost,
            p50_ns,
            p99_ns,
            self.plan.warmup,
            warmed_up,
            max(min(expected, warmup) - warmed_up, 0),
        )


ResultT = TypeVar("ResultT")


class PingThread(Generic[ResultT]):
    """`work` of a ping on its own thread, which the middleware may block for ever.

    `work` gets two events: `enough` ends the sending, `hopeless` the wait for replies. Work that goes on after `hopeless` is
    interrupted, and at last left to itself: its thread is a daemon. It is `stuck` if the middleware took no message until long
    after the end.
    """

    def __init__(
        self,
        ping: AnyPing,
        work: Callable[[threading.Event, threading.Event], ResultT],
        interrupt: Callable[[], None],
        patience_s: float = 0.0,
    ) -> None:
        self.enough, self.hopeless = threading.Event(), threading.Event()
        self.stuck: RelayLostError | None = None
        self._ping = ping
        self._interrupt: Callable[[], None] | None = interrupt
        self._patience_ns = patience_s * SECOND_NS
        self._hopeless_s = 0.0
        self._future: Future[ResultT] = Future()
        self._has_ended = threading.Event()
        threading.Thread(target=self._run, args=(work,), name="ping", daemon=True).start()

    def _run(self, work: Callable[[threading.Event, threading.Event], ResultT]) -> None:
        try:
            self._future.set_result(work(self.enough, self.hopeless))
        except BaseException as error:  # noqa: BLE001 - `result` raises it
            self._future.set_exception(error)
        self._has_ended.set()

    def wait(self, seconds: float) -> bool:
        """Return whether it has ended, or is left to itself."""
        if self._has_ended.wait(seconds):
            return True
        self._look_if_stuck()
        if not self.hopeless.is_set():
            return False
        now_s = time.monotonic()
        self._hopeless_s = self._hopeless_s or now_s
        if self._interrupt is not None and now_s - self._hopeless_s > GIVE_UP_S:
            self._interrupt()
            self._interrupt = None
        return now_s - self._hopeless_s > 2 * GIVE_UP_S

    def _look_if_stuck(self) -> None:
        ping = self._ping
        blocked_ns, left_ns = ping.blocked_ns, 0 if self.enough.is_set() else ping.left_ns
        patience_ns = max(ping.patience_ns, 0 if self.enough.is_set() else self._patience_ns)
        if left_ns <= 0 and blocked_ns > patience_ns:
            self.stuck = self.stuck or RelayLostError(
                f"the relay of {ping.plan.payload.data_type.topic} is lost: it has not taken a message for "
                f"{blocked_ns / SECOND_NS:.1f} s; check the last output of the relay, and the link to it"
            )
            self.enough.set()
            self.hopeless.set()

    def result(self) -> ResultT | None:
        """Return the result, None of work that is left to itself; raise its exception."""
        return self._future.result() if self._has_ended.is_set() else None
