"""The capture of a role's interfaces, and the process that does it; nothing is written during a run."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dds_trace.base.errors import OptionError
from dds_trace.base.records import from_json, to_json
from dds_trace.recorder.choices import Discovery
from dds_trace.recorder.domains import domain_port_range
from dds_trace.recorder.host.child import Child
from dds_trace.recorder.kernel.counters import LOOPBACK, ask_interface
from dds_trace.tracefile.format.descriptions import Run
from dds_trace.tracefile.format.events import WIRE_TOPIC

from .counts import WireCounts
from .format import MESSAGE_ROW, MessageRows, row_texts
from .packet_filter import PortRange

if TYPE_CHECKING:
    from dds_trace.tracefile.writing.sink import TraceSink


_SIOCGIFFLAGS = 0x8913
_IFF_UP = 0x1
_SYSTEM = Path("/sys/class/net")


def run_interfaces(discovery: Discovery, system: Path = _SYSTEM) -> tuple[str, ...]:
    """Return the interfaces that a run with this range of discovery uses, without ports of a bridge: they would count twice."""
    if discovery is Discovery.LOCALHOST:
        return (LOOPBACK,)
    names = sorted(name for _, name in socket.if_nameindex())
    return tuple(name for name in names if _is_up(name) and not (system / name / "master").exists())


def _is_up(interface: str) -> bool:
    try:
        return bool(ask_interface(interface, _SIOCGIFFLAGS) & _IFF_UP)
    except OSError:  # it was removed meanwhile
        return False


def domain_ports(domain_id: int) -> PortRange:
    ports = domain_port_range(domain_id)
    return PortRange(ports[0], ports[-1])


@dataclass(frozen=True, slots=True)
class WireOptions:
    """What is captured.

    Attributes:
        rtps_ports: UDP ports of the run's DDS domains; other RTPS is left out. Empty: all RTPS counts.
        ring_bytes: kernel memory for packets on each interface; 100 Mbit/s may need 12.5 MB a second.
        block_timeout_ms: how long the kernel collects packets before it delivers them, and how often they are counted.
        cpus: of the capturing process; empty for its parent's.
    """

    interfaces: tuple[str, ...]
    rtps_ports: tuple[PortRange, ...] = ()
    udp_ports: tuple[PortRange, ...] = ()
    tcp_ports: tuple[PortRange, ...] = ()
    ring_bytes: int = 32 << 20
    block_timeout_ms: int = 100
    cpus: tuple[int, ...] = ()


_PROCESS = f"{__package__}.process"
_PATIENCE_S = 10.0
_ENDED = "--wire: the capturing process ended by itself; its reason is on stderr"


@dataclass(frozen=True, slots=True)
class WireResult:
    counts: WireCounts
    rows: MessageRows


class WireCapture(AbstractContextManager["WireCapture"]):
    """A capture from its construction to `close`; an `OptionError` names what cannot be captured."""

    def __init__(self, options: WireOptions) -> None:
        if not hasattr(socket, "AF_PACKET"):
            raise OptionError("--wire needs Linux: this system does not have its packet sockets (AF_PACKET)")
        words = sys.executable, "-m", _PROCESS, json.dumps(to_json(options))
        self._process = Child(words, ends_by_input=True, lost=lambda: OptionError(_ENDED), stdout=subprocess.PIPE)
        try:
            self._answer()
        except OptionError:
            self.close()
            raise

    @property
    def pid(self) -> int:
        return self._process.pid

    def begin(self, run_id: int | None = None) -> None:
        """Count from now, a quarter of a second later; messages of `run_id`, or with None of all runs, get rows."""
        self._process.say(json.dumps({"ask": "begin", "run_id": "" if run_id is None else f"{run_id:016x}"}))
        self._answer()

    def take(self) -> WireResult:
        """Return what was counted since `begin`, a quarter of a second of late packets included; once, as rows are handed over."""
        self._process.say('{"ask": "take"}')
        answer = self._answer()
        assert self._process.stdout is not None
        rows = np.frombuffer(self._process.stdout.read(answer["row_bytes"]), MESSAGE_ROW)
        return WireResult(from_json(WireCounts, answer), rows)

    def close(self) -> None:
        with self._process:
            self._process.end(_PATIENCE_S)

    def _answer(self) -> dict[str, Any]:
        answer: dict[str, Any] = self._process.answer()
        if "error" in answer:
            raise OptionError(answer["error"])
        return answer

    def __exit__(self, *_error: object) -> None:
        self.close()


@contextmanager
def open_wire(*, discovery: Discovery, domain_ids: Iterable[int], note: Callable[[str], None]) -> Iterator[WireRecord]:
    """Open the capture before the node: a participant's first announcement counts."""
    ports = tuple(domain_ports(domain_id) for domain_id in sorted(set(domain_ids)))
    options = WireOptions(
        run_interfaces(discovery),
        rtps_ports=ports,
        udp_ports=ports,
        tcp_ports=ports,
        cpus=tuple(range(os.cpu_count() or 1)),
    )
    with WireCapture(options) as capture:
        yield WireRecord(capture, note)


class WireRecord:
    def __init__(self, capture: WireCapture, note: Callable[[str], None]) -> None:
        self._capture: WireCapture | None = capture  # until it fails
        self._note = note
        self._relayed = 0  # by a relay until its counts were last written
        self._discovery_bytes = 0  # before a ping's run

    @property
    def processes(self) -> Mapping[str, int]:
        return {} if self._capture is None else {"wire": self._capture.pid}

    def begin(self, run_id: int | None = None) -> None:
        if run_id is not None and (before := self._take()) is not None:
            self._discovery_bytes = before.counts.discovery_bytes
        if self._capture is None:
            return
        try:
            self._capture.begin(run_id)
        except OptionError as err:
            self._give_up(err)

    def write_run(self, run: Run, sink: TraceSink) -> Run:
        result = self._take()
        if result is None:
            return run
        met = run.extra.get("discovery")
        discovery = {**(met if isinstance(met, dict) else {}), "bytes": self._discovery_bytes}
        described = replace(run, extra={**run.extra, "wire": result.counts.to_dict(), "discovery": discovery})
        sink.write_run(described)
        _write_rows(result, sink)
        return described

    def write_relay(self, relayed: int, session_id: int, sink: TraceSink, *, go_on: bool = False) -> None:
        if relayed == self._relayed:
            return
        result = self._take()
        if go_on:
            self.begin()
        self._relayed = relayed
        if result is None:
            return
        runs = sorted(set(result.rows["run_id"].tolist()))
        sink.write_json(
            WIRE_TOPIC,
            {
                "session_id": f"{session_id:016x}",
                "run_ids": [f"{run_id:016x}" for run_id in runs],
                "counts": result.counts.to_dict(),
            },
        )
        _write_rows(result, sink)

    def _take(self) -> WireResult | None:
        if self._capture is None:
            return None
        try:
            return self._capture.take()
        except OptionError as err:
            self._give_up(err)
            return None

    def _give_up(self, error: OptionError) -> None:
        self._note(f"{error}; the recording continues without counts of the wire")
        self._capture = None


def _write_rows(result: WireResult, sink: TraceSink) -> None:
    for text in row_texts(result.rows):
        sink.write_json(WIRE_TOPIC, text)
