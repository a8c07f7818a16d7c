"""Two network namespaces joined by `lossy_forwarder`, and recordings over it under a capture."""

import itertools
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from waiting import PATIENCE_S, read_past
from wire_truth import Truth, truth_of

from dds_trace.base.errors import BackendUnavailableError
from dds_trace.base.records import from_json, to_json
from dds_trace.extensions.campaigns.station.emulation import INTERFACE, ip, open_tap, tc
from dds_trace.extensions.campaigns.station.namespaces import Side
from dds_trace.extensions.wire.capture import WireOptions
from dds_trace.extensions.wire.counts import WireCounts

SUPPORT = Path(__file__).parent
_FROM_ENVIRONMENT = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_LOCALHOST_ONLY": "", "ROS_DOMAIN_ID": ""}
"""The tests' own environment keeps to this machine; a namespace may look around."""
_counter = itertools.count(1000)  # not a number of `NamespacePair`, which clears stale names of this pattern away


@dataclass
class LossyLink:
    sides: tuple[Side, Side]
    log: Path
    forwarder: subprocess.Popen[str]

    def start(self, side: int, *command: object) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [*self.sides[side].prefix, *map(str, command)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, **_FROM_ENVIRONMENT},
        )

    def watch(self, side: int, options: WireOptions, out: Path, *command: object) -> str:
        """Run a command to its end under a capture that writes `out`; what it printed."""
        session = self.start(side, *session_of(options, out), *command)
        said = session.communicate(timeout=150)
        assert session.returncode == 0, said
        return said[0]

    def stop(self) -> None:
        self.forwarder.communicate(timeout=PATIENCE_S)


@contextmanager
def lossy_link(
    folder: Path, loss: float, rate_mbit: int = 200, seed: int = 1, log: Path | None = None
) -> Iterator[LossyLink]:
    """A link from its start to its end; the kernel's token bucket holds each sender back."""
    log = log or folder / "frames.bin"
    number = next(_counter)
    with ExitStack() as made:
        sides = tuple(
            Side(f"ddstrace-{os.getpid()}-{number}-{role}", f"10.213.1.{host}")
            for host, role in enumerate(("ping", "relay"), 1)
        )
        taps = []
        for side in sides:
            ip("netns", "add", side.namespace)
            made.callback(_remove, side)
            taps.append(open_tap(f"ddt{os.getpid()}.{number}{side.namespace[-1]}", side.namespace))
            made.callback(os.close, taps[-1])
            namespace = ("-n", side.namespace)
            ip(*namespace, "link", "set", "lo", "up")
            ip(*namespace, "address", "add", f"{side.address}/24", "dev", INTERFACE)
            ip(*namespace, "link", "set", INTERFACE, "up", "txqueuelen", "5000")
            ip(*namespace, "route", "add", "224.0.0.0/4", "dev", INTERFACE)
            tc(*namespace, "qdisc", "add", "dev", INTERFACE, "root", "tbf", "rate", f"{rate_mbit}mbit",
               "burst", "20kb", "limit", "8mb")  # fmt: skip
        for tap in taps:
            os.set_blocking(tap, True)
        forwarder = subprocess.Popen(
            [sys.executable, "-I", "-S", SUPPORT / "lossy_forwarder.py", *map(str, taps), log, str(loss), str(seed)],
            stdin=subprocess.PIPE,
            text=True,
            pass_fds=taps,
        )
        made.callback(_end, forwarder)
        yield LossyLink(sides, log, forwarder)  # type: ignore[arg-type]


@dataclass
class Watched:
    """A recording over the link: what each side's capture says, and what the forwarder knows."""

    counts: tuple[WireCounts, WireCounts]
    rows: tuple[np.ndarray, np.ndarray]
    truth: tuple[Truth, Truth]


def record_watched(
    folder: Path, options: WireOptions, backend: str, *ping_options: object, loss: float, rate_mbit: int = 200
) -> Watched:
    """Ping and relay over a lossy link, each under a capture of its own from its start to its end."""
    program = Path(sys.executable).with_name("dds-record")
    both = ("--backend", backend, "--domain", 30)
    with lossy_link(folder, loss, rate_mbit) as link:
        relay = (program, "--role", "relay", *both, "--out", folder / "relay.mcap")
        with running_session(link, 1, *session_of(options, folder / "relay"), *relay) as session:
            read_past(session.stderr, "serves domain")
            peer = ("--peer", link.sides[1].address) if backend in ("socket", "zenoh") else ()
            ping = (program, "--role", "ping", *both, "--out", folder / "ping.mcap", *peer, *ping_options)
            link.watch(0, options, folder / "ping", *ping)
        link.stop()
        roles = ("ping", "relay")
        return Watched(
            tuple(from_json(WireCounts, json.loads((folder / f"{role}.json").read_text())) for role in roles),
            tuple(np.load(folder / f"{role}.npy") for role in roles),
            (truth_of(link.log, 0), truth_of(link.log, 1)),
        )


def session_of(options: WireOptions, out: Path) -> tuple[object, ...]:
    return (sys.executable, SUPPORT / "wire_session.py", json.dumps(to_json(options)), out)


@contextmanager
def running_session(link: LossyLink, side: int, *command: object) -> Iterator[subprocess.Popen[str]]:
    """A command, under a capture or not, that is ended with the block; a session still writes what it has."""
    session = link.start(side, *command)
    try:
        yield session
    finally:
        session.terminate()
        session.communicate(timeout=PATIENCE_S)


def _end(process: subprocess.Popen[str]) -> None:
    if process.poll() is None:
        process.communicate(timeout=PATIENCE_S)


def _remove(side: Side) -> None:
    with suppress(BackendUnavailableError):
        ip("netns", "delete", side.namespace)
