"""What `--wire` costs: one ping, watched by a capture of the loopback interface in every other phase.

    python benchmarks/bench_wire.py [--phases 10] [--phase-s 2] [--domain 60] [--json]

For each middleware and size one ping runs through all phases, so that nothing but the capture differs between two of them.
The result is the median, over pairs of neighbouring phases, of the ratio of their RTT percentiles, with over without the
capture, and the CPU time that a captured packet takes. Before, what the kernel adds to one packet from socket to socket,
which a busy machine disturbs less. Needs CAP_NET_RAW; absolute times are this machine's.
"""

from __future__ import annotations

import argparse
import json
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dds_trace.base.errors import TraceError
from dds_trace.extensions.wire.capture import WireCapture, WireOptions, domain_ports
from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.reading.reader import read_trace

if TYPE_CHECKING:
    from collections.abc import Iterator

    from dds_trace.extensions.wire.counts import WireCounts

PROGRAM = Path(sys.executable).with_name("dds-record")
CELLS = (("socket", "1KB"), ("socket", "33KB"), ("cyclonedds", "1KB"), ("cyclonedds", "33KB"), ("cyclonedds", "1MB"))
WARM_UP_S = 6
RATE_HZ = {"1KB": 200, "33KB": 200, "1MB": 30}


SETTLING_S = 0.5
"""After a capture was started or ended: what starts a process is not what a capture costs."""


@dataclass(frozen=True, slots=True)
class Cell:
    """One middleware and size.

    Attributes:
        backend, size: as `dds-record` has them.
        p50_ratio, p99_ratio: medians of the ratios of RTT percentiles.
        p50_ratios: of RTT p50, pair by pair.
        p50_us: median RTT without a capture.
        packets_per_s: that the capture handled.
        cpu_us_per_packet: CPU time of the capturing process.
        cpu_share: of one CPU.
        kernel_drops: in all phases.
    """

    backend: str
    size: str
    p50_ratio: float
    p99_ratio: float
    p50_ratios: tuple[float, ...]
    p50_us: float
    packets_per_s: float
    cpu_us_per_packet: float
    cpu_share: float
    kernel_drops: int


def rtps_packet(payload_bytes: int, *, heartbeat: bool) -> bytes:
    """One DATA, with a heartbeat behind it or not; behind a payload the heartbeat has the kernel copy that, too."""
    data = struct.pack("<BBHHHII8x", 0x15, 5, 20 + payload_bytes, 0, 16, 0, 0x03120000) + bytes(payload_bytes)
    return b"RTPS" + bytes(16) + data + (struct.pack("<BBH28x", 7, 1, 28) if heartbeat else b"")


PACKETS = {
    "300 bytes": rtps_packet(300, heartbeat=False),
    "14.5 KB": rtps_packet(14_500, heartbeat=False),
    "14.5 KB and a heartbeat": rtps_packet(14_500, heartbeat=True),
}


def added_ns(domain_id: int, rounds: int = 6) -> dict[str, float]:
    """Return by how much a capture prolongs a packet's way through the loopback interface, median of the rounds."""
    ports = domain_ports(domain_id)
    found: dict[str, list[float]] = {name: [] for name in PACKETS}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.bind(("127.0.0.1", ports.last))
        own.connect(("127.0.0.1", ports.last))
        for _ in range(rounds):
            without = {name: passage_ns(own, packet) for name, packet in PACKETS.items()}
            with WireCapture(WireOptions(("lo",), rtps_ports=(ports,))):
                for name, packet in PACKETS.items():
                    found[name].append(passage_ns(own, packet) - without[name])
    return {name: float(np.median(times)) for name, times in found.items()}


def passage_ns(own: socket.socket, packet: bytes, count: int = 400) -> float:
    """Return the median time from before `send` to behind `recv`."""
    times = []
    for _ in range(count):
        begin_ns = time.perf_counter_ns()
        own.send(packet)
        own.recv(1 << 16)
        times.append(time.perf_counter_ns() - begin_ns)
    return float(np.median(times))


def common(backend: str, domain_id: int) -> list[str]:
    """Options that both roles have."""
    return [str(PROGRAM), "--backend", backend, "--domain", str(domain_id), "--discovery", "localhost"]


@contextmanager
def relay(backend: str, domain_id: int, folder: Path) -> Iterator[None]:
    """Run a relay that serves."""
    command = [
        *common(backend, domain_id),
        "--role",
        "relay",
        "--out",
        str(folder / f"{backend}-relay.mcap"),
        "--force",
    ]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stderr is not None
        for line in process.stderr:
            if "serves domain" in line:
                break
        yield
    finally:
        process.terminate()
        process.communicate()


