"""A sink records onto a disk that dies: from a moment on every write fails, and ext4 turns itself read-only.

    unshare -m python dying_disk.py FOLDER [--fsync]

The sink is in a child process: a page of its ring that waits for the disk must not stop the thread that serves this. What
the disk still shows is copied to `FOLDER/left`. Printed: JSON, what the sink said.
"""

import json
import subprocess
import sys
import time
from pathlib import Path

from forgetful_disk import ForgetfulDisk
from power_loss import call
from trace_files import ping_session

from dds_trace.tracefile.writing.destination import TraceDestination
from dds_trace.tracefile.writing.sink import TraceSink

DISK_BYTES = 40 << 20
EVENTS = 1500
DIES_AT, SYNCED_AT = 500, 1000
DONE = "--record"


def record(trace: str, *options: str) -> None:
    """Stamp an event a millisecond; say so at `DIES_AT` and at `SYNCED_AT`, and go on when a line comes."""
    destination = TraceDestination(Path(trace), fsync="--fsync" in options, chunk_seconds=0.1, ring_slots=1 << 12)
    sink = TraceSink(destination, ping_session(state="open"))
    for sequence in range(EVENTS):
        if sequence in (DIES_AT, SYNCED_AT):
            print(sequence, flush=True)
            sys.stdin.readline()
        sink.stamp(1, 1, sequence)
        time.sleep(0.001)
    closed = sink.close()
    told = [closed.events, closed.ring_events, closed.dropped_events, str(closed.error)]
    print(json.dumps(told), flush=True)


def main(folder: str, *options: str) -> None:
    root = Path(folder)
    (root / "served").mkdir()
    (root / "disk").mkdir()
    disk = ForgetfulDisk(root / "served", DISK_BYTES)
    call("mkfs.ext4", "-q", "-F", "-b", "4096", "-J", "size=4", disk.path)
    call("mount", "-o", "loop,errors=remount-ro", disk.path, root / "disk")
    trace = root / "disk" / "a.mcap"
    command = [sys.executable, __file__, DONE, str(trace), *options]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as recorder:
        assert recorder.stdin is not None
        assert recorder.stdout is not None
        assert int(recorder.stdout.readline()) == DIES_AT
        call("sync", "-f", root / "disk")  # so that the pages of the ring are clean, and fault at their next store
        disk.is_broken = True
        print("go on", file=recorder.stdin, flush=True)
        assert int(recorder.stdout.readline()) == SYNCED_AT
        # What the cache holds meets the broken disk: the journal ends, and with it all writing.
        subprocess.run(["sync", "-f", str(root / "disk")], check=False, stderr=subprocess.DEVNULL)
        words, _ = recorder.communicate("go on\n")
    call("cp", "-r", root / "disk", root / "left")
    call("umount", "-l", root / "disk")
    print(json.dumps({"exit_code": recorder.returncode, "closed": json.loads(words)}))


if __name__ == "__main__":
    if sys.argv[1] == DONE:
        record(*sys.argv[2:])
    else:
        main(*sys.argv[1:])
