"""Ten jumps of known cause, each made by one setting, and whether `dds-trace explain size` names it.

    python benchmarks/bench_explain.py [--repeats 5] [--out FOLDER] [NAME ...]

Prints a line for each jump and the score; exits with 1 below ten. Jumps over a link need root.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

RUN = """
[run]
messages = {messages}
warmup = 3
settle_seconds = 0.1
own_cost_passes = 1
repeats = {repeats}
domain = 47
attempts = 1
seed = 7
"""
REALTIME = """
[devices.ping]
options = ["--realtime", "50"]
[devices.relay]
options = ["--realtime", "50"]
"""
"""For root: other programs of the machine delay no message."""


@dataclass(frozen=True)
class Jump:
    """A jump: its axes, the two sizes, and the setting that makes it."""

    name: str
    cause: str
    sizes: str
    axes: str
    link: str = ""
    messages: int = 30


LOSSY = "[link]\ndelay_ms = 40\nloss_percent = 1\n"
"""Of a large message some fragment is always lost, and comes again after more than a period."""
QUEUE = "[link]\nrate_mbit_s = 200\nqueue_ms = 3\n"
JUMPS = (
    Jump("fastdds-segment-512KiB", "segment", "400KB..2MB", 'backend = "ros2"\ntransport = "shm"\nrate = 30'),
    Jump("fastdds-segment-128KiB", "segment", "100KB..1MB", 'backend = "ros2"\nsegment = "128KiB"\nrate = 30'),
    Jump("fastdds-buffer", "buffer", "100KB..400KB", 'backend = "ros2"\ntransport = "udp"\nbuffer = 100000\nrate = 20'),
    Jump(
        "socket-fragment",
        "fragment",
        "40KB..500KB",
        'backend = "socket"\ntransport = "udp"\nreliability = "best_effort"\nbuffer = "4MB"\nfragment = 1400\nrate = 50',
    ),
    Jump(
        "fastdds-fragment",
        "fragment",
        "50KB..500KB",
        'backend = "ros2"\ntransport = "udp"\nbuffer = "4MB"\nfragment = 1400\nrate = 20',
    ),
    Jump(
        "cyclonedds-fragment",
        "fragment",
        "50KB..500KB",
        'backend = "cyclonedds"\nbuffer = "4MB"\nfragment = 1400\nrate = 20',
    ),
    Jump("zenoh-fragment", "fragment", "50KB..1MB", 'backend = "zenoh"\ntransport = "tcp"\nfragment = 1400\nrate = 20'),
    Jump("cyclonedds-history", "history", "1KB..100KB", 'backend = "cyclonedds"\ndepth = 1\nrate = 20', LOSSY),
    Jump("cyclonedds-queue", "queue", "30KB..300KB", 'backend = "cyclonedds"\nrate = 20', QUEUE),
    Jump("fastdds-queue", "queue", "30KB..150KB", 'backend = "ros2"\nbuffer = "4MB"\nrate = 20', QUEUE),
)


def named_cause(jump: Jump, folder: Path, repeats: int) -> dict[str, object]:
    """Return the answer of `dds-trace explain size` to a jump."""
    plan = folder / f"{jump.name}.toml"
    plan.write_text(
        RUN.format(messages=jump.messages, repeats=repeats)
        + (REALTIME if os.geteuid() == 0 else "")
        + jump.link
        + f"[axes]\n{jump.axes}\n"
    )
    command = [
        sys.executable,
        "-m",
        "dds_trace",
        *("explain", "size", jump.sizes, str(plan)),
        *("--out", str(folder), "--json"),
    ]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    if not done.stdout:
        return {"cause": f"exit code {done.returncode}"}
    answer: dict[str, object] = json.loads(done.stdout)["explained"][0]
    return {"cause": "nothing, as not all was recorded", **answer}


def main() -> None:
    """Make the jumps."""
    parser = argparse.ArgumentParser()
    parser.add_argument("names", nargs="*")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--out", type=Path, help="keep the traces here")
    options = parser.parse_args()
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    by_name = {jump.name: jump for jump in JUMPS}
    chosen = [by_name[name] for name in options.names or by_name]
    right = 0
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.out or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for jump in chosen:
            answer = named_cause(jump, folder, options.repeats)
            right += answer["cause"] == jump.cause
            rise, removed = answer.get("rise") or {}, answer.get("removed") or []
            effects = ", ".join(
                f"{one['name']} {one['value']:.3g} ({one['low'] or 0:.3g} to {one['high'] or 0:.3g})" for one in removed
            )
            print(
                f"{jump.name}: {jump.sizes} x{rise.get('value', 0):.3g}; {effects}; made by {jump.cause}, named {answer['cause'] or 'not known'}",
                flush=True,
            )
    print(f"{right} of {len(chosen)} right")
    sys.exit(right < len(chosen))


if __name__ == "__main__":
    main()
