"""A ping and a relay on one backend as two processes, and what each read back of itself."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from waiting import PATIENCE_S, read_past

from dds_trace.base.records import from_json
from dds_trace.recorder.applied.applied import Applied, Traffic
from dds_trace.recorder.applied.asked import Asked
from dds_trace.recorder.applied.vendors import BUFFER_BYTES

LIMIT_BYTES = min(int(Path(f"/proc/sys/net/core/{name}").read_text()) for name in ("rmem_max", "wmem_max"))
needs_large_buffers = pytest.mark.skipif(
    LIMIT_BYTES < BUFFER_BYTES,
    reason=f"net.core.rmem_max or wmem_max is {LIMIT_BYTES}, and --tuned asks for {BUFFER_BYTES}",
)
"""Of tests in which `--tuned` must be applied; with less it is the difference `kernel_limit`."""

PAYLOAD_BYTES, MESSAGES = 502_000, 30


@dataclass(frozen=True)
class Report:
    asked: Asked
    applied: Applied
    traffic: Traffic
    at_begin: list[tuple[str, str]]
    at_end: list[tuple[str, str]]
    rtt_ms: list[float]

    @property
    def settings(self) -> list[str]:
        return [setting for setting, _ in self.at_end]


def _report(said: str) -> Report:
    data = json.loads(next(line for line in said.splitlines() if line.startswith("{")))
    return Report(
        from_json(Asked, data["asked"]),
        from_json(Applied, data["applied"]),
        Traffic(*data["traffic"]),
        [tuple(each) for each in data["at_begin"]],
        [tuple(each) for each in data["at_end"]],
        data.get("rtt_ms", []),
    )


def run_pair(
    backend: str,
    domain_id: int,
    *,
    transport: str = "default",
    tuned: bool = False,
    discovery: str = "localhost",
    payload_bytes: int = PAYLOAD_BYTES,
    messages: int = MESSAGES,
    period_s: float = 0.02,
    attempts: int = 60,
    environment: dict[str, str] | None = None,
    zenoh_memory: bool | None = None,
    asked: dict[str, object] | None = None,
    variables: dict[str, str] | None = None,
    ping: dict[str, object] | None = None,
    relay: dict[str, object] | None = None,
    relay_prefix: tuple[str, ...] = (),
    prefix: tuple[str, ...] = (),
) -> tuple[Report, Report]:
    """Send messages there and back; what ping and relay read back.

    Args:
        attempts: messages until the first echo, two a second, after which the ping gives up; earlier if a setting explains
            that none comes.
        environment: replaces what the product sets for rclpy, None to leave that as it is.
        zenoh_memory: zenoh's shared memory on or off, None for its default.
        asked: fields of `Asked` that differ from what the options say.
        variables: of both processes from their start, as a user sets them.
        ping: what the ping is given that differs (`backend`, `transport`, `environment` ...).
        relay: what the relay is given that differs.
        relay_prefix: a command that becomes the relay.
        prefix: a command that becomes either side.
    """
    given = {
        "backend": backend,
        "domain_id": domain_id,
        "transport": transport,
        "tuned": tuned,
        "discovery": discovery,
        "payload_bytes": payload_bytes,
        "messages": messages,
        "period_s": period_s,
        "attempts": attempts,
        "environment": environment,
        "zenoh_memory": zenoh_memory,
        "asked": asked or {},
    }
    with _side({**given, **(relay or {}), "role": "relay"}, variables, (*prefix, *relay_prefix)) as relaying:
        try:
            read_past(relaying.stdout, "ready")
            with _side({**given, **(ping or {}), "role": "ping"}, variables, prefix) as pinging:
                try:
                    said, _ = pinging.communicate(timeout=PATIENCE_S)
                finally:
                    pinging.kill()
            answered, _ = relaying.communicate(timeout=PATIENCE_S)  # closes its stdin
        finally:
            relaying.kill()
    assert (pinging.returncode, relaying.returncode) == (0, 0)
    return _report(said), _report(answered)


@contextmanager
def relaying(backend: str, domain_id: int) -> Iterator[subprocess.Popen[str]]:
    """A relay that serves, of the product's defaults under localhost discovery; it is killed behind the block."""
    given = {
        "role": "relay",
        "backend": backend,
        "domain_id": domain_id,
        "transport": "default",
        "tuned": False,
        "discovery": "localhost",
        "payload_bytes": PAYLOAD_BYTES,
        "environment": None,
        "zenoh_memory": None,
        "asked": {},
    }
    with _side(given, None) as relay:
        try:
            read_past(relay.stdout, "ready")
            yield relay
        finally:
            relay.kill()


def _side(
    given: dict[str, object], variables: dict[str, str] | None, prefix: tuple[str, ...] = ()
) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*prefix, sys.executable, Path(__file__).with_name("applied_side.py"), json.dumps(given)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, **(variables or {})},
    )