@contextmanager
def ping(backend: str, size: str, domain_id: int, trace: Path) -> Iterator[None]:
    """Run a ping that sends; its trace is whole behind the block."""
    command = [*common(backend, domain_id), "--role", "ping", "--out", str(trace), "--force", "--size", size,
               "--rate", str(RATE_HZ[size]), "--messages", "1000000"]  # fmt: skip
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        while not trace.exists():
            time.sleep(0.1)
        time.sleep(WARM_UP_S)
        yield
    finally:
        process.send_signal(signal.SIGINT)
        process.wait()


def phase(options: WireOptions | None, phase_s: float) -> tuple[tuple[int, int], WireCounts | None]:
    """Let one phase pass, under a capture or not; its begin and end (CLOCK_MONOTONIC ns), and the capture's counts."""
    with ExitStack() as stack:
        capture = stack.enter_context(WireCapture(options)) if options else None
        if capture:
            capture.begin()
        time.sleep(SETTLING_S)
        begin_ns = time.monotonic_ns()
        time.sleep(phase_s)
        end_ns = time.monotonic_ns()
        return (begin_ns, end_ns), capture.take().counts if capture else None


def measure(backend: str, size: str, domain_id: int, phases: int, phase_s: float, folder: Path) -> Cell | None:
    """Return the cell of one middleware and size; None if no message came back in some phase, on a machine too busy."""
    ports = (domain_ports(domain_id),)
    options = WireOptions(("lo",), rtps_ports=ports, udp_ports=ports, tcp_ports=ports)
    trace = folder / "ping.mcap"
    with relay(backend, domain_id, folder), ping(backend, size, domain_id, trace):
        passed = [phase(options if number % 2 else None, phase_s) for number in range(phases)]
    events = read_trace(trace).events
    sent, received = events[Stage.T1], events[Stage.T2]
    _, at, of = np.intersect1d(sent.sequence, received.sequence, return_indices=True)
    sent_ns, rtt_ns = sent.monotonic_ns[at], (received.monotonic_ns[of] - sent.monotonic_ns[at])
    in_phases = [rtt_ns[(sent_ns >= begin) & (sent_ns < end)] for (begin, end), _ in passed]
    if not all(map(len, in_phases)):
        return None
    percentiles = np.array([np.percentile(found, (50, 99)) for found in in_phases])
    # A watched phase against each of its neighbours, so that a drift of the machine cancels out.
    ratios = [
        percentiles[number] / percentiles[other]
        for number in range(1, phases, 2)
        for other in (number - 1, number + 1)
        if other < phases
    ]
    p50_ratio, p99_ratio = np.median(ratios, axis=0).tolist()
    counts = [found for _, found in passed if found is not None]
    packets = sum(one.packets for one in counts)
    seconds, cpu_s = sum(one.duration_s for one in counts), sum(one.cpu_s for one in counts)
    return Cell(
        backend,
        size,
        p50_ratio,
        p99_ratio,
        tuple(round(float(p50), 3) for p50, _ in ratios),
        float(np.median(percentiles[::2, 0])) / 1e3,
        packets / seconds,
        cpu_s / packets * 1e6,
        cpu_s / seconds,
        sum(one.kernel_drops for one in counts),
    )


def main() -> None:
    """Measure all cells."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--phases", type=int, default=10, help="of each cell, every other one watched")
    parser.add_argument("--phase-s", type=float, default=2)
    parser.add_argument("--domain", type=int, default=60)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    try:
        WireCapture(WireOptions(("lo",))).close()
    except TraceError as err:
        print(f"not measured: {err}")
        return
    added = added_ns(options.domain)
    print(json.dumps({"added_ns": added}) if options.json else f"added to one packet, ns: {added}", flush=True)
    with tempfile.TemporaryDirectory(prefix="dds-trace-bench-") as folder:
        for backend, size in CELLS:
            cell = measure(backend, size, options.domain, options.phases, options.phase_s, Path(folder))
            if cell is None:
                print(f"{backend} {size}: not measured, there is a phase without messages")
            elif options.json:
                print(json.dumps(asdict(cell)))
            else:
                print(
                    f"{cell.backend:10} {cell.size:>5}: RTT p50 x {cell.p50_ratio:.3f}, p99 x {cell.p99_ratio:.3f} "
                    f"(p50 {cell.p50_us:.0f} us without); {cell.packets_per_s:.0f} packets/s at "
                    f"{cell.cpu_us_per_packet:.1f} us, {cell.cpu_share:.1%} of a CPU, {cell.kernel_drops} dropped",
                    flush=True,
                )


if __name__ == "__main__":
    main()
