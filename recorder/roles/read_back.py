"""The settings that a role asked its middleware for, beside those that its process is seen to use."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..applied.applied import read_applied
from ..applied.asked import Asked, asked_settings
from ..applied.carried import with_path
from ..applied.differences import differences
from ..errors import NotAppliedError

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from dds_trace.tracefile.format.json_fields import JsonObject

    from ..applied.applied import Applied
    from ..applied.carried import Traffic
    from ..applied.differences import Difference, Setting
    from ..backends.node import Node

NEWS_S = 0.02
"""Time between two looks at whether there is something to tell, before a relay's first probe."""


class ReadBack:
    """The settings of one role, read back before the first message and at the end, and never between messages.

    Args:
        node: the open node of the role.
        environment: variables as the user set them, without those that the recorder adds.
        strict: whether a setting that was not applied ends the recording.
        note: callback that takes a line for the user.
    """

    def __init__(
        self, node: Node, environment: Mapping[str, str], *, strict: bool, note: Callable[[str], None]
    ) -> None:
        options, middleware = node.options, node.middleware
        self.asked: Asked = asked_settings(
            middleware.vendor,
            domain_id=options.domain_id,
            transport=options.transport.value,
            tuned=options.tuned,
            discovery=options.discovery.value,
            congestion_control=options.congestion_control,
            environment=environment,
            settings=middleware.settings,
        )
        self._strict = strict
        self._note = note
        self._applied: Applied | None = None
        self._own: tuple[Difference, ...] = ()
        self._of_bridge: tuple[Difference, ...] = ()
        self._told: set[tuple[Setting, str]] = set()

    def read_begin(self) -> None:
        """Read what the process uses before the first message; a second call changes nothing.

        It takes some milliseconds, and any thread may call it: nothing is said before `tell`.
        """
        if self._applied is None:
            applied = read_applied()
            self._own = differences(self.asked, applied)
            self._applied = applied

    def read_end(self, traffic: Traffic) -> None:
        """Read what the process uses behind the last message.

        Args:
            traffic: messages since `read_begin`.
        """
        if self._applied is not None:
            self._applied = with_path(read_applied(self._applied), traffic)
            self._own = differences(self.asked, self._applied, traffic)

    def note_bridge(self, not_applied: tuple[Difference, ...]) -> None:
        """Take what the programs of the bridge do not use into `tell` and `fields`, in place of what was noted before."""
        self._of_bridge = not_applied

    @property
    def _differences(self) -> tuple[Difference, ...]:
        return self._own + self._of_bridge

    def wait(self, stop: threading.Event, seconds: float) -> bool:
        """Wait for `stop`, but no longer than until there is something to `tell`; return whether `stop` is set.

        A relay reads its beginning on the thread that answers the first probe, and a ping's first message comes a fifth of a
        second behind the last echo: until then looks are frequent.
        """
        left_s = seconds
        while self._applied is None and left_s > 0:
            slice_s = min(NEWS_S, left_s)
            if stop.wait(slice_s):
                return True
            left_s -= slice_s
        return stop.wait(0 if self._untold() else max(left_s, 0))

    def _untold(self) -> list[Difference]:
        # At the end a setting that was told at the beginning may have other words, but it is the same news.
        return [each for each in self._differences if (each.setting, each.asked) not in self._told]

    def tell(self, trace: Path | None = None) -> None:
        """Say each setting that was not applied and was not told before.

        Args:
            trace: path of the whole trace, at the end of a recording.

        Raises:
            NotAppliedError: there is one, and the recording is strict.
        """
        untold = self._untold()
        self._told.update((each.setting, each.asked) for each in untold)
        if untold and self._strict:
            kept = (
                ""
                if trace is None
                else f" (seen at the end: {trace} is whole, and no answer will rest on it)"
            )
            raise NotAppliedError(f"--strict: {'; '.join(each.words for each in untold)}{kept}")
        for each in untold:
            self._note(f"not applied: {each.words}; no answer will rest on this recording")

    def explain(self, traffic: Traffic) -> tuple[Difference, ...]:
        """Return the settings that may keep messages from arriving; empty if nothing is seen.

        Args:
            traffic: messages that were sent in vain.
        """
        return differences(self.asked, read_applied(), traffic)

    def fields(self) -> JsonObject:
        """Return the session's fields `asked`, and behind `read_begin` `applied` and `not_applied`."""
        asked: JsonObject = {"asked": self.asked.to_json()}
        if self._applied is None:
            return asked
        return {
            **asked,
            "applied": self._applied.to_json(),
            "not_applied": [each.to_json() for each in self._differences],
        }
