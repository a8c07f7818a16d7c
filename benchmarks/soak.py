"""A relay that serves run after run for minutes: how its memory, open files and shared memory grow with the runs.

    python benchmarks/soak.py [MINUTES] [--backend ros2] [--out FILE.json]

Each run has a run id and endpoints of its own, every tenth a new node, as another `dds-trace record ping` has; four processes
send them side by side, new ones after every hundred runs. The relay is the command itself, with `--rotate 2min --keep 3`. Ends with
1 if the slope behind the first fifth is above `MOST_KB_PER_1000_RUNS`, or open files or shared memory grew.
"""

from __future__ import annotations

import argparse
import json
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.recorder.backends import open_node
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.choices import Discovery
from dds_trace.recorder.options import PingOptions, RecordOptions
from dds_trace.recorder.payloads import open_payload
from dds_trace.recorder.roles.floor import measuring_session
from dds_trace.recorder.roles.ping import open_ping
from dds_trace.recorder.roles.plan import plan_run
from dds_trace.tracefile.format.descriptions import Qos
from dds_trace.tracefile.writing.destination import TraceDestination
from dds_trace.tracefile.writing.sink import TraceSink

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from dds_trace.recorder.backends.node import Node
    from dds_trace.recorder.payloads.base import Payload

DOMAIN = 93
RUNS_OF_A_PROCESS = 100
RUNS_OF_A_NODE = 10
SENDERS = 4
MESSAGES = 20
RATE_HZ = 200.0
DEPTH = 200  # each of the runs side by side hears the replies to all
LOOK_S = 5.0
MOST_KB_PER_1000_RUNS = 500.0
"""Weeks of a run every ten seconds are 60,000 runs a week: 30 MB."""


@dataclass(frozen=True, slots=True)
class Sample:
    """The relay after a number of runs; sizes in KB, shared memory as far as it maps it."""

    runs: int
    elapsed_s: float
    rss_kb: int
    anonymous_kb: int
    open_files: int
    threads: int
    shm_files: int
    shm_kb: int


def send_runs(backend: str, runs: int) -> None:
    """Send runs to the relay, each with endpoints of its own and every tenth from a new node; print a line for each."""
    node_options = NodeOptions(DOMAIN, discovery=Discovery.LOCALHOST, qos=Qos(depth=DEPTH))
    for _ in range(0, runs, RUNS_OF_A_NODE):
        with tempfile.TemporaryDirectory() as folder, open_node(backend, node_options) as node:
            node.start()
            for number in range(RUNS_OF_A_NODE):
                _send_run(node, backend, Path(folder, f"{number}.mcap"))


def _send_run(node: Node, backend: str, path: Path) -> None:
    asked = PingOptions(data="binary", size_bytes=1000, rate_hz=RATE_HZ, messages=MESSAGES, warmup=0)
    destination = TraceDestination(path, ring_slots=256)
    options = RecordOptions(destination, node.options, asked, backend)
    with _payload() as payload:
        ping = open_ping(node, plan_run(options, asked, payload, session_id=1, seed=0))
        came = ping.wait_for_echo(30.0, threading.Event())
        sink = TraceSink(destination, measuring_session())
        run = ping.run(sink, threading.Event()) if came else None
        sink.close()
        ping.close()
    published = 0 if run is None else run.published
    print(json.dumps({"published": published, "received": ping.progress().received}), flush=True)


def _payload() -> AbstractContextManager[Payload]:
    def refuse() -> Node:
        raise AssertionError("made up data needs no node")

    return open_payload("binary", 1000, 0, open_node=refuse, wait_s=0.0, stop=threading.Event())


