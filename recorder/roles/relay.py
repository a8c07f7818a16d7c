"""The relay role: sends every stamped message of all pings back, and stamps T3 and T4."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable
from typing import Any, TypeAlias, TypeVar, cast

from dds_trace.tracefile.format.descriptions import Qos
from dds_trace.tracefile.writing.packing import ExpectedPair
from dds_trace.tracefile.writing.sink import TraceSink

from ..applied.applied import Traffic
from ..backends.node import Node, Publisher, RawMessage, Receive
from ..choices import Serialization
from ..host.clock import Clock, SystemClock
from ..payloads.base import DataType, Form
from ..payloads.stamp import NO_REPLY, PROBE_RUN_ID, RawStampPlace, SentT
from .lanes import Lane, open_lane
from .progress import RelayProgress

ReceivedT = TypeVar("ReceivedT")

T3, T4 = 3, 4
UNSTAMPED = "message without a whole stamp"
_Forecast: TypeAlias = "tuple[bytes, int, ExpectedPair, int, int, int]"
"""An expected message: its bytes from the stamp on, its length, its events, run, sequence and payload bytes."""
RECENT_RUNS = 1000


class Relay:
    """The relay of `data_types` on a node; its thread does all the work.

    `relay_id`, not 0, is in every reply; `on_probe` is called after the reply to each readiness probe, `on_relayed` with run,
    sequence, T3 and T4 after any other. Messages that are `is_own` by run and sequence, or want none, get none.
    """

    def __init__(
        self,
        node: Node,
        sink: TraceSink,
        relay_id: int,
        *,
        data_types: Iterable[DataType],
        qos: Qos,
        serialization: Serialization = Serialization.RAW,
        clock: Clock | None = None,
        on_probe: Callable[[], None] | None = None,
        is_own: Callable[[int, int], bool] | None = None,
        on_relayed: Callable[[int, int, int, int], None] | None = None,
    ) -> None:
        self.relay_id = relay_id
        self.topics: list[str] = []
        self._sink = sink
        self._clock = clock or SystemClock()
        self._relayed = 0
        self._runs = 0
        self._last_run = PROBE_RUN_ID
        self._recent_runs: dict[int, bool] = {}  # the one with the latest message last
        self._payload_bytes = 0  # of all messages relayed
        self._foreign = 0
        self._strangers = node.strangers
        self._on_probe = on_probe or (lambda *_: None)
        self._is_own = is_own or (lambda *_: False)
        self._on_relayed = on_relayed or (lambda *_: None)
        self._forecasts = on_relayed is None
        self._closers: list[Callable[[], None]] = []
        self._serve(open_lane(node, serialization), data_types, qos)

    def _serve(self, lane: Lane[SentT, ReceivedT], data_types: Iterable[DataType], qos: Qos) -> None:
        for data_type in data_types:
            publisher = lane.create_publisher(data_type.relay_topic, data_type.type_name, qos)
            receive = self._receiver(lane.form_of(data_type), publisher)
            subscription = lane.create_subscription(data_type.topic, data_type.type_name, receive, qos)
            self._closers += [subscription.close, publisher.close]
            self.topics += [data_type.topic, data_type.relay_topic]

    def close(self) -> None:
        for close in self._closers:
            close()

    def _receiver(self, form: Form[SentT, ReceivedT], publisher: Publisher[SentT]) -> Receive[ReceivedT]:
        make_reply, read, payload_bytes_of = form.stamp.reply, form.stamp.read, form.payload_bytes_of
        now, publish = self._clock.monotonic_ns, publisher.publish
        record, record_and_stamp, stages = self._sink.record, self._sink.record_and_stamp, (T3, T4)
        relay_id, relay_id_text = self.relay_id, b"%08x" % self.relay_id
        on_probe, is_own, on_relayed = self._on_probe, self._is_own, self._on_relayed

        record_expected, forecast_of = self._sink.record_expected, self._forecaster(form)
        begin_at = 0 if form.sizing_bytes_of is None else cast("RawStampPlace", form.stamp).begin_at
        forecast: _Forecast | None = None

        # T3 and T4 are recorded before the reply leaves, so a killed relay has both of every reply; the time between
        # them is subtracted from the latency. The next message of the run is prepared after the reply.
        def receive(message: Any, source_ns: int = 0, received_ns: int = 0, /) -> None:
            nonlocal forecast
            relay_in_ns = now()
            if forecast is not None:
                begin, message_bytes, expected, run_id, sequence, size = forecast
                if message.startswith(begin, begin_at) and len(message) == message_bytes:
                    reply = make_reply(message, relay_id_text)
                    if reply is not None and record_expected(expected, relay_in_ns, source_ns, received_ns):
                        publish(reply)
                        self._relayed += 1
                        self._payload_bytes += size
                        forecast = forecast_of(message, run_id, sequence + 1, size)
                        return
            try:
                stamp = read(message)
                size = 0 if stamp is None else payload_bytes_of(message)
                reply = None if stamp is None else make_reply(message, relay_id_text)
            except Exception:  # noqa: BLE001 - whatever a peer sends costs only its message
                stamp = reply = None
            if stamp is None or reply is None:
                self._foreign += 1
                self._strangers.count(UNSTAMPED)
                return
            run_id, sequence, relay_mark = stamp
            if is_own(run_id, sequence):
                return
            if relay_mark == NO_REPLY:
                record(T3, run_id, sequence, relay_in_ns, 0, source_ns, received_ns, size, relay_id)
                self._note(run_id, size)
                return
            if run_id == PROBE_RUN_ID:
                publish(reply)
                on_probe()
                return
            relay_out_ns = record_and_stamp(
                stages, run_id, sequence, relay_in_ns, source_ns, received_ns, size, relay_id
            )
            publish(reply)
            on_relayed(run_id, sequence, relay_in_ns, relay_out_ns)
            self._note(run_id, size)
            forecast = forecast_of(message, run_id, sequence + 1, size)

        return receive

    def _forecaster(self, form: Form[SentT, ReceivedT]) -> Callable[[Any, int, int, int], _Forecast | None]:
        sizing_bytes_of = form.sizing_bytes_of
        if sizing_bytes_of is None or not self._forecasts:
            return lambda *_: None
        begin_of = cast("RawStampPlace", form.stamp).begin_of
        expect, relay_id = self._sink.expect, self.relay_id

        def forecast_of(message: RawMessage, run_id: int, sequence: int, size: int) -> _Forecast | None:
            expected = expect((T3, T4), run_id, sequence, size, relay_id)
            if expected is None:
                return None
            try:
                begin = begin_of(message, run_id, sequence, sizing_bytes_of(message))
            except struct.error:  # cut short by its sender
                return None
            return begin, len(message), expected, run_id, sequence, size

        return forecast_of

    def _note(self, run_id: int, size: int) -> None:
        """Count a message, and a new run; forget the run with the oldest last message."""
        self._relayed += 1
        self._payload_bytes += size
        if run_id == self._last_run:
            return
        self._last_run = run_id
        if not self._recent_runs.pop(run_id, False):
            self._runs += 1
            if len(self._recent_runs) >= RECENT_RUNS:
                del self._recent_runs[next(iter(self._recent_runs))]
        self._recent_runs[run_id] = True

    @property
    def traffic(self) -> Traffic:
        count = self._relayed
        return Traffic(count, count, self._payload_bytes // max(count, 1))

    def progress(self) -> RelayProgress:
        return RelayProgress(self._relayed, self._runs, self._foreign)
