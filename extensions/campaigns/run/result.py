"""One cell's result for progress, state file and search; not for publication."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dds_trace.analyzer.statistics.percentiles import PERCENTILES, quantile_of
from dds_trace.base.errors import TraceFormatError
from dds_trace.base.units import counted, three_digits
from dds_trace.tracefile.format.descriptions import Run
from dds_trace.tracefile.format.events import EventColumns, Stage
from dds_trace.tracefile.reading.reader import read_trace
from dds_trace.tracefile.reading.trace import Trace


@dataclass(frozen=True, slots=True)
class CellResult:
    """One run as its ping recorded it, without the warm-up except in the two sums of bytes.

    Attributes:
        run_id: 16 hex digits.
        published: messages that were to be sent back, all without `ping_share`; `received`: those with a reply.
        sent_bytes: application bytes of all published messages; `returned_bytes`: of the first reply to each.
        achieved_rate_hz: rate of publishing, None with fewer than two messages.
        rtt_ms: percentile (`p50` ... `p99.9`) -> T2 - T1, None without replies; likewise `response_ms`, T2 - T0.
    """

    run_id: str
    planned: int
    published: int
    received: int
    sent_bytes: int
    achieved_rate_hz: float | None
    rtt_ms: Mapping[str, float] | None
    response_ms: Mapping[str, float] | None
    dropped_events: int
    cut_off: bool
    not_applied: str = ""
    returned_bytes: int = 0
    relay_ids: tuple[int, ...] = ()

    @property
    def loss_percent(self) -> float:
        return 100.0 * (self.published - self.received) / self.published if self.published else 100.0

    def __str__(self) -> str:
        loss = f", {three_digits(self.loss_percent)} % lost" if self.received < self.published else ""
        cut = f", cut off after {self.published} of {self.planned}" if self.cut_off else ""
        rtt = "no reply"
        if self.rtt_ms:
            rtt = f"round trip p50 {three_digits(self.rtt_ms['p50'])} p99 {three_digits(self.rtt_ms['p99'])} ms"
        not_applied = f"; not applied: {self.not_applied}" if self.not_applied else ""
        return f"{rtt}, {self.received}/{self.published}{loss}{cut}{not_applied}"


def read_result(path: Path) -> CellResult:
    trace = read_trace(path)
    if len(trace.runs) != 1:
        raise TraceFormatError(path, f"has {counted(len(trace.runs), 'run')} where a cell has one")
    run = trace.runs[0]
    if run.state != "finished":
        raise TraceFormatError(path, "the run was not finished")
    all_sent = _measured_events(trace, Stage.T1, run)
    ping_every = run.extra.get("ping_every")
    sent = all_sent.take(all_sent.sequence % np.uint64(ping_every) == 0) if isinstance(ping_every, int) else all_sent
    replies = _measured_events(trace, Stage.T2, run)
    # The first reply of each message counts.
    answered, first = np.unique(replies.sequence, return_index=True)
    receive_ns = replies.monotonic_ns[first]
    answered_sequences, in_sent, in_answered = np.intersect1d(sent.sequence, answered, return_indices=True)
    published = trace.events[Stage.T1]
    _, returned = np.unique(trace.events[Stage.T2].sequence, return_index=True)
    not_applied = trace.sessions[-1].extra.get("not_applied") if trace.sessions else None
    entries = not_applied if isinstance(not_applied, list) else ()
    span_ns = int(all_sent.monotonic_ns[-1] - all_sent.monotonic_ns[0]) if len(all_sent) > 1 else 0
    return CellResult(
        run_id=f"{run.run_id:016x}",
        planned=run.planned_messages,
        published=len(sent),
        received=len(answered_sequences),
        sent_bytes=int(published.payload_bytes.sum(dtype=np.int64)),
        returned_bytes=int(trace.events[Stage.T2].payload_bytes[returned].sum(dtype=np.int64)),
        achieved_rate_hz=(len(all_sent) - 1) / (span_ns / 1e9) if span_ns else None,
        rtt_ms=_percentiles_ms(receive_ns[in_answered] - sent.monotonic_ns[in_sent]),
        response_ms=_percentiles_ms(receive_ns[in_answered] - sent.scheduled_ns[in_sent]) if run.rate_hz else None,
        dropped_events=sum(session.dropped_events for session in trace.sessions),
        cut_off=len(all_sent) < run.planned_messages,
        not_applied="; ".join(str(entry.get("words")) for entry in entries if isinstance(entry, dict)),
        relay_ids=tuple(np.unique(replies.relay_id).tolist()),
    )


def read_responses(path: Path) -> NDArray[np.float64]:
    """Return T2 - T0 of each planned message in ms, infinite for one that was lost or never sent."""
    trace = read_trace(path)
    run = trace.runs[0]
    sent, replies = (_measured_events(trace, stage, run) for stage in (Stage.T1, Stage.T2))
    answered, first = np.unique(replies.sequence, return_index=True)
    _, in_sent, in_answered = np.intersect1d(sent.sequence, answered, return_indices=True)
    response_ns = replies.monotonic_ns[first][in_answered] - sent.scheduled_ns[in_sent]
    planned = max(run.planned_messages, len(sent))
    return np.concatenate([response_ns / 1e6, np.full(planned - len(response_ns), np.inf)])


def read_cpu_percent(path: Path) -> float:
    """Return the mean load of the recording process in percent of one processor, 0 without samples."""
    samples = [sample.get("processes") for sample in read_trace(path).host_samples]
    loads = [
        node.get("cpu_percent")
        for row in samples
        if isinstance(row, dict) and isinstance(node := row.get("self"), dict)
    ]
    return float(np.mean([load for load in loads if isinstance(load, int | float)] or [0.0]))


def _measured_events(trace: Trace, stage: Stage, run: Run) -> EventColumns:
    columns = trace.events[stage]
    return columns.take((columns.run_id == run.run_id) & (columns.sequence >= run.warmup_messages))


def _percentiles_ms(times_ns: NDArray[np.int64]) -> dict[str, float] | None:
    if not len(times_ns):
        return None
    ordered = np.sort(times_ns)
    return {row.label: round(quantile_of(ordered, row.quantile) / 1e6, 4) for row in PERCENTILES}
