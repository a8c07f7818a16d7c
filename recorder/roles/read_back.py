"""The settings that a role requested of its middleware, and the ones that its process uses."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from pathlib import Path

from dds_trace.base.records import to_json
from dds_trace.tracefile.format.json_fields import JsonObject

from ..applied.applied import Applied, Traffic, read_applied, with_path
from ..applied.asked import Asked, asked_settings
from ..applied.differences import Difference, Setting, differences, publisher_differences
from ..backends import load_backend
from ..backends.node import Node
from ..choices import Security, WhenFull
from ..errors import NotAppliedError

NEWS_S = 0.02
"""Polling period of a relay before its first probe."""


class ReadBack:
    """The settings of one role, read back before the first message and at the end, never between messages.

    `environment` has the variables as the user set them; `strict` ends the recording if a setting was not applied.
    """

    def __init__(
        self, node: Node, environment: Mapping[str, str], *, strict: bool, note: Callable[[str], None]
    ) -> None:
        options, middleware = node.options, node.middleware
        profile, ignored = load_backend(middleware.backend).profile_of(middleware.rmw, environment)
        if ignored:
            note(ignored)
        self.requested: Asked = asked_settings(
            middleware.vendor,
            domain_id=options.domain_id,
            transport=options.transport.value,
            tuned=options.tuned,
            discovery=options.discovery.value,
            congestion_control=options.congestion_control,
            environment=environment,
            settings=middleware.settings,
            profile=profile,
            buffer_bytes=options.buffer_bytes,
            segment_bytes=options.segment_bytes,
        )
        self._node = node
        priority, when_full = options.priority, options.when_full
        self._publisher_settings = {
            **({} if priority is None else {"priority": str(priority)}),
            **({} if when_full is WhenFull.DEFAULT else {"when_full": when_full.value}),
        }
        self._strict = strict
        self._note = note
        self._applied: Applied | None = None
        self._node_differences: tuple[Difference, ...] = ()
        self._bridge: tuple[Difference, ...] = ()
        self._reported: set[tuple[Setting, str]] = set()

    def read_begin(self) -> None:
        if self._applied is None:
            applied = read_applied()
            self._node_differences = self._compare(applied)
            self._applied = applied

    def read_end(self, traffic: Traffic) -> None:
        if self._applied is not None:
            self._applied = with_path(read_applied(self._applied), traffic)
            self._node_differences = self._compare(self._applied, traffic)

    def _compare(self, applied: Applied, traffic: Traffic | None = None) -> tuple[Difference, ...]:
        different = differences(self.requested, applied, traffic)
        different += publisher_differences(self._publisher_settings, self._node.publisher_settings)
        level = self._node.options.security
        if level is not Security.OFF and not self._node.read_security():
            words = f"asked for -o security={level.value}, and nothing in this process secures its messages"
            different += (Difference(Setting.SECURITY, level.value, "nothing", words),)
        return different

    def note_bridge(self, not_applied: tuple[Difference, ...]) -> None:
        self._bridge = not_applied

    @property
    def _differences(self) -> tuple[Difference, ...]:
        return self._node_differences + self._bridge

    def wait(self, stop: threading.Event, seconds: float) -> bool:
        """Wait for `stop`, or until there is something to `report` (a relay's first probe); return whether it is set."""
        left_s = seconds
        while self._applied is None and left_s > 0:
            slice_s = min(NEWS_S, left_s)
            if stop.wait(slice_s):
                return True
            left_s -= slice_s
        return stop.wait(0 if self._unreported() else max(left_s, 0))

    def _unreported(self) -> list[Difference]:
        # A setting may have other words at the end, but is reported once.
        return [
            difference
            for difference in self._differences
            if (difference.setting, difference.asked) not in self._reported
        ]

    def report(self, trace: Path | None = None) -> None:
        """Note each setting that was not applied, once; a `NotAppliedError` of a strict recording, at the end with the trace's path."""
        unreported = self._unreported()
        self._reported.update((difference.setting, difference.asked) for difference in unreported)
        if unreported and self._strict:
            at_end = "" if trace is None else f" (seen at the end: {trace} is complete, but no answer will use it)"
            raise NotAppliedError(f"-o strict=true: {'; '.join(difference.words for difference in unreported)}{at_end}")
        for difference in unreported:
            self._note(f"not applied: {difference.words}; no answer will use this recording")

    def explain(self, traffic: Traffic) -> tuple[Difference, ...]:
        return differences(self.requested, read_applied(), traffic)

    def fields(self) -> JsonObject:
        described: JsonObject = {"asked": to_json(self.requested)}
        if self._applied is None:
            return described
        return {**described, "applied": to_json(self._applied), "not_applied": to_json(self._differences)}
