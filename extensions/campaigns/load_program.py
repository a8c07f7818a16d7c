"""Load for a machine, in a process of its own with the standard library only: `load_program.py KIND HOST`.

`cpu` keeps every processor busy, `memory` copies on half of them, by stress-ng where it is installed; `network` sends UDP
to HOST; `awake` and `dma-latency` keep processors from sleeping; `emulated-pi3` takes four fifths of the processor HOST from
the end of its input on. Of all but `network` and `dma-latency` a machine has one at a time: a second program waits. It
prints what makes the load and the time (CLOCK_MONOTONIC) once it starts, and runs until it is killed.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import hashlib
import os
import resource
import shutil
import socket
import sys
import tempfile
import threading
import time

DISCARD_PORT = 9
DATAGRAM_BYTES = 1400
NETWORK_BIT_S = 100_000_000
BURST_S = 0.002
COPIED_BYTES = 64 << 20
STEAL_EVERY_NS, STOLEN_NS = 500_000, 400_000
STEALER_PRIORITY = 60
MOST_SPINNING_US = 100_000

PROCESSORS = os.cpu_count() or 1
STRESS_NG = {"cpu": ("--cpu", PROCESSORS), "memory": ("--stream", max(1, PROCESSORS // 2))}


def say(program: str) -> None:
    print(program, time.monotonic(), flush=True)


def compute(data_bytes: int = 1 << 20) -> None:
    data = bytes(data_bytes)
    while True:
        hashlib.sha256(data)


def copy() -> None:
    source, target = (ctypes.create_string_buffer(COPIED_BYTES) for _ in range(2))
    while True:
        ctypes.memmove(target, source, COPIED_BYTES)


def send(host: str) -> None:
    data, next_s, address = bytes(DATAGRAM_BYTES), time.monotonic(), socket.gethostbyname(host)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        while True:
            for _ in range(round(NETWORK_BIT_S * BURST_S / 8 / DATAGRAM_BYTES)):
                with contextlib.suppress(OSError):  # nobody receives there
                    sender.sendto(data, (address, DISCARD_PORT))
            next_s = max(next_s + BURST_S, time.monotonic() - BURST_S)
            time.sleep(max(0.0, next_s - time.monotonic()))


def keep_awake(processor: int) -> None:
    with contextlib.suppress(OSError):  # a processor that is not for this process
        os.sched_setaffinity(0, [processor])
    compute(1 << 14)


def hold_dma_latency() -> None:
    """Ask the kernel for no latency of waking up, until this program ends; print what it grants."""
    device = os.open("/dev/cpu_dma_latency", os.O_RDWR)
    os.write(device, bytes(4))
    say(f"cpu_dma_latency {int.from_bytes(os.pread(device, 4, 0), sys.byteorder)} us")
    threading.Event().wait()


def steal(processor: int) -> None:
    """Take 400 of each 500 us of a processor from all others: what they do takes five times as long, as on a slower one."""
    os.sched_setaffinity(0, [processor])
    resource.setrlimit(resource.RLIMIT_RTTIME, (MOST_SPINNING_US, 2 * MOST_SPINNING_US))
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(STEALER_PRIORITY))
    next_ns = time.monotonic_ns()
    while True:
        while (now_ns := time.monotonic_ns()) < next_ns + STOLEN_NS:
            pass
        next_ns = max(next_ns + STEAL_EVERY_NS, now_ns + STEAL_EVERY_NS - STOLEN_NS)
        time.sleep((next_ns - now_ns) / 1e9)


def main() -> None:
    kind, host = sys.argv[1:]
    if kind == "emulated-pi3":
        sys.stdin.read()  # until the first echo
    # The recorder may have a real-time priority and only some processors.
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.sched_setaffinity(0, range(PROCESSORS))
    if kind == "network":
        say("own")
        send(host)
    if kind == "dma-latency":
        hold_dma_latency()
    lock = os.open(f"{tempfile.gettempdir()}/dds-trace-load-{os.getuid()}.lock", os.O_CREAT | os.O_RDWR | os.O_NOFOLLOW)
    fcntl.flock(lock, fcntl.LOCK_EX)
    if kind == "emulated-pi3":
        say("own")
        steal(int(host))
    if kind == "awake":
        say("own")
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
        for processor in range(PROCESSORS):
            threading.Thread(target=keep_awake, args=(processor,), daemon=True).start()
        threading.Event().wait()
    stress_ng = shutil.which("stress-ng")
    say("stress-ng" if stress_ng else "own")
    if stress_ng:
        os.set_inheritable(lock, True)
        option, workers = STRESS_NG[kind]
        os.execv(stress_ng, [stress_ng, option, str(workers), "--timeout", "0", "--quiet"])  # noqa: S606 - no shell
    for _ in range(int(STRESS_NG[kind][1])):
        threading.Thread(target=compute if kind == "cpu" else copy, daemon=True).start()
    threading.Event().wait()


if __name__ == "__main__":
    main()
