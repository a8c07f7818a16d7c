"""One recording at the terminal: progress on stderr, result on stdout."""

from __future__ import annotations

import atexit
import json
import shlex
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from typing import NoReturn

from rich.console import Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from dds_trace.base.errors import OutputError, TraceError
from dds_trace.base.extension import load
from dds_trace.base.printable import MAX_FINDING_CHARACTERS, printable
from dds_trace.base.streams import plain_console, say
from dds_trace.base.units import MISSING, counted, format_duration, three_digits
from dds_trace.recorder.applied.memory import remove_own_segments
from dds_trace.recorder.base_recording import Recorded
from dds_trace.recorder.errors import LossesError, StoppedError
from dds_trace.recorder.host.process import STOP_SIGNALS, exit_after, stop_at_signals
from dds_trace.recorder.options import RecordOptions
from dds_trace.recorder.recording import record
from dds_trace.recorder.roles.progress import (
    BeaconProgress,
    Health,
    LiveRow,
    PingProgress,
    Progress,
    RelayProgress,
    TapProgress,
)
from dds_trace.tracefile.writing.destination import ClosedTrace

from ..program import print_error


def describe_progress(progress: Progress) -> str:
    if isinstance(progress, TapProgress):
        lost = f", {progress.missing} missing" if progress.missing else ""
        topics = f"{counted(progress.topics, 'topic')} of {counted(progress.publishers, 'publisher')}"
        return f"{counted(progress.messages, 'message')} heard on {topics}{lost}"
    if isinstance(progress, BeaconProgress):
        return "; ".join((f"sent {progress.sent}, answered {progress.received}", *progress.clocks))
    if isinstance(progress, RelayProgress):
        line = f"{counted(progress.relayed, 'message')} received in {counted(progress.runs, 'run')}"
        return f"{line}, {progress.foreign} without our stamp ignored" if progress.foreign else line
    p50, p99 = (format_duration(time_ns, "ms") for time_ns in (progress.rtt_p50_ns, progress.rtt_p99_ns))
    warmup, warmup_lost = progress.warmup, progress.warmup_lost
    plus = f" (+{warmup} warm-up{f', {warmup_lost} lost' if warmup_lost else ''})" if warmup else ""
    return (
        f"sent {max(progress.sent - warmup, 0)}/{progress.planned - warmup}{plus}, "
        f"received {progress.received - progress.warmup_received}, lost {progress.lost - warmup_lost}, "
        f"round trip p50 {p50}, p99 {p99}"
    )


class TerminalWatch:
    def __init__(self) -> None:
        self._console = plain_console(stderr=True)
        # Without its own thread: drawing holds the interpreter lock, and a received message would wait.
        self._live = Live(
            console=self._console, auto_refresh=False, transient=True, redirect_stdout=False, redirect_stderr=False
        )

    def __enter__(self) -> TerminalWatch:  # noqa: PYI034 - `Self` is Python 3.11's
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self.stop()

    def stop(self) -> None:
        self._live.stop()

    def note(self, text: str) -> None:
        if self._console.is_terminal:
            self._console.print(Text(printable(text, MAX_FINDING_CHARACTERS)))
        else:
            say(text)

    def progress(self, progress: Progress) -> None:
        if not self._live.is_started:
            return
        line = Text(describe_progress(progress), no_wrap=True, overflow="ellipsis")
        rows = progress.rows if isinstance(progress, TapProgress) else ()
        self._live.update(Group(live_table(rows), line) if rows else line, refresh=True)


_STYLES = {Health.OK: "green", Health.SLOW: "yellow", Health.LATE: "yellow", Health.STALE: "red"}


def live_table(rows: Sequence[LiveRow]) -> Table:
    table = Table(box=None, pad_edge=False)
    for name in ("topic", "state", "rate", "expected", "age", "age p99", "missing"):
        table.add_column(name, justify="left" if name in ("topic", "state") else "right")
    for row in rows:
        table.add_row(
            printable(row.topic),
            Text(row.health.value, _STYLES[row.health]),
            f"{three_digits(row.rate_hz)} Hz",
            MISSING if row.expected_hz is None else f"{three_digits(row.expected_hz)} Hz",
            format_duration(row.age_ns),
            format_duration(row.age_p99_ns),
            str(row.missing),
        )
    return table


