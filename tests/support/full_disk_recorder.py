"""A process that records onto a small disk of its own until it is full, and some more.

    unshare -rm python full_disk_recorder.py FOLDER REPORT

Mounts a tmpfs at `FOLDER` (the mount ends with the process), records, and writes to `REPORT` as JSON what the sink said
and, as a copy beside it, what was left on the disk.
"""

import json
import random
import shutil
import subprocess
import sys
from pathlib import Path

from trace_files import ping_session, run

from dds_trace.tracefile.format.events import RUN_TOPIC
from dds_trace.tracefile.writing.destination import TraceDestination
from dds_trace.tracefile.writing.sink import TraceSink

DISK = "size=1m"
RING_SLOTS = 1 << 12
AT_MOST_EVENTS = 2_000_000


def main(folder: str, report: str) -> None:
    subprocess.run(["mount", "-t", "tmpfs", "-o", DISK, "none", folder], check=True)
    trace = Path(folder) / "a.mcap"
    sink = TraceSink(TraceDestination(trace, chunk_seconds=0.01, ring_slots=RING_SLOTS), ping_session(state="open"))
    sink.write_run(run(state="started"))
    draw = random.Random(1)
    sequence = 0
    while sink.error is None and sequence < AT_MOST_EVENTS:
        sink.record(1, 1, sequence, sequence, source_ns=draw.getrandbits(62), received_ns=draw.getrandbits(62))
        sequence += 1
        if sequence % 500 == 0:  # returns when all events are in the file, so that none is dropped while there is room
            sink.write_run(run(state="started"))
    at_error = sequence
    for _ in range(RING_SLOTS + 100):  # the node goes on answering
        sink.record(1, 1, sequence, sequence)
        sequence += 1
    sink.write_json(RUN_TOPIC, {"not": "written"})
    closed = sink.close()
    shutil.copytree(folder, Path(report).parent / "left")
    told = {
        "stamped": sequence,
        "at_error": at_error,
        "events": closed.events,
        "ring_events": closed.ring_events,
        "dropped_events": closed.dropped_events,
        "error": str(closed.error),
    }
    Path(report).write_text(json.dumps(told))


if __name__ == "__main__":
    main(*sys.argv[1:])
