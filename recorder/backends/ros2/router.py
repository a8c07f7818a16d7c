"""The router of rmw_zenoh: without one its nodes do not find each other, and nothing says so.

One that listens already is used. Else a node that stays on this machine starts the program of the RMW's package, for itself
and for whoever comes meanwhile, and ends it with itself; on a network, where routers of several devices have to know each
other, one is waited for, and then the user is told to start it.
"""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.base.errors import BackendUnavailableError

from ...applied.vendors import ros_middleware
from ...choices import Discovery
from ...host.process import ending_with_parent

if TYPE_CHECKING:
    from collections.abc import Mapping

PATIENCE_S = 10.0
"""Longest wait until a router that was started listens."""
_ENDPOINT = re.compile(r"connect/endpoints\s*=\s*\[\s*\"tcp/(?P<host>\[[^\]]+\]|[^:\"]+):(?P<port>\d{1,5})")


@dataclass(slots=True)
class Router:
    """The router of a node.

    Attributes:
        settings: what the session tells of it; empty where the RMW needs none.
        process: the router that we started, None for another's.
    """

    settings: Mapping[str, str] = field(default_factory=dict)
    process: subprocess.Popen[bytes] | None = None

    def close(self) -> None:
        """End the router that we started."""
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
    """Return the router that nodes of an RMW need here: one that listens, or under localhost discovery one that is started.

    Args:
        rmw: identifier of the running ROS middleware.
        discovery: range of the node.
        patience_s: longest wait for one that was started.

    Raises:
        BackendUnavailableError: nobody listens, and none is started, is installed or comes up.
    """
    known = ros_middleware(rmw)
    if not known.router:
        return Router()
    host, port = _address(known.router_port)
    is_local = discovery is Discovery.LOCALHOST
    if _listens(host, port) or (not is_local and _comes_up(host, port, patience_s)):
        return Router({"router": "was running"})
    start = f"start it with `ros2 run {rmw} {known.router}`"
    nobody = f"{rmw} needs its router, and nobody listens at {host}:{port}"
    if not is_local:
        raise BackendUnavailableError(
            f"{nobody}; {start}, on each device, and connect the routers (docs of {rmw})"
        )
    program = _find_program(rmw, known.router)
    if program is None:
        raise BackendUnavailableError(
            f"{nobody}; {known.router} is not installed here, so {start} elsewhere on this machine"
        )
    router = Router({"router": "started"}, _start(program, port))
    if not _comes_up(host, port, patience_s, router.process):
        ended = router.process is not None and router.process.poll() is not None
        router.close()
        what = "ended at once" if ended else f"does not listen within {patience_s:g} s"
        raise BackendUnavailableError(f"{nobody}; {program} {what}: {start} and look at what it says")
    return router


def _address(port: int) -> tuple[str, int]:
    """Return where the nodes of this process look for the router: where ZENOH_CONFIG_OVERRIDE says, else at this device."""
    named = _ENDPOINT.search(os.environ.get("ZENOH_CONFIG_OVERRIDE", ""))
    return (named["host"].strip("[]"), int(named["port"])) if named else ("localhost", port)


def _listens(host: str, port: int) -> bool:
    with suppress(OSError), socket.create_connection((host, port), timeout=1.0):
        return True
    return False


def _comes_up(
    host: str, port: int, patience_s: float, process: subprocess.Popen[bytes] | None = None
) -> bool:
    """Wait until a router listens, in vain if the process that should has ended; return whether it does."""
    end_s = time.monotonic() + patience_s
    while not _listens(host, port):
        if time.monotonic() > end_s or (process is not None and process.poll() is not None):
            return False
        time.sleep(0.05)
    return True


def _find_program(package: str, name: str) -> Path | None:
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    places = (Path(prefix, "lib", package, name) for prefix in prefixes if prefix)
    return next((place for place in places if os.access(place, os.X_OK)), None)


def _start(program: Path, port: int) -> subprocess.Popen[bytes]:
    """Start the router for this machine alone; it ends with us, however we end, where the system has `setpriv`."""
    own = f'listen/endpoints=["tcp/localhost:{port}"]'
    asked = os.environ.get("ZENOH_CONFIG_OVERRIDE", "")
    environment = {**os.environ, "ZENOH_CONFIG_OVERRIDE": f"{asked};{own}" if asked else own}
    return subprocess.Popen(
        [*ending_with_parent(), str(program)],
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C is for the recording, which ends it when its last message is through
    )
