"""NOT a recorder: stands in for `dds-record` where a test is about the sweep's bookkeeping and real runs cost only time.

The traces that it "records" are copies of files that the test has written with invented time stamps; nothing of
them may ever be shown as a result. In the folder `STAND_IN_FOLDER` it finds

    script.json    {"CELL": ["fail", "ok"], "relay": ["die"]}: what to do, one entry a start; after that as usual
    traces/        ok-0.mcap, ok-1.mcap ... (taken one after the other), half.mcap, slow.mcap, loses.mcap, both.mcap, relay.mcap, lossy.mcap

and there it notes every start in `starts.jsonl`. It needs the standard library alone, so that a start costs little.
"""

import fcntl
import json
import os
import shutil
import signal
import sys
import time
from pathlib import Path

told_to_stop = []
signal.signal(signal.SIGTERM, lambda *_: told_to_stop.append(True))

FOLDER = Path(os.environ["STAND_IN_FOLDER"])

FAILURES = {
    "fail": (8, "no echo\n  saw: nobody"),
    "unavailable": (7, "the middleware of this cell is not installed"),
    "bridge dies": (9, "the bridge builtin was killed by signal 9 (SIGKILL)"),
    "die": (1, "the relay's middleware gave up"),
}
"""Behaviour -> exit code and last words."""

AFTER_AN_ECHO = {"ok", "loses", "both", "silent", "half", "bridge dies"}

UNTIL_STOPPED = {"slow", "late", "relay", "lossy"}
"""Behaviours that write their trace when they are told to stop; the others at once."""


def main():
    options = [value for option, value in zip(sys.argv[1:], sys.argv[2:]) if option == "--label"]  # noqa: B905 - runs in a bare Python
    cell = next((label[len("cell=") :] for label in options if label.startswith("cell=")), "relay")
    behaviour, trace = begin(cell)
    out = sys.argv[sys.argv.index("--out") + 1]
    if behaviour in AFTER_AN_ECHO:
        wait_for((FOLDER / "waiting-relay").exists)
    if behaviour in FAILURES:
        if cell == "relay":  # so that it dies while a ping is at work, which has to be a slow one
            wait_for(lambda: any(FOLDER.glob("waiting-ros2*")))
        code, words = FAILURES[behaviour]
        print(f"dds-record: {words}", file=sys.stderr)
        return code
    if behaviour == "killed":
        print("a first line", flush=True)
        os.kill(os.getpid(), signal.SIGKILL)
    if behaviour == "hangs":
        wait_for(lambda: False)
    if behaviour in UNTIL_STOPPED:
        print(f"relay {os.environ.get('STAND_IN_RELAY', '0000beef')} serves domain", flush=True)
        (FOLDER / f"waiting-{cell}").touch()
        if behaviour == "late":  # it has begun to send
            Path(f"{out}.ring").touch()
        wait_for(lambda: told_to_stop)
        Path(f"{out}.ring").unlink(missing_ok=True)
        (FOLDER / f"waiting-{cell}").unlink(missing_ok=True)
    shutil.copy(FOLDER / "traces" / trace, out)
    return 12 if behaviour == "silent" else 0


def wait_for(condition):
    while not condition():
        time.sleep(0.01)


def begin(cell):
    with (FOLDER / "script.json").open("r+") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        script = json.load(file)
        usual = "relay" if cell == "relay" else "ok"
        behaviour = script[cell].pop(0) if script.get(cell) else usual
        number = script.get("number", 0)
        if behaviour == "ok":
            script["number"] = number + 1
        file.seek(0)
        file.truncate()
        json.dump(script, file)
    with (FOLDER / "starts.jsonl").open("a") as starts:
        starts.write(json.dumps({"cell": cell, "arguments": sys.argv[1:]}) + "\n")
    copied = {"ok": f"ok-{number}", "silent": "loses", "late": "slow"}
    return behaviour, f"{copied.get(behaviour, behaviour)}.mcap"


if __name__ == "__main__":
    sys.exit(main())
