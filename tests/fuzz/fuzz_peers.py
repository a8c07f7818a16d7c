"""Target `peers`: bytes of a peer on TCP, on UDP, and as a message of any backend to a relay and to a ping.

Whatever comes, nothing is raised but the end of that connection, and the next good message is answered.
"""

import json
import socket
import struct
import weakref
from contextlib import suppress
from pathlib import Path

from fake_clock import FakeClock
from fake_node import FakeNode, ListSink
from fuzz_shapes import shaped, shaped_seeds

from dds_trace.base.threads import FastLock
from dds_trace.recorder.backends.other_side import Strangers
from dds_trace.recorder.backends.socket.greeting import Greeting, PeerError
from dds_trace.recorder.backends.socket.tcp import _TcpPeer
from dds_trace.recorder.backends.socket.udp import MAX_UNFINISHED, UdpLinks, _UdpPeer
from dds_trace.recorder.payloads import data_types
from dds_trace.recorder.roles.ping import open_ping
from dds_trace.recorder.roles.plan import RunPlan
from dds_trace.recorder.roles.relay import Relay
from dds_trace.tracefile.format.descriptions import Qos

KNOWN, UNKNOWN = ("127.0.0.1", 9), ("127.0.0.1", 10)
RELAY = 0xBEEF


class Target:
    def __init__(self, folder: Path) -> None:
        del folder
        self._shapes = (self._tcp, self._udp, self._relay, self._ping)
        self._links = UdpLinks(Greeting("me"), ("127.0.0.1", 0), (), {"a": (lambda _: None,)}, Strangers())
        weakref.finalize(self, self._links.close)  # an open socket would warn in whichever test runs then
        self._links._peers[KNOWN] = _UdpPeer()
        self._clock = FakeClock()
        self._node = FakeNode()
        self._sink = ListSink(self._clock)
        Relay(self._node, self._sink, RELAY, data_types=data_types().values(), qos=Qos(), clock=self._clock)
        self._imu = data_types()["imu"]
        self._pinging = FakeNode()
        self._ping_role = open_ping(self._pinging, RunPlan(self._imu.make(None, 1), 10.0, 5), self._clock)

    def seeds(self) -> dict[str, bytes]:
        greeting = json.dumps({"name": "x", "subscriptions": {"a": "b"}, "publishers": {}}).encode()
        message = self._good("imu", 7, 1)
        return shaped_seeds(
            self._shapes,
            {
                self._tcp: struct.pack("<IH", len(greeting), 0) + greeting + struct.pack("<IH", 1, 1) + b"ab",
                self._udp: struct.pack("<IHHH", 1, 0, 1, 0) + greeting,
                self._relay: message,
                self._ping: message,
            },
        )

    def try_input(self, data: bytes) -> None:
        shaped(self._shapes, data)

    def _good(self, name: str, run_id: int, sequence: int) -> bytes:
        data_type = data_types()[name]
        data = data_type.make(None, 1).messages[0].data
        data_type.raw.stamp.write(data, run_id, sequence)
        return bytes(data)

    def _tcp(self, data: bytes) -> None:
        here, there = socket.socketpair()
        with here, there:
            there.sendall(data)
            there.shutdown(socket.SHUT_WR)
            peer = _TcpPeer(here, lambda _peer, size: size < 1 << 20, is_chosen=False)
            with suppress(PeerError):
                peer.read({"a": (lambda _: None,)}, FastLock())

    def _udp(self, data: bytes) -> None:
        for address in (KNOWN, UNKNOWN):
            self._links._take(memoryview(data), address)
        unfinished = self._links._peers[KNOWN].unfinished
        assert len(unfinished) <= MAX_UNFINISHED
        held = sum(len(part) for parts in unfinished.values() for part in parts.values())
        assert self._links._unfinished_bytes == held
        assert UNKNOWN not in self._links._peers

    def _relay(self, data: bytes) -> None:
        for name, data_type in data_types().items():
            for message in (data, bytearray(data)):
                self._node.deliver(data_type.topic, message)
            self._sink.events.clear()
            self._node.deliver(data_type.topic, self._good(name, 7, 1))
            assert [event[0] for event in self._sink.events] == [3, 4]
            self._node.publishers[data_type.relay_topic].sent.clear()

    def _ping(self, data: bytes) -> None:
        self._pinging.deliver(self._imu.relay_topic, data)
        assert self._ping_role.progress().received == 0
