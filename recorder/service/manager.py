"""Words to the service manager that started this process (sd_notify(3)): ready, what it does, that it lives, that it ends."""

from __future__ import annotations

import os
import socket
import time
from contextlib import suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, MutableMapping

STATUS_PERIOD_S = 5.0
"""Time between two statuses: each wakes the manager."""


class ServiceManager:
    """The manager at NOTIFY_SOCKET; without one, or one that does not listen, every word goes nowhere.

    The variables are taken out of the environment, so that no program of ours speaks for us.

    Args:
        environment: where they stand.
        clock_s: a monotonic clock in seconds.
    """

    def __init__(
        self,
        environment: MutableMapping[str, str] = os.environ,
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        address = environment.pop("NOTIFY_SOCKET", "")
        watchdog_us, for_pid = environment.pop("WATCHDOG_USEC", ""), environment.pop("WATCHDOG_PID", "")
        self._clock_s = clock_s
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._is_watched = watchdog_us.isdecimal() and for_pid in ("", str(os.getpid()))
        self._socket = (
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) if address else None
        )
        self._is_ready = False
        self._told_s = -STATUS_PERIOD_S
        if self._socket is not None:
            self._socket.setblocking(False)  # a manager that is stuck holds nobody up

    def look(self, status: str) -> None:
        """Tell that this process lives, at the first call that it is ready, and now and then what it does."""
        if self._socket is None:
            return
        words = ["WATCHDOG=1"] if self._is_watched else []
        if not self._is_ready:
            self._is_ready = True
            words.insert(0, "READY=1")
        if self._clock_s() - self._told_s >= STATUS_PERIOD_S:
            self._told_s = self._clock_s()
            words.append(f"STATUS={status}")
        self._send(words)

    def close(self) -> None:
        """Tell that this process ends."""
        if self._socket is not None:
            self._send(["STOPPING=1"])
            self._socket.close()
            self._socket = None

    def _send(self, words: list[str]) -> None:
        if self._socket is not None and words:
            with suppress(OSError):
                self._socket.sendto("\n".join(words).encode(errors="replace"), self._address)
