"""A scripted stand-in for a bridge program, to test supervision. It forwards nothing and is no bridge.

`BRIDGE` registers it like a real one; its configuration file holds nothing but the name of the part it plays.
"""

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

UP = "stand-in is up"


@dataclass(frozen=True)
class StandInBridge:
    part: str = "serves"
    installed: bool = True
    program: str = sys.executable
    halves: object = None  # of ours it imports nothing, so that it starts at once
    name: str = "stand-in"
    install: str = "it is a test's own"
    tried: str = "in every test"
    suffix: str = ".txt"
    up_pattern: str | None = UP
    compiled_in: str = ""
    needs_ros_nodes: bool = False

    def configuration(self, _options):
        return f"{self.part}\n"

    def find(self):
        return Path(self.program) if self.installed else None

    def version(self, _program):
        return "0.1-stand-in"

    def arguments(self, _program):
        return ("-u", __file__)

    def environment(self, _options):
        return {"STAND_IN": "yes"}


BRIDGE = StandInBridge()


def serves():
    print(UP)
    signal.sigwait({signal.SIGINT})
    print("stand-in was told to stop")


def dies_at_once():
    print("stand-in has no configuration")
    sys.exit(3)


def dies_when_told():
    print(UP)
    signal.sigwait({signal.SIGUSR1})
    print("stand-in lost its way")
    sys.exit(4)


def floods():
    print(UP)
    line = "x" * 99 + "\n"
    while True:
        os.write(1, line.encode() * 100)


def never_up():
    print("stand-in is still thinking")
    signal.sigwait({signal.SIGINT})


def stubborn():
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    print(UP)
    time.sleep(600)


def leaves_children():
    """Two children, one of them in a session of its own and deaf to SIGTERM, which outlive their parent."""
    deaf = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print(1, flush=True); time.sleep(600)"
    child = subprocess.Popen([sys.executable, "-c", deaf], stdout=subprocess.PIPE, start_new_session=True)
    child.stdout.readline()
    subprocess.Popen(["sleep", "600"], start_new_session=True)
    serves()


if __name__ == "__main__":
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGUSR1})
    globals()[Path(sys.argv[1]).read_text().strip()]()
