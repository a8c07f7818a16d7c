"""Sessions, runs, host samples and texts about the wire, gathered from the `std_msgs/msg/String` messages of a trace."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING

from dds_trace.base.errors import TraceFormatError

from ..format.descriptions import Run, Session
from ..format.events import HOST_TOPIC, RUN_TOPIC, SESSION_TOPIC
from ..format.json_fields import parse_json
from ..format.string_cdr import decode_string
from ..format.wire import WIRE_TOPIC

if TYPE_CHECKING:
    from ..format.json_fields import JsonObject
    from .source import Text

_MAX_BYTES = 4 << 20  # a session with every configuration file of its host is a few kilobytes


class TextCollector:
    """Latest description of each session and run, in order of first appearance, all host samples and texts about the wire.

    Attributes:
        unreadable: topic -> number of its messages that are no JSON objects; of host samples and the wire.
    """

    def __init__(self) -> None:
        self._sessions: dict[int, Session] = {}
        self._runs: dict[int, Run] = {}
        self._host: list[JsonObject] = []
        self._wire: list[JsonObject] = []
        self._takers = {
            SESSION_TOPIC: self._session,
            RUN_TOPIC: self._run,
            HOST_TOPIC: self._host_sample,
            WIRE_TOPIC: self._wire_text,
        }
        self.unreadable = Counter[str]()

    @property
    def sessions(self) -> tuple[Session, ...]:
        """Descriptions of the recording processes."""
        return tuple(self._sessions.values())

    @property
    def runs(self) -> tuple[Run, ...]:
        """Descriptions of the runs."""
        return tuple(self._runs.values())

    @property
    def host_samples(self) -> tuple[JsonObject, ...]:
        """JSON objects of `/dds_trace/host`, each with its `log_time_ns`."""
        return tuple(self._host)

    @property
    def wire(self) -> tuple[JsonObject, ...]:
        """JSON objects of `/dds_trace/wire`."""
        return tuple(self._wire)

    def add(self, text: Text) -> None:
        """Add one message; a topic that this version does not know is ignored.

        Raises:
            TraceFormatError: a description cannot be read; the error names file, offset and field.
        """
        take = self._takers.get(text.topic)
        if take is None:
            return
        try:
            take(text)
        except TraceFormatError as err:
            raise TraceFormatError(err.path, err.what, text.offset) from err
        except RecursionError as err:
            what = f"the JSON of a message of {text.topic} is nested deeper than in any description"
            raise TraceFormatError(text.path, what, text.offset) from err

    def add_ring_session(self, described: Session, dropped_events: int) -> None:
        """Add the session that a ring describes, unless the trace has it, and the number of drops in the ring's header."""
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
        sample = self._object(text)
        if sample is not None:
            self._host.append({**sample, "log_time_ns": text.log_time_ns})

    def _wire_text(self, text: Text) -> None:
        value = self._object(text)
        if value is not None:
            self._wire.append(value)

    def _object(self, text: Text) -> JsonObject | None:
        """Return the JSON object of a message; None of one that is none, which is counted."""
        try:
            value = parse_json(_string(text))
        except (TraceFormatError, ValueError):
            value = None
        if isinstance(value, dict):
            return value
        self.unreadable[text.topic] += 1
        return None


def _string(text: Text) -> str:
    """Return the text of a message.

    Raises:
        TraceFormatError: it is no `std_msgs/msg/String`, or longer than any description or sample.
    """
    data = text.data
    if len(data) > _MAX_BYTES:
        raise TraceFormatError(
            text.path, f"a message of {text.topic} has {len(data)} bytes, more than any description"
        )
    try:
        return decode_string(data)
    except ValueError as err:
        raise TraceFormatError(text.path, f"a message of {text.topic} is {err}") from err
