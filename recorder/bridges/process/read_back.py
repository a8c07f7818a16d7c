"""The settings that a bridge's program uses, and the requested ones."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import psutil

from dds_trace.tracefile.format.json_fields import Json

from ...applied.applied import Applied, read_applied
from ...applied.asked import Asked, asked_settings
from ...applied.differences import Difference, differences
from ..base import Bridge, BridgeOptions

LINK_MIDDLEWARES = ("zenoh", "socket")
"""Middlewares that join the halves of a bridge; `--transport` and `--tuned` are not for them."""


class ProgramReadBack:
    """What one program of a bridge uses, read after the first echo and before the program is stopped."""

    def __init__(self, bridge: Bridge, options: BridgeOptions, pid: int) -> None:
        self._bridge = bridge
        self._options = options
        self._pid = pid  # or its first child that has sockets, if it is a script
        self._requested: tuple[Asked, ...] = ()
        self._applied: Applied | None = None

    def read(self) -> None:
        if self._applied is None:
            self._pid = self._pid_with_sockets()
        applied = read_applied(self._applied, self._pid)
        if applied.latest.sockets is None:  # it has ended, or is another user's
            return
        self._applied = applied
        vendors = (library.vendor for library in applied.begin.libraries)
        vendor = next((vendor for vendor in vendors if vendor not in LINK_MIDDLEWARES), self._bridge.compiled_in)
        self._requested = tuple(
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
        if self._applied is None:
            return ()
        name = self._bridge.name
        by_setting = {
            difference.setting: replace(
                difference, asked=f"{name}: {difference.asked}", words=f"the bridge {name}: {difference.words}"
            )
            for requested in self._requested
            for difference in differences(requested, self._applied)
        }
        return tuple(by_setting.values())

    def fields(self) -> dict[str, Json]:
        if self._applied is None:
            return {}
        return {
            "asked": [requested.to_json() for requested in self._requested],
            "applied": self._applied.to_json(),
            "not_applied": [difference.to_json() for difference in self.not_applied],
        }
