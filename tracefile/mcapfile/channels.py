"""Which topic a MCAP channel id stands for, and whether its messages can be events."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mcap.opcode import Opcode

from ..errors import TraceFormatError
from ..format.events import EVENT_SCHEMA_NAME, STAGE_OF_TOPIC
from .records import LAYOUTS

if TYPE_CHECKING:
    from collections.abc import ItemsView
    from pathlib import Path

    from ..format.events import Stage


@dataclass(frozen=True, slots=True)
class Channel:
    """One channel.

    Attributes:
        stage: the stage whose events it holds; None for every other topic.
        fault: why its messages cannot be events although its topic is a stage's; else None.
    """

    topic: str
    stage: Stage | None
    fault: str | None


class ChannelTable:
    """All channels that a file has declared so far."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, Channel] = {}

    def get(self, channel_id: int) -> Channel | None:
        """The channel, None while it is not declared."""
        return self._channels.get(channel_id)

    def items(self) -> ItemsView[int, Channel]:
        """All channels with their ids."""
        return self._channels.items()

    def declare(self, opcode: int, content: bytes | memoryview, offset: int) -> None:
        """Take note of a Schema or Channel record; `offset` is where it lies in the file.

        Raises:
            TraceFormatError: it is damaged, or gives a known channel id another topic.
        """
        try:
            fields = LAYOUTS[Opcode(opcode)].parse(content)
        except ValueError as err:
            name = LAYOUTS[Opcode(opcode)].name
            raise TraceFormatError(self._path, f"a {name} record is damaged ({err})", offset) from err
        if opcode == Opcode.SCHEMA:
            self._schemas[fields["id"]] = fields["name"]
            return
        channel_id, topic = fields["id"], fields["topic"]
        known = self._channels.get(channel_id)
        if known is not None and known.topic != topic:
            raise TraceFormatError(
                self._path,
                f"channel {channel_id} is {known.topic!r} and here {topic!r}; its messages cannot be told apart",
                offset,
            )
        stage = STAGE_OF_TOPIC.get(topic)
        fault = self._fault(fields) if stage else None
        self._channels[channel_id] = Channel(topic, stage, fault)

    def _fault(self, fields: dict[str, Any]) -> str | None:
        if fields["message_encoding"] != "cdr":
            return f"its messages are encoded as {fields['message_encoding']!r}, not 'cdr'"
        schema = self._schemas.get(fields["schema_id"], EVENT_SCHEMA_NAME)  # a lost schema is no other schema
        if schema != EVENT_SCHEMA_NAME:
            return f"its schema is {schema!r}, not {EVENT_SCHEMA_NAME!r}"
        return None
