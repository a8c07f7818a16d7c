"""The relay role: sends every stamped message back, stamps T3 and T4; serves all runs of all pings."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..backends.base import Serialization
from ..host.clock import SystemClock
from ..payloads.stamp import PROBE_RUN_ID
from .progress import RelayProgress

if TYPE_CHECKING:
    from collections.abc import Iterable

    from dds_trace.tracefile import Qos, TraceSink

    from ..backends.base import Node, Publisher, Receive
    from ..host.clock import Clock
    from ..payloads.base import DataType

T3, T4 = 3, 4


class Relay:
    """Serves `data_types` on a node from its start until `close`.

    Args:
        node: where to subscribe and publish; its thread does all the work.
        sink: where events go.
        relay_id: put into every reply, not 0.
        data_types: whose topics are served, all at once.
        qos: of both ways; must suit the pings (see `dds_trace.recorder.backends.qos`).
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
    ) -> None:
        self.relay_id = relay_id
        self.topics: list[str] = []
        self._sink = sink
        self._clock = clock or SystemClock()
        self._runs: dict[int, int] = {}  # run -> messages relayed
        self._foreign = 0
        self._endpoints = []
        typed = serialization is Serialization.TYPED
        for data_type in data_types:
            publisher = node.create_publisher(
                data_type.relay_topic, data_type.type_name, qos=qos, typed=typed
            )
            receive = self._receiver(data_type, serialization, publisher)
            subscription = node.create_subscription(
                data_type.topic, data_type.type_name, receive, qos=qos, typed=typed
            )
            self._endpoints += [subscription, publisher]
            self.topics += [data_type.topic, data_type.relay_topic]

    def close(self) -> None:
        """Take the endpoints off their topics."""
        for endpoint in self._endpoints:
            endpoint.close()

    def _receiver(self, data_type: DataType, serialization: Serialization, publisher: Publisher) -> Receive:
        stamps, payload_bytes_of = data_type.stamps[serialization], data_type.payload_bytes_of[serialization]
        now, publish, record = self._clock.monotonic_ns, publisher.publish, self._sink.record
        relay_id, relay_id_text, runs = self.relay_id, b"%08x" % self.relay_id, self._runs

        # What can wait until the reply is on its way does: T4 - T3 is taken off the latency, but it is also
        # time in which the next message waits.
        def receive(message: Any, source_ns: int = 0, received_ns: int = 0, /) -> None:
            relay_in_ns = now()
            reply = stamps.reply(message, relay_id_text)
            if reply is None:
                self._foreign += 1
                return
            relay_out_ns = now()
            publish(reply)
            stamp = stamps.read(reply)
            if stamp is None or stamp.run_id == PROBE_RUN_ID:
                return
            run_id, sequence, _ = stamp
            size = payload_bytes_of(reply)
            record(T3, run_id, sequence, relay_in_ns, 0, source_ns, received_ns, size, relay_id)
            record(T4, run_id, sequence, relay_out_ns, 0, 0, 0, size, relay_id)
            runs[run_id] = runs.get(run_id, 0) + 1

        return receive

    def progress(self) -> RelayProgress:
        """What was done so far; may be called from any thread."""
        counts = list(self._runs.values())
        return RelayProgress(sum(counts), len(counts), self._foreign)
