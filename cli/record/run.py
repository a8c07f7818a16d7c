"""One recording at the terminal: it ends by itself or at Ctrl-C and prints its result."""

from __future__ import annotations

import json
import signal
import threading
from dataclasses import asdict
from typing import TYPE_CHECKING

from dds_trace.recorder import record
from dds_trace.tracefile.units.counts import counted

from ..progress import TerminalWatch, describe_progress

if TYPE_CHECKING:
    from dds_trace.recorder import Recorded, RecordOptions


def record_until_stopped(options: RecordOptions) -> Recorded:
    """Record until done; Ctrl-C and SIGTERM end the recording with a closed trace, however often they come."""
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    with TerminalWatch() as watch:
        return record(options, stop, watch)


def print_result(recorded: Recorded, *, as_json: bool) -> None:
    """Print the result of a recording.

    Raises:
        OutputError: not all of the trace could be written.
    """
    trace = recorded.trace
    if as_json:
        print(json.dumps(_result(recorded)))
    else:
        print(f"Wrote {trace.path}")
        print(
            f"{describe_progress(recorded.progress)}; {counted(trace.events, 'event')}, {trace.dropped_events} dropped"
        )
    if trace.error is not None:
        raise trace.error


def _result(recorded: Recorded) -> dict[str, object]:
    """Return the JSON object of `--json`."""
    session, run, trace = recorded.session, recorded.run, recorded.trace
    return {
        "path": str(trace.path),
        "role": session.role,
        "session_id": f"{session.session_id:016x}",
        "run_id": None if run is None else f"{run.run_id:016x}",
        "relay_id": session.relay_id,
        "events": trace.events,
        "dropped_events": trace.dropped_events,
        "bytes": trace.bytes,
        "error": None if trace.error is None else str(trace.error),
        **asdict(recorded.progress),
    }
