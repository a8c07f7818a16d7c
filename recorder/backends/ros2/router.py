"""The router of rmw_zenoh, without which its nodes do not find each other.

Under localhost discovery a node starts one; on a network the user does.
"""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from dds_trace.base.errors import BackendUnavailableError

from ...applied.vendors import ros_middleware
from ...choices import Discovery
from ...host.process import ending_with_parent
from .installation import find_program

PATIENCE_S = 10.0
_ENDPOINT = re.compile(r"connect/endpoints\s*=\s*\[\s*\"tcp/(?P<host>\[[^\]]+\]|[^:\"]+):(?P<port>\d{1,5})")


@dataclass(slots=True)
class Router:
    settings: Mapping[str, str] = field(default_factory=dict)
    process: subprocess.Popen[bytes] | None = None

    def close(self) -> None:
        process, self.process = self.process, None
        if process is None:
            return
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def open_router(rmw: str, discovery: Discovery, patience_s: float = PATIENCE_S) -> Router:
    middleware = ros_middleware(rmw)
    if not middleware.router:
        return Router()
    host, port = _address(middleware.router_port)
    is_local = discovery is Discovery.LOCALHOST
    if _listens(host, port) or (not is_local and _comes_up(host, port, patience_s)):
        return Router({"router": "was running"})
    start = f"start it with `ros2 run {rmw} {middleware.router}`"
    missing = f"{rmw} needs its router, and none listens at {host}:{port}"
    if not is_local:
        raise BackendUnavailableError(f"{missing}; {start}, on each device, and connect the routers (docs of {rmw})")
    program = find_program(rmw, middleware.router)
    if program is None:
        raise BackendUnavailableError(
            f"{missing}; {middleware.router} is not installed here, so {start} elsewhere on this machine"
        )
    router = Router({"router": "started"}, _start(program, port))
    if not _comes_up(host, port, patience_s, router.process):
        has_ended = router.process is not None and router.process.poll() is not None
        router.close()
        fault = "ended at once" if has_ended else f"does not listen within {patience_s:g} s"
        raise BackendUnavailableError(f"{missing}; {program} {fault}: {start} and read its output")
    return router


def _address(port: int) -> tuple[str, int]:
    match = _ENDPOINT.search(os.environ.get("ZENOH_CONFIG_OVERRIDE", ""))
    return (match["host"].strip("[]"), int(match["port"])) if match else ("localhost", port)


def _listens(host: str, port: int) -> bool:
    with suppress(OSError), socket.create_connection((host, port), timeout=1.0):
        return True
    return False


def _comes_up(host: str, port: int, patience_s: float, process: subprocess.Popen[bytes] | None = None) -> bool:
    end_s = time.monotonic() + patience_s
    while not _listens(host, port):
        if time.monotonic() > end_s or (process is not None and process.poll() is not None):
            return False
        time.sleep(0.05)
    return True


def _start(program: Path, port: int) -> subprocess.Popen[bytes]:
    overrides = filter(None, (os.environ.get("ZENOH_CONFIG_OVERRIDE"), f'listen/endpoints=["tcp/localhost:{port}"]'))
    environment = {**os.environ, "ZENOH_CONFIG_OVERRIDE": ";".join(overrides)}
    return subprocess.Popen(
        [*ending_with_parent(), str(program)],
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
