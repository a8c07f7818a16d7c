"""Runs a command in this network namespace under a capture, and writes what the capture says.

    wire_session.py OPTIONS OUT COMMAND...

writes OUT.json (the counts) and OUT.npy (the rows). SIGTERM ends the command and not the session.
"""

import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np

from dds_trace.base.records import from_json
from dds_trace.extensions.wire.capture import WireCapture, WireOptions


def main() -> None:
    out = Path(sys.argv[2])
    with WireCapture(from_json(WireOptions, json.loads(sys.argv[1]))) as capture:
        capture.begin()
        command = subprocess.Popen(sys.argv[3:])
        signal.signal(signal.SIGTERM, lambda *_: command.terminate())
        status = command.wait()
        found = capture.take()
    out.with_suffix(".json").write_text(json.dumps(found.counts.to_dict()))
    np.save(out.with_suffix(".npy"), found.rows)
    sys.exit(status)


if __name__ == "__main__":
    main()
