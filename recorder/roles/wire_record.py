"""The capture of a role's interfaces; nothing is written during a run."""

from __future__ import annotations

import os
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

from dds_trace.base.errors import OptionError
from dds_trace.tracefile.format.wire import WIRE_TOPIC, row_texts

from ..wire.capture import WireCapture, WireOptions, domain_ports, run_interfaces

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from dds_trace.tracefile.format.descriptions import Run
    from dds_trace.tracefile.writing.sink import TraceSink

    from ..choices import Discovery
    from ..wire.capture import WireResult


@contextmanager
def open_wire(
    *, enabled: bool, discovery: Discovery, domain_ids: Iterable[int], note: Callable[[str], None]
) -> Iterator[WireRecord]:
    """Open the capture before the node: a participant's first announcement counts."""
    if not enabled:
        yield WireRecord(None, note)
        return
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
    def __init__(self, capture: WireCapture | None, note: Callable[[str], None]) -> None:
        self._capture = capture
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