class Soak:
    """One relay and the processes that send to it."""

    def __init__(self, backend: str, minutes: float, folder: Path, out: Path | None) -> None:
        self.backend = backend
        self._out = out
        self.end_s = time.monotonic() + minutes * 60
        self.runs = self.published = self.received = 0
        self.samples: list[Sample] = []
        self._lock = threading.Lock()
        relay = [str(Path(sys.executable).with_name("dds-record")), "--role", "relay", "--backend", backend]
        relay += ["--domain", str(DOMAIN), "--discovery", "localhost", "--rotate", "2min", "--keep", "3"]
        relay += ["--depth", str(DEPTH)]
        self._relay = subprocess.Popen([*relay, "--out", str(folder / "relay.mcap")], stderr=subprocess.PIPE, text=True)
        assert self._relay.stderr is not None
        if not any("serves" in line for line in self._relay.stderr):
            raise RuntimeError("the relay ended before it served")
        threading.Thread(target=self._relay.stderr.read, daemon=True).start()

    def measure(self) -> list[Sample]:
        """Send for the time asked for, and return the relay's samples."""
        began_s = time.monotonic()
        try:
            with ThreadPoolExecutor(SENDERS) as pool:
                for _ in range(SENDERS):
                    pool.submit(self._keep_sending)
                while time.monotonic() < self.end_s and self._relay.poll() is None:
                    time.sleep(LOOK_S)
                    self._look(time.monotonic() - began_s)
            self._look(time.monotonic() - began_s)
        finally:
            self._relay.send_signal(signal.SIGTERM)
            self._relay.wait(60)
        return self.samples

    def _keep_sending(self) -> None:
        while time.monotonic() < self.end_s and self._relay.poll() is None:
            words = [sys.executable, __file__, "--send", str(RUNS_OF_A_PROCESS), "--backend", self.backend]
            with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as sender:
                assert sender.stdout is not None
                for line in sender.stdout:
                    if not line.startswith("{"):  # a middleware's own words
                        continue
                    told = json.loads(line)
                    with self._lock:
                        self.runs += 1
                        self.published += told["published"]
                        self.received += told["received"]
                    if time.monotonic() >= self.end_s:
                        sender.terminate()

    def _look(self, elapsed_s: float) -> None:
        self.samples.append(self._sample(elapsed_s))
        if self._out is not None:
            self._out.write_text(json.dumps([asdict(each) for each in self.samples]))

    def _sample(self, elapsed_s: float) -> Sample:
        process = Path(f"/proc/{self._relay.pid}")
        lines = (process / "status").read_text().splitlines()
        status = {name: words.split() for name, _, words in (line.partition(":") for line in lines)}
        mapped = {line.split()[-1] for line in (process / "maps").read_text().splitlines() if "/dev/shm/" in line}
        shared = [Path(path).stat() for path in mapped if Path(path).exists()]
        return Sample(
            self.runs,
            round(elapsed_s, 1),
            int(status["VmRSS"][0]),
            int(status["RssAnon"][0]),
            len(list((process / "fd").iterdir())),
            int(status["Threads"][0]),
            len(mapped),
            sum(each.st_blocks for each in shared) // 2,
        )


def slope_per_1000(samples: list[Sample], name: str) -> float:
    """Return the growth of a field for 1000 runs, by least squares."""
    runs, values = [each.runs for each in samples], [getattr(each, name) for each in samples]
    return 1000 * statistics.linear_regression(runs, values).slope


def main() -> int:
    """Soak a relay and print what it does to it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("minutes", nargs="?", type=float, default=30.0)
    parser.add_argument("--backend", default="ros2")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--send", type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.send is not None:
        send_runs(arguments.backend, arguments.send)
        return 0
    with tempfile.TemporaryDirectory() as folder:
        soak = Soak(arguments.backend, arguments.minutes, Path(folder), arguments.out)
        samples = soak.measure()
    settled = [each for each in samples if each.runs >= samples[-1].runs / 5]
    if len({each.runs for each in settled}) < 2:
        print(f"{soak.runs} runs: too few for a slope")
        return 1
    first, last = settled[0], settled[-1]
    slope = slope_per_1000(settled, "rss_kb")
    print(
        f"{arguments.backend}: {soak.runs} runs, {soak.received} of {soak.published} messages came back, {last.elapsed_s:.0f} s"
    )
    print(f"resident memory {first.rss_kb} -> {last.rss_kb} KB: {slope:+.0f} KB per 1000 runs behind the first fifth")
    print(
        f"anonymous memory {first.anonymous_kb} -> {last.anonymous_kb} KB: {slope_per_1000(settled, 'anonymous_kb'):+.0f} KB per 1000 runs"
    )
    print(f"open files {first.open_files} -> {last.open_files}, threads {first.threads} -> {last.threads}")
    print(f"mapped files of /dev/shm {first.shm_files} -> {last.shm_files}, {first.shm_kb} -> {last.shm_kb} KB")
    grows = slope_per_1000(settled, "open_files") > 1 or slope_per_1000(settled, "shm_files") > 1
    return int(slope > MOST_KB_PER_1000_RUNS or grows)


if __name__ == "__main__":
    sys.exit(main())
