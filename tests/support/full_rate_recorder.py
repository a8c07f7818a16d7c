"""A process that records as fast as it can until it is killed, and tells through shared memory how far it is.

    python full_rate_recorder.py TRACE PROGRESS THREADS [EVENTS]

`PROGRESS` is a file of `PROGRESS_BYTES` a thread: uint64 begun (the record call of so many events was entered), uint64
stamped (so many returned), uint64 state. Each is stored whole, by one instruction, so that a kill leaves no half of it.
With `EVENTS` a thread stops there and the trace is closed.
"""

import mmap
import struct
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

from trace_files import ping_session, run

from dds_trace.tracefile.writing.destination import TraceDestination
from dds_trace.tracefile.writing.sink import TraceSink

PROGRESS_BYTES = 64
STATE_CLOSING = 1
STATE_CLOSED = 2
BEGUN, STAMPED, STATE = range(3)
_WORDS = struct.Struct("<QQQ")

RUN_ID = 0x5EED
CHUNK_SECONDS = 0.005  # the draining thread is writing most of the time


@dataclass(frozen=True)
class Progress:
    begun: int
    stamped: int
    state: int


def read_progress(path: Path, threads: int) -> list[Progress]:
    data = path.read_bytes()
    return [Progress(*_WORDS.unpack_from(data, thread * PROGRESS_BYTES)) for thread in range(threads)]


def fields_of(thread: int, sequence: int) -> tuple[int, int, int, int, int, int]:
    """What a thread records with its event `sequence`: source, reception and scheduled time, bytes, relay, stage."""
    return (sequence * 3, sequence * 5, sequence * 7, sequence % 1000, thread + 1, thread % 4 + 1)


def _record(sink: TraceSink, told: memoryview, thread: int, last: int) -> None:
    record, stamp, now = sink.record, sink.stamp, time.monotonic_ns
    for sequence in range(last):
        source, received, scheduled, payload, relay, stage = fields_of(thread, sequence)
        told[BEGUN] = sequence + 1
        if sequence % 2:
            stamp(stage, RUN_ID, sequence, scheduled, source, received, payload, relay)
        else:
            record(stage, RUN_ID, sequence, now(), scheduled, source, received, payload, relay)
        told[STAMPED] = sequence + 1


def main(trace: str, progress: str, threads: str, events: str = str(1 << 60)) -> None:
    with Path(progress).open("r+b") as stream:
        shared = memoryview(mmap.mmap(stream.fileno(), 0))
    told = [shared[thread * PROGRESS_BYTES : (thread + 1) * PROGRESS_BYTES].cast("Q") for thread in range(int(threads))]
    anchor = {"wall_anchor_ns": time.time_ns(), "monotonic_anchor_ns": time.monotonic_ns()}
    sink = TraceSink(TraceDestination(Path(trace), chunk_seconds=CHUNK_SECONDS), ping_session(state="open", **anchor))
    sink.write_run(run(run_id=RUN_ID, state="started"))
    recording = [
        threading.Thread(target=_record, args=(sink, told[thread], thread, int(events)))
        for thread in range(int(threads))
    ]
    for thread in recording:
        thread.start()
    for thread in recording:
        thread.join()
    told[0][STATE] = STATE_CLOSING
    sink.close()
    told[0][STATE] = STATE_CLOSED


if __name__ == "__main__":
    main(*sys.argv[1:])
