"""The capturing process: `python -m dds_trace.extensions.wire.process OPTIONS`, which never delays a role.

It answers each line of JSON on standard input by one on standard output, and ends when standard input closes:

    {"ask": "begin", "run_id": "16 hex digits, or empty"}  ->  {}
    {"ask": "take"}  ->  the run's `WireCounts`, with `row_bytes`, followed by that many bytes of MESSAGE_ROW

First it writes `{}`, or `{"error": "..."}` and ends.
"""

from __future__ import annotations

import json
import os
import select
import sys
import time
from collections.abc import Mapping
from contextlib import ExitStack, closing, suppress
from dataclasses import asdict, dataclass
from typing import Any

from dds_trace.base.errors import TraceError
from dds_trace.base.records import from_json
from dds_trace.recorder.host.clock import read_together
from dds_trace.recorder.kernel.counters import InterfaceCounters, read_interfaces, read_kernel_counters, since

from .capture import WireOptions
from .counts import (
    TCP_COUNTERS,
    ClosedConnections,
    InterfaceCount,
    TcpConnection,
    WireCounts,
    ip_counts,
    read_connections,
)
from .format import MessageRows
from .messages import count_repeats
from .packet_filter import wire_program
from .ring import PacketRing, RingStatistics
from .tally import WireTally

NICENESS = 5
"""The capture yields to the roles, as does SCHED_BATCH; much nicer, it would starve for longer than the ring lasts."""
TCP_EVERY_NS = 1_000_000_000
"""Connections are read this often, also because one may close before the run's end."""


@dataclass(slots=True)
class _Before:
    run_id: str
    begin_ns: int
    cpu_s: float
    kernel: Mapping[str, int]
    interfaces: Mapping[str, InterfaceCounters]
    tcp: dict[int, TcpConnection]


