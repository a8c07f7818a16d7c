"""Sessions, runs and host samples, gathered from the `std_msgs/msg/String` messages of a trace."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ..errors import TraceFormatError
from ..format.descriptions import Run, Session
from ..format.events import HOST_TOPIC, RUN_TOPIC, SESSION_TOPIC

if TYPE_CHECKING:
    from collections.abc import Mapping

    from .source import Text

_HEADER_BYTES = 8  # CDR header and the string's length
_MAX_BYTES = 4 << 20  # a session with every configuration file of its host is a few kilobytes


class TextCollector:
    """The latest description of each session and run, in order of first appearance, and all host samples."""

    def __init__(self) -> None:
        self._sessions: dict[int, Session] = {}
        self._runs: dict[int, Run] = {}
        self._host: list[Mapping[str, Any]] = []
        self._takers = {SESSION_TOPIC: self._session, RUN_TOPIC: self._run, HOST_TOPIC: self._host_sample}
        self.unreadable_samples = 0

    @property
    def sessions(self) -> tuple[Session, ...]:
        """What the recording processes say of themselves."""
        return tuple(self._sessions.values())

    @property
    def runs(self) -> tuple[Run, ...]:
        """What pings say of their runs."""
        return tuple(self._runs.values())

    @property
    def host_samples(self) -> tuple[Mapping[str, Any], ...]:
        """The JSON objects of `/dds_trace/host`, each with its `log_time_ns`."""
        return tuple(self._host)

    def add(self, text: Text) -> None:
        """Take one message; topics that this version does not know are ignored.

        Raises:
            TraceFormatError: a description cannot be read; the error names file, place and field.
        """
        take = self._takers.get(text.topic)
        if take is None:
            return
        try:
            take(text)
        except TraceFormatError as err:
            raise TraceFormatError(err.path, err.what, text.offset) from err
        except RecursionError as err:
            what = f"the JSON of a message of {text.topic} is nested deeper than can be meant"
            raise TraceFormatError(text.path, what, text.offset) from err

    def add_ring_session(self, described: Session, dropped_events: int) -> None:
        """Take the session that a ring names, unless the trace itself has it, and the drops that the ring counts."""
        session = self._sessions.get(described.session_id, described)
        dropped_events = max(session.dropped_events, dropped_events)
        self._sessions[session.session_id] = replace(session, dropped_events=dropped_events)

    def _session(self, text: Text) -> None:
        session = Session.from_json(_string(text), text.path)
        self._sessions[session.session_id] = session

    def _run(self, text: Text) -> None:
        run = Run.from_json(_string(text), text.path)
        self._runs[run.run_id] = run

    def _host_sample(self, text: Text) -> None:
        try:
            sample = json.loads(_string(text))
        except (TraceFormatError, ValueError, RecursionError):
            sample = None
        if isinstance(sample, dict):
            self._host.append({**sample, "log_time_ns": text.log_time_ns})
        else:
            self.unreadable_samples += 1


def _string(text: Text) -> str:
    """The text in a serialized `std_msgs/msg/String`, of either byte order.

    Raises:
        TraceFormatError: it is none.
    """
    data = text.data
    if len(data) > _MAX_BYTES:
        raise TraceFormatError(
            text.path, f"a message of {text.topic} has {len(data)} bytes, more than can be meant"
        )
    order = {b"\x00\x00": "big", b"\x00\x01": "little"}.get(data[:2])
    size = int.from_bytes(data[4:_HEADER_BYTES], "big" if order == "big" else "little")
    if order is None or not 1 <= size <= len(data) - _HEADER_BYTES:
        raise TraceFormatError(text.path, f"a message of {text.topic} is no serialized std_msgs/msg/String")
    try:
        return data[_HEADER_BYTES : _HEADER_BYTES + size - 1].decode()
    except UnicodeDecodeError as err:
        raise TraceFormatError(text.path, f"a message of {text.topic} is no UTF-8 text ({err})") from err
