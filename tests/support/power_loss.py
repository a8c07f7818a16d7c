"""A ping and a relay record onto a disk from which the power is taken, at many moments of one recording.

    unshare -m python power_loss.py FOLDER DOMAIN SEED CUTS MESSAGES [--fsync]

Both roles of `dds-record` write to an ext4 file system on a `ForgetfulDisk`, over the socket backend. At `CUTS` moments
that `SEED` draws, what the disk would hold without power is put aside: each is mounted afterwards, as after a reboot, and
its files are copied to `FOLDER/cuts/N`. The whole recording is in `FOLDER/truth`. Printed: JSON, `cuts_ns`, the moments on
CLOCK_MONOTONIC, and `stall_ns`, how long this process did not get to run at the worst.
"""

import json
import random
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from forgetful_disk import ForgetfulDisk
from waiting import PATIENCE_S

DISK_BYTES = 40 << 20
RATE_HZ = 500
SURVIVING = (0.0, 0.5, 0.9)
"""Share of the unflushed sectors that survive, of one cut after the other."""

SLEEP_S = 0.01
DDS_RECORD = str(Path(sys.executable).with_name("dds-record"))


def call(*command: object) -> None:
    subprocess.run([str(part) for part in command], check=True, stdout=subprocess.DEVNULL)


@contextmanager
def mounted(disk: Path, at: Path) -> Iterator[None]:
    """The file system of a disk at a folder; its loop device goes with it."""
    at.mkdir(exist_ok=True)
    call("mount", "-o", "loop", disk, at)
    try:
        yield
    finally:
        call("umount", at)


class StallWatch:
    """How long a thread that wants to run every `SLEEP_S` did not get to it, at the worst."""

    def __init__(self) -> None:
        self.worst_ns = 0
        threading.Thread(target=self._watch, daemon=True).start()

    def _watch(self) -> None:
        while True:
            before_ns = time.monotonic_ns()
            time.sleep(SLEEP_S)
            late_ns = time.monotonic_ns() - before_ns - int(SLEEP_S * 1e9)
            self.worst_ns = max(self.worst_ns, late_ns)


def record(folder: Path, domain: str, messages: int, options: list[str]) -> tuple[subprocess.Popen[str], ...]:
    common = ("--domain", domain, "--backend", "socket", "--discovery", "localhost", *options)
    relay = subprocess.Popen(
        [DDS_RECORD, "--role", "relay", "--out", str(folder / "relay.mcap"), *common], stderr=subprocess.PIPE, text=True
    )
    assert relay.stderr is not None
    while "serves domain" not in (line := relay.stderr.readline()):
        assert line, "the relay ended"
    threading.Thread(target=relay.stderr.read, daemon=True).start()
    ping = subprocess.Popen(
        [
            *(DDS_RECORD, "--role", "ping", "--out", str(folder / "ping.mcap"), *common),
            *("--data", "string", "--rate", str(RATE_HZ), "--messages", str(messages), "--warmup", "0"),
        ],
        stderr=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    deadline_s = time.monotonic() + PATIENCE_S
    while not (folder / "ping.mcap").exists():
        assert ping.poll() is None, "the ping ended"
        assert time.monotonic() < deadline_s, "the ping does not begin"
        time.sleep(SLEEP_S)
    return ping, relay


def main(folder: str, domain: str, seed: str, cuts: str, messages: str, *options: str) -> None:
    root, moment = Path(folder), random.Random(seed)
    (root / "served").mkdir()
    (root / "cuts").mkdir()
    disk = ForgetfulDisk(root / "served", DISK_BYTES)
    call("mkfs.ext4", "-q", "-F", "-b", "4096", "-J", "size=4", disk.path)
    images, cuts_ns = [], []
    with mounted(disk.path, root / "disk"):
        call("sync", "-f", root / "disk")
        watch = StallWatch()
        ping, relay = record(root / "disk", domain, int(messages), list(options))
        began_s, length_s = time.monotonic(), int(messages) / RATE_HZ
        for number, share in enumerate(sorted(moment.random() for _ in range(int(cuts)))):
            time.sleep(max(0.0, began_s + share * length_s - time.monotonic()))
            cuts_ns.append(time.monotonic_ns())
            images.append(disk.after_power_loss(moment, SURVIVING[number % len(SURVIVING)]))
        stall_ns = watch.worst_ns
        assert ping.wait(PATIENCE_S + length_s) == 0
        relay.terminate()
        assert relay.wait(PATIENCE_S) == 0
        call("cp", "-r", root / "disk", root / "truth")
    for number, image in enumerate(images):
        left = root / "left.img"
        left.write_bytes(image)
        with mounted(left, root / "disk"):
            call("cp", "-r", root / "disk", root / "cuts" / str(number))
    print(json.dumps({"cuts_ns": cuts_ns, "stall_ns": stall_ns}))


if __name__ == "__main__":
    main(*sys.argv[1:])
