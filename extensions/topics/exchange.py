"""The four stamps of a beacon's round trips: T1 and T2 of this device, T3 and T4 from the other one's notes."""

from __future__ import annotations

import json
import threading
from collections import deque
from dataclasses import dataclass, field

from dds_trace.base.limits import RELAY_ID, STORED_TIME_NS, Whole
from dds_trace.base.printable import printable
from dds_trace.base.units import DRIFT_LIMIT_PPB, SECOND_NS, counted
from dds_trace.recorder.backends.node import Publisher, RawMessage
from dds_trace.recorder.backends.other_side import Strangers
from dds_trace.tracefile.format.descriptions import Run
from dds_trace.tracefile.format.encoding import decode_string, encode_string
from dds_trace.tracefile.writing.sink import TraceSink

WINDOW_NS = 5 * SECOND_NS
"""Of the round trips of this time only the quickest counts: the others waited somewhere."""
KEPT_WINDOWS = 120
DRIFT_WINDOWS = 6
WANDER_PPM = 2.0
"""How much an estimated drift may be wrong at least."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """The other clock minus this one now, ns: wrong by at most `bound_ns`; `drift_ppm` is None while it is unknown."""

    offset_ns: float
    bound_ns: float
    drift_ppm: float | None


@dataclass(frozen=True, slots=True)
class _Interval:
    at_ns: int
    low_ns: int
    high_ns: int

    @property
    def width_ns(self) -> int:
        return self.high_ns - self.low_ns

    @property
    def middle_ns(self) -> float:
        return (self.low_ns + self.high_ns) / 2

    def is_contradicted(self, later: _Interval) -> bool:
        most_ns = abs(later.at_ns - self.at_ns) * DRIFT_LIMIT_PPB / 1e9
        return later.low_ns - self.high_ns > most_ns or self.low_ns - later.high_ns > most_ns


class ClockEstimate:
    def __init__(self) -> None:
        self._windows: deque[_Interval] = deque(maxlen=KEPT_WINDOWS)
        self._latest: tuple[_Interval, ...] = ()

    def add(self, publish_ns: int, relay_in_ns: int, relay_out_ns: int, receive_ns: int) -> None:
        """Add T1 and T2 of this clock, T3 and T4 of the other one; stamps of no possible round trip are ignored."""
        new = _Interval((publish_ns + receive_ns) // 2, relay_out_ns - receive_ns, relay_in_ns - publish_ns)
        if new.width_ns < 0:
            return
        latest = self._windows[-1] if self._windows else None
        if latest is not None and latest.is_contradicted(new):
            self._windows.clear()
            latest = None
        self._latest = (new,)
        if latest is None or new.at_ns // WINDOW_NS != latest.at_ns // WINDOW_NS:
            self._windows.append(new)
        elif new.width_ns < latest.width_ns:
            self._windows[-1] = new

    def at(self, now_ns: int) -> Estimate | None:
        if not self._windows:
            return None
        drift = self._drift()
        unsure_ppm = DRIFT_LIMIT_PPB / 1e3 if drift is None else self._unsure_ppm()
        low_ns, high_ns = -float("inf"), float("inf")
        for window in (*self._latest, *reversed(self._windows)):
            elapsed_ns = now_ns - window.at_ns
            moved_ns, unsure_ns = elapsed_ns * (drift or 0.0), abs(elapsed_ns) * unsure_ppm / 1e6
            low = max(low_ns, window.low_ns + moved_ns - unsure_ns)
            high = min(high_ns, window.high_ns + moved_ns + unsure_ns)
            if low > high:  # the clock drifted otherwise before
                break
            low_ns, high_ns = low, high
        return Estimate((low_ns + high_ns) / 2, (high_ns - low_ns) / 2, None if drift is None else drift * 1e6)

    def _unsure_ppm(self) -> float:
        """Return how much the drift may be wrong: the windows' usual width over their time."""
        widths = sorted(window.width_ns for window in self._windows)
        span_ns = max(self._windows[-1].at_ns - self._windows[0].at_ns, 1)
        return min(max(WANDER_PPM, 1e6 * widths[len(widths) // 2] / span_ns), DRIFT_LIMIT_PPB / 1e3)

    def _drift(self) -> float | None:
        windows = self._windows
        if len(windows) < DRIFT_WINDOWS:
            return None
        origin = windows[0]
        rows = [
            (1 / max(window.width_ns, 1) ** 2, window.at_ns - origin.at_ns, window.middle_ns - origin.middle_ns)
            for window in windows
        ]
        total = sum(weight for weight, _, _ in rows)
        mean_at, mean_offset = (sum(row[0] * row[column] for row in rows) / total for column in (1, 2))
        spread = sum(weight * (at - mean_at) ** 2 for weight, at, _ in rows)
        common = sum(weight * (at - mean_at) * (offset - mean_offset) for weight, at, offset in rows)
        return common / spread if spread else None


NOTES_TOPIC, NOTES_TYPE = "beacon_clocks", "std_msgs/msg/String"
MOST_WAITING = 256
"""Replies and notes that wait for each other; the oldest go."""
MOST_DEVICES = 64
MOST_LINES = 16
UNSENT_NOTE = "note about a message that was not sent"
MOST_NOTE_BYTES = 4096
_TEXT_CHARACTERS = 120
T2 = 2
_SEQUENCE = Whole(0, (1 << 48) - 1, "a number")


@dataclass(slots=True)
class OtherClock:
    device: str
    wall_offset_ns: int
    time_service: str
    estimate: ClockEstimate = field(default_factory=ClockEstimate)
    is_contradicted: bool = False

    def words(self, now_ns: int, wall_offset_ns: int) -> str:
        if self.is_contradicted:
            return f"{self.device}: somebody else answers in its name, so the difference of the clocks is unknown"
        now = self.estimate.at(now_ns)
        if now is None:
            return f"{self.device}: no round trip yet"
        difference_ns = now.offset_ns + self.wall_offset_ns - wall_offset_ns
        drift = "" if now.drift_ppm is None else f", drift {now.drift_ppm:.1f} ppm"
        side = "later" if difference_ns > 0 else "earlier"
        return (
            f"{self.device}: your clocks differ by {abs(difference_ns) / 1e6:.3f} ms +- {now.bound_ns / 1e6:.3f}{drift} "
            f"(that one shows the {side} time; {self.time_service})"
        )


class Exchanges:
    """This beacon's messages, and what other beacons note about them.

    Notes come from peers: one counts only for a message that was sent and answered, and two that differ about one message
    contradict each other.
    """

    def __init__(self, strangers: Strangers) -> None:
        self.others: dict[int, OtherClock] = {}
        self._strangers = strangers
        self.run_ids: set[int] = set()
        self._sent: dict[tuple[int, int], int] = {}
        self._received: dict[tuple[int, int, int], int] = {}
        self._noted: dict[tuple[int, int, int], tuple[ClockNote, bool]] = {}
        self._lock = threading.Lock()

    def note_sent(self, run_id: int, sequence: int, publish_ns: int) -> None:
        with self._lock:
            _put(self._sent, (run_id, sequence), publish_ns)

    def note_reply(self, run_id: int, sequence: int, relay_id: int, receive_ns: int) -> None:
        with self._lock:
            _put(self._received, (run_id, sequence, relay_id), receive_ns)
            self._match(run_id, sequence, relay_id)

    def take_note(self, message: RawMessage, _source_ns: int = 0, _received_ns: int = 0, /) -> None:
        note = parse_note(message)
        if note is None or note.run_id not in self.run_ids:
            return
        with self._lock:
            if (note.run_id, note.sequence) not in self._sent:
                self._strangers.count(UNSENT_NOTE)
                return
            key = note.run_id, note.sequence, note.relay_id
            first, is_contradicted = self._noted.get(key, (note, False))
            is_contradicted |= first != note
            _put(self._noted, key, (first, is_contradicted))
            if is_contradicted and note.relay_id in self.others:
                self.others[note.relay_id].is_contradicted = True
            self._match(*key)

    def _match(self, run_id: int, sequence: int, relay_id: int) -> None:
        key = (run_id, sequence, relay_id)
        publish_ns = self._sent.get((run_id, sequence))
        if key not in self._received or key not in self._noted or publish_ns is None:
            return
        receive_ns, (note, is_contradicted) = self._received.pop(key), self._noted[key]
        other = self.others.get(relay_id)
        if other is None:
            if len(self.others) >= MOST_DEVICES:
                return
            other = self.others[relay_id] = OtherClock(note.device, 0, "")
        other.wall_offset_ns, other.time_service = note.wall_offset_ns, note.time_service
        other.is_contradicted |= is_contradicted
        other.estimate.add(publish_ns, note.relay_in_ns, note.relay_out_ns, receive_ns)

    def words(self, now_ns: int, wall_offset_ns: int) -> list[str]:
        with self._lock:
            lines = sorted(other.words(now_ns, wall_offset_ns) for other in self.others.values())
        further = [f"and {counted(len(lines) - MOST_LINES, 'further device')}"] if len(lines) > MOST_LINES else []
        return [*lines[:MOST_LINES], *further]


def _put(waiting: dict, key: tuple[int, ...], value: object) -> None:  # type: ignore[type-arg]
    if len(waiting) >= MOST_WAITING and key not in waiting:
        del waiting[next(iter(waiting))]
    waiting[key] = value


@dataclass(frozen=True, slots=True)
class ClockNote:
    """What a beacon publishes about a message that it answered; `relay_in_ns` and `relay_out_ns` are T3 and T4, monotonic."""

    device: str
    run_id: int
    sequence: int
    relay_id: int
    relay_in_ns: int
    relay_out_ns: int
    wall_offset_ns: int
    time_service: str

    def publish(self, publisher: Publisher[RawMessage]) -> None:
        text = {name: getattr(self, name) for name in self.__dataclass_fields__}
        publisher.publish(encode_string(json.dumps({**text, "run_id": f"{self.run_id:016x}"})))


def parse_note(message: RawMessage) -> ClockNote | None:
    if len(message) > MOST_NOTE_BYTES:
        return None
    try:
        value = json.loads(decode_string(bytes(message)))
        numbers = {name: value[name] for name in ("relay_in_ns", "relay_out_ns", "wall_offset_ns")}
        run_id, sequence, relay_id = int(value["run_id"], 16), value["sequence"], value["relay_id"]
        texts = {name: printable(value[name], _TEXT_CHARACTERS) for name in ("device", "time_service")}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
    are_good = not any(STORED_TIME_NS.fault(number) for number in numbers.values())
    if not are_good or _SEQUENCE.fault(sequence) or RELAY_ID.fault(relay_id):
        return None
    return ClockNote(run_id=run_id, sequence=sequence, relay_id=relay_id, **texts, **numbers)  # type: ignore[arg-type]


class NotingSink:
    """A `TraceSink` as a ping uses it; the exchanges get its T1 and T2 as well."""

    def __init__(self, sink: TraceSink, exchanges: Exchanges) -> None:
        self._sink = sink
        self._exchanges = exchanges

    def write_run(self, run: Run) -> None:
        self._sink.write_run(run)

    def stamp(self, stage: int, run_id: int, sequence: int, *fields: int) -> int:
        publish_ns = self._sink.stamp(stage, run_id, sequence, *fields)
        self._exchanges.note_sent(run_id, sequence, publish_ns)
        return publish_ns

    def record(self, stage: int, run_id: int, sequence: int, monotonic_ns: int, *fields: int) -> None:
        self._sink.record(stage, run_id, sequence, monotonic_ns, *fields)
        if stage == T2:
            self._exchanges.note_reply(run_id, sequence, fields[-1], monotonic_ns)