class Capture:
    def __init__(self, options: WireOptions) -> None:
        self._options = options
        self._tally = WireTally(options.rtps_ports)
        self._tcp: dict[int, TcpConnection] = {}
        self._tcp_read_ns = 0
        program = wire_program(options.udp_ports, options.tcp_ports)
        with ExitStack() as opened:
            self._closed: ClosedConnections | None = None
            if options.tcp_ports:
                self._closed = opened.enter_context(closing(ClosedConnections(options.tcp_ports)))
            sizes = {"ring_bytes": options.ring_bytes, "block_timeout_ms": options.block_timeout_ms}
            rings = (PacketRing(interface, program, **sizes) for interface in options.interfaces)
            self._rings = [opened.enter_context(closing(ring)) for ring in rings]
            self._resources = opened.pop_all()
        self._before = self._now("")
        self._read_tcp()

    def begin(self, run_id: str) -> None:
        self._catch_up()
        self._statistics()
        self._tally.begin()
        self._tcp.clear()  # of earlier connections
        self._read_tcp()
        self._before = self._now(run_id)

    def take(self) -> tuple[WireCounts, MessageRows]:
        self._catch_up()
        self._read_tcp()
        before, now = self._before, self._now("")
        statistics = self._statistics()
        rows = self._tally.take_rows(int(before.run_id, 16) if before.run_id else None)
        run = self._tally.run
        counts = WireCounts(
            run_id=before.run_id,
            interfaces=self._options.interfaces,
            begin_ns=before.begin_ns,
            end_ns=now.begin_ns,
            classes=tuple(count for _, count in sorted(run.classes.items()) if count.packets or count.bytes),
            repeats=count_repeats(rows),
            messages=len(rows),
            sample_bytes=int(rows["sample_bytes"].sum()),
            requests=run.requests,
            heartbeat_gap_p50_ns=run.heartbeat_gap_p50_ns,
            **self._tally.beginnings,
            ip=ip_counts(now.kernel, before.kernel),
            tcp=tuple(
                since(connection, before.tcp.get(cookie), *TCP_COUNTERS)
                for cookie, connection in sorted(self._tcp.items())
            ),
            tcp_again_bytes=run.tcp_again_bytes,
            interface_counts=tuple(
                InterfaceCount(name, **asdict(since(now.interfaces[name], before.interfaces.get(name))))
                for name in self._options.interfaces
                if name in now.interfaces
            ),
            foreign_packets=run.foreign_packets,
            unseen_headers=run.unseen_headers,
            unfollowed_datagrams=self._tally.unfollowed_datagrams,
            late_repeats=self._tally.late_repeats,
            kernel_drops=statistics.drops,
            kernel_freezes=statistics.freezes,
            packets=run.packets,
            cpu_s=now.cpu_s - before.cpu_s,
        )
        return counts, rows

    def serve(self) -> None:
        poll = select.poll()
        # Not the rings: a large flow fills a block every few milliseconds, and each wake-up takes CPU from the roles.
        if self._closed:
            poll.register(self._closed.fileno(), select.POLLIN)
        poll.register(sys.stdin.fileno(), select.POLLIN)
        buffered = b""
        while True:
            ready = {descriptor for descriptor, _ in poll.poll(self._options.block_timeout_ms)}
            self._drain()
            if self._closed:
                self._tcp |= self._closed.read()
            if time.monotonic_ns() - self._tcp_read_ns > TCP_EVERY_NS:
                self._read_tcp()
            if sys.stdin.fileno() not in ready:
                continue
            data = os.read(sys.stdin.fileno(), 65536)
            if not data:
                return
            *lines, buffered = (buffered + data).split(b"\n")
            for line in lines:
                self._answer(json.loads(line))

    def close(self) -> None:
        self._resources.close()

    def _answer(self, question: dict[str, Any]) -> None:
        if question["ask"] == "begin":
            self.begin(question["run_id"])
            write_answer({})
        else:
            counts, rows = self.take()
            write_answer({**counts.to_dict(), "row_bytes": rows.nbytes}, rows.tobytes())

    def _drain(self) -> None:
        for ring in self._rings:
            batch = ring.read()
            if len(batch):
                monotonic_ns, wall_ns = read_together(time.time_ns)
                since_wall_ns = monotonic_ns - wall_ns
                self._tally.add(batch, ring.interface, is_loopback=ring.is_loopback, wall_to_monotonic_ns=since_wall_ns)
            ring.release()

    def _catch_up(self) -> None:
        until_ns = time.monotonic_ns() + (2 * self._options.block_timeout_ms + 50) * 1_000_000
        while (left_ns := until_ns - time.monotonic_ns()) > 0:
            time.sleep(min(left_ns, self._options.block_timeout_ms * 1_000_000) / 1e9)
            self._drain()

    def _statistics(self) -> RingStatistics:
        statistics = [ring.statistics() for ring in self._rings]
        return RingStatistics(
            *(sum(getattr(ring, name) for ring in statistics) for name in ("packets", "drops", "freezes"))
        )

    def _read_tcp(self) -> None:
        self._tcp_read_ns = time.monotonic_ns()
        if self._closed:
            self._tcp |= read_connections(self._options.tcp_ports)
            self._tcp |= self._closed.read()

    def _now(self, run_id: str) -> _Before:
        return _Before(
            run_id, time.monotonic_ns(), time.process_time(), read_kernel_counters(), read_interfaces(), dict(self._tcp)
        )


def write_answer(answer: dict[str, Any], rows: bytes = b"") -> None:
    sys.stdout.buffer.write(json.dumps(answer).encode() + b"\n" + rows)
    sys.stdout.buffer.flush()


def main() -> None:
    options = from_json(WireOptions, json.loads(sys.argv[1]))
    os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))  # also if the role has a real-time priority
    os.nice(NICENESS)
    if options.cpus:
        os.sched_setaffinity(0, options.cpus)
    try:
        capture = Capture(options)
    except TraceError as err:
        write_answer({"error": str(err)})
        return
    try:
        write_answer({})
        with suppress(BrokenPipeError):  # the recorder is gone
            capture.serve()
    finally:
        capture.close()


if __name__ == "__main__":
    main()