LEAVE_S = 10.0
"""Time to leave the middleware once the trace is closed; then the process ends without that."""


def record_until_stopped(
    options: RecordOptions, *, as_json: bool, fail_if_lost: float | None, gates: Sequence[object] = ()
) -> NoReturn:
    stop = stop_at_signals()
    codes: list[int] = []
    with TerminalWatch() as watch:

        @contextmanager
        def leave(end: Recorded | BaseException) -> Iterator[None]:
            watch.stop()
            error = end if isinstance(end, BaseException) else None
            judged_code = 0
            if isinstance(end, Recorded):
                try:
                    print_result(end, as_json=as_json, fail_if_lost=fail_if_lost)
                    if gates and end.trace is not None:
                        judged_code = load("parts", "judge_tap")(end.trace.path, gates)
                except TraceError as found:
                    error = found
                sys.stdout.flush()
            if isinstance(error, TraceError):
                print_error(f": {error}")
            codes.append(judged_code if error is None else error.exit_code if isinstance(error, TraceError) else 1)
            for number in STOP_SIGNALS:  # also while Python ends, when its own handlers are gone
                signal.signal(number, signal.SIG_IGN)
            call_off = exit_after(LEAVE_S, codes[0])
            yield
            call_off()
            remove_own_segments("zenoh")
            atexit.register(exit_after, LEAVE_S, codes[0])  # what the middleware does at the end of the process

        try:
            record(options, stop, watch, leave=leave)
        except TraceError:
            if not codes:
                raise
    sys.exit(codes[0])


def print_result(recorded: Recorded, *, as_json: bool, fail_if_lost: float | None = None) -> None:
    trace = recorded.trace
    error = _error_of(recorded, fail_if_lost)
    if as_json:
        print(json.dumps(_result(recorded, error)))
    elif trace is not None:
        lost = trace.dropped_events
        dropped = f"; {counted(trace.events, 'event')}, {lost:,} dropped" if lost else ""
        print(f"Wrote {trace.path}\n{describe_progress(recorded.progress)}{dropped}")
    if error is not None:
        raise error


def _error_of(recorded: Recorded, fail_if_lost: float | None) -> TraceError | None:
    trace, progress = recorded.trace, recorded.progress
    if trace is not None and trace.error is not None:
        return _trace_error(trace, trace.error)
    if recorded.error is not None:
        return recorded.error
    if trace is None:
        return StoppedError("stopped before the first echo; nothing was written")
    if fail_if_lost is None or not isinstance(progress, PingProgress) or not progress.sent:
        return None
    share = progress.lost / progress.sent
    if share <= fail_if_lost:
        return None
    return LossesError(
        f"{progress.lost:,} of {counted(progress.sent, 'message')} lost, {share:.2%}; --fail-if-lost allows "
        f"{fail_if_lost:.2%}"
    )


def _trace_error(trace: ClosedTrace, error: OutputError) -> OutputError:
    if not trace.ring_events:
        return error
    if isinstance(error.__cause__, FileNotFoundError):  # the ring was there, too
        return OutputError(f"{error}; {counted(trace.events + trace.ring_events, 'event')} went with it")
    return OutputError(
        f"{error}; {counted(trace.ring_events, 'event waits', 'events wait')} in its ring file: make "
        f"room or copy both files to another disk, then `dds-trace recover {shlex.quote(str(trace.path))}`"
    )


def _result(recorded: Recorded, error: TraceError | None) -> dict[str, object]:
    session, run, trace = recorded.session, recorded.run, recorded.trace
    return {
        "path": None if trace is None else str(trace.path),
        "role": session.role,
        "session_id": f"{session.session_id:016x}",
        "run_id": None if run is None else f"{run.run_id:016x}",
        "relay_id": session.relay_id,
        "events": 0 if trace is None else trace.events,
        "dropped_events": 0 if trace is None else trace.dropped_events,
        "bytes": 0 if trace is None else trace.bytes,
        "error": None if error is None else str(error),
        **asdict(recorded.progress),
    }
