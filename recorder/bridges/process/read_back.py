"""The settings of a bridge's program, read back from outside: what its process uses, beside what it was asked for."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

import psutil

from ...applied.applied import read_applied
from ...applied.asked import asked_settings
from ...applied.differences import differences

if TYPE_CHECKING:
    from dds_trace.tracefile.format.json_fields import Json

    from ...applied.applied import Applied
    from ...applied.asked import Asked
    from ...applied.differences import Difference
    from ..options import BridgeOptions

WITHIN = {"zenoh-bridge-dds": "cyclonedds", "zenoh-bridge-ros2dds": "cyclonedds"}
"""Name of a bridge -> middleware that is compiled into its program, where no loaded library tells it."""

NOT_BRIDGED = ("zenoh", "socket")
"""Middlewares that join the halves of a bridge; `--transport` and `--tuned` are for those that join its domains."""


class ProgramReadBack:
    """What one program of a bridge uses, read when an echo has come through it and again before it is stopped.

    Args:
        bridge: name of the bridge.
        options: options of the program, whose `transport` and `tuned` are compared with what it uses.
        pid: its process; where that only starts another one (a script), the first of its children that has sockets is read.
    """

    def __init__(self, bridge: str, options: BridgeOptions, pid: int) -> None:
        self._bridge = bridge
        self._options = options
        self._pid = pid
        self._asked: tuple[Asked, ...] = ()
        self._applied: Applied | None = None

    def read(self) -> None:
        """Read what the program uses: at first its beginning, later its end. A program that has ended is not read."""
        if self._applied is None:
            self._pid = self._pid_with_sockets()
        applied = read_applied(self._applied, self._pid)
        if applied.latest.sockets is None:  # it has ended, or is another user's
            return
        self._applied = applied
        loaded = (each.vendor for each in applied.begin.libraries if each.vendor not in NOT_BRIDGED)
        vendor = next(loaded, WITHIN.get(self._bridge, ""))
        self._asked = tuple(
            asked_settings(
                vendor,
                domain_id=side.domain_id,
                transport=self._options.transport.value,
                tuned=self._options.tuned,
                discovery=self._options.discovery.value,
            )
            for side in self._options.sides()
        )

    def _pid_with_sockets(self) -> int:
        pids = [self._pid]
        with suppress(psutil.Error):
            pids += [child.pid for child in psutil.Process(self._pid).children(recursive=True)]
        return next((pid for pid in pids if read_applied(pid=pid).begin.sockets), self._pid)

    @property
    def not_applied(self) -> tuple[Difference, ...]:
        """The settings that the program was asked for and does not use, in words that name the bridge; each once."""
        if self._applied is None:
            return ()
        found = {
            each.setting: each for asked in self._asked for each in differences(asked, self._applied)
        }.values()
        return tuple(
            replace(
                each, asked=f"{self._bridge}: {each.asked}", words=f"the bridge {self._bridge}: {each.words}"
            )
            for each in found
        )

    def fields(self) -> dict[str, Json]:
        """Return `asked` (a list, by domain), `applied` and `not_applied` of the program; nothing before it was read."""
        if self._applied is None:
            return {}
        return {
            "asked": [each.to_json() for each in self._asked],
            "applied": self._applied.to_json(),
            "not_applied": [each.to_json() for each in self.not_applied],
        }
