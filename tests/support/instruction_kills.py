"""A sink that is killed at one instruction after the other: bytecode n of a method, for n = 0, stride, 2 stride ...

    python instruction_kills.py FOLDER METHOD STRIDE

`METHOD` is a key of `ACTIONS`, or `open`. For each n a child of this process opens a sink in `FOLDER/n`, keeps `BEFORE` events, and
runs the action; the tracing hook of the interpreter counts the bytecodes of the package `tracefile` and kills the child at
the n-th. The first child that gets through ends the series. Printed: JSON, [n, whether it was killed] of each child.
"""

import json
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

from trace_files import ping_session, run

import dds_trace.tracefile.writing.sink
from dds_trace.tracefile.writing.destination import TraceDestination
from dds_trace.tracefile.writing.sink import TraceSink

BEFORE = 5
RING_SLOTS = 16
STAMPED_NS = 7_000
PACKAGE = str(Path(dds_trace.tracefile.writing.sink.__file__).parents[1])


def go_on(sink: TraceSink) -> None:
    sink.go_on_in(TraceDestination(sink._files.writer.path.with_name("b.mcap"), ring_slots=RING_SLOTS))
    sink.record(1, 1, BEFORE, STAMPED_NS)


ACTIONS: dict[str, Callable[[TraceSink], object]] = {
    "record": lambda sink: sink.record(1, 1, BEFORE, STAMPED_NS, 3, 0, 0, 9, 0),
    "stamp": lambda sink: sink.stamp(1, 1, BEFORE, 3, 0, 0, 9, 0),
    "record_and_stamp": lambda sink: sink.record_and_stamp((1, 1), 1, BEFORE, 6_000, 0, 0, 9, 0),
    "record_expected": lambda sink: sink.record_expected(sink.expect((1, 1), 1, BEFORE, 9, 0), 6_000, 0, 0),
    "write_run": lambda sink: sink.write_run(run(state="started")),
    "close": lambda sink: sink.close(),
    "go_on_in": go_on,
}


def acting_at(number: int, act: Callable[[], object]) -> Callable[[FrameType, str, Any], Any]:
    """A tracing hook that calls `act` once, before bytecode `number` of the package."""
    left = number

    def trace(frame: FrameType, event: str, _argument: object) -> Any:
        nonlocal left
        if not frame.f_code.co_filename.startswith(PACKAGE):
            return None
        frame.f_trace_opcodes = True
        if event == "opcode":
            if left == 0:
                act()
            left -= 1
        return trace

    return trace


def open_sink(trace: Path, clock_ns: Callable[[], int] = lambda: STAMPED_NS, ring_slots: int = RING_SLOTS) -> TraceSink:
    """A sink whose thread drains the ring by itself only where a quarter of it is used."""
    destination = TraceDestination(trace, ring_slots=ring_slots, chunk_seconds=3600.0)
    return TraceSink(destination, ping_session(state="open"), clock_ns=clock_ns)


def keep_earlier(sink: TraceSink) -> None:
    for sequence in range(BEFORE):
        sink.record(1, 1, sequence, 1000 + sequence)


def play(trace: Path, method: str, number: int) -> None:
    """Keep events, then act until killed; or be killed while the sink is opened."""
    hook = acting_at(number, lambda: os.kill(os.getpid(), signal.SIGKILL))
    if method == "open":
        sys.settrace(hook)
        open_sink(trace)
    else:
        sink = open_sink(trace)
        keep_earlier(sink)
        sys.settrace(hook)
        ACTIONS[method](sink)
    sys.settrace(None)


def main(folder: str, method: str, stride: str) -> None:
    told, killed, number = [], True, 0
    while killed:
        trace = Path(folder) / f"{number}" / "a.mcap"
        pid = os.fork()
        if not pid:
            play(trace, method, number)
            os._exit(0)
        status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        assert status in (0, -signal.SIGKILL), status
        killed = status != 0
        told.append([number, killed])
        number += int(stride)
    print(json.dumps(told))


if __name__ == "__main__":
    main(*sys.argv[1:])
