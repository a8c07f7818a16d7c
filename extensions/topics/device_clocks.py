"""The clocks of all devices of a folder: instants of one on another's clock, over others where needed, with bounds."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple

import numpy as np
import polars as pl

from dds_trace.analyzer.clocks.boots import boot_id_of, session_of_run
from dds_trace.analyzer.clocks.fit import RelayedMessages
from dds_trace.analyzer.clocks.lines import Int64
from dds_trace.analyzer.loading.campaign import Campaign
from dds_trace.analyzer.loading.event_index import EventPart
from dds_trace.analyzer.pairing.rows import RowStore
from dds_trace.base.errors import OptionError
from dds_trace.base.units import SECOND_NS
from dds_trace.extensions.bags.bounds import FEW, NOTICED_NS
from dds_trace.tracefile.format.descriptions import Run, Session
from dds_trace.tracefile.format.events import Stage

from .clock_track import UNKNOWN_NS, ClockTrack, track_clock


class Machine(NamedTuple):
    """A device in one boot; `boot_id` is empty where unknown."""

    boot_id: str
    device: str


def machine_of_session(session: Session) -> Machine:
    return Machine(boot_id_of(session) or "", session.device)


class Instants(NamedTuple):
    """Instants on one clock in ns, and the largest error of each; `UNKNOWN_NS` where unknown."""

    at_ns: Int64
    bound_ns: Int64


@dataclass(frozen=True, slots=True)
class _Link:
    track: ClockTrack
    is_ping: bool

    def across(self, at_ns: Int64) -> Instants:
        offsets = self.track.at(at_ns) if self.is_ping else self.track.at_relay(at_ns)
        return Instants(at_ns + offsets.offset_ns if self.is_ping else at_ns - offsets.offset_ns, offsets.bound_ns)


class DeviceClocks:
    def __init__(
        self,
        sessions: Collection[Session],
        runs: Collection[Run],
        rows: RowStore,
        readings: Collection[WallReadings] = (),
    ) -> None:
        zeros: dict[Machine, list[tuple[int, int, int]]] = defaultdict(list)
        for session in sessions:
            zero_ns = session.wall_anchor_ns - session.monotonic_anchor_ns
            zeros[machine_of_session(session)].append((session.wall_anchor_ns, zero_ns, ANCHOR_NS))
        moved = {machine_of_session(reading.session) for reading in readings if (reading.bound_ns > ANCHOR_NS).any()}
        for reading in readings:
            for at_ns in (reading.first_ns, reading.last_ns) if machine_of_session(reading.session) in moved else ():
                rows_of_zero = zip(
                    (at_ns + reading.zero_ns).tolist(), reading.zero_ns.tolist(), reading.bound_ns.tolist(), strict=True
                )
                zeros[machine_of_session(reading.session)] += rows_of_zero
        self._zeros = {machine: np.array(sorted(rows), np.int64) for machine, rows in zeros.items()}
        """By machine, in order of wall time: wall time, wall clock at monotonic zero, error."""
        self._links: dict[Machine, dict[Machine, list[_Link]]] = defaultdict(lambda: defaultdict(list))
        for (ping, relay), messages in _messages_by_pair(sessions, runs, rows).items():
            track = track_clock(messages)
            self._links[ping][relay].append(_Link(track, is_ping=True))
            self._links[relay][ping].append(_Link(track, is_ping=False))

    @property
    def machines(self) -> tuple[Machine, ...]:
        return tuple(sorted(self._zeros))

    def machine_named(self, device: str) -> Machine | None:
        matching = [machine for machine in self._zeros if machine.device == device]
        return max(matching, key=lambda machine: int(self._zeros[machine][-1, 0]), default=None)

    def convert(self, at_ns: Int64, start: Machine, end: Machine) -> Instants:
        path = self._path(start, end)
        if path is None:
            return Instants(at_ns, np.full(len(at_ns), UNKNOWN_NS, np.int64))
        bound_ns = np.zeros(len(at_ns), np.int64)
        for links in path:
            crossed = [link.across(at_ns) for link in links]
            best = np.argmin([crossing.bound_ns for crossing in crossed], axis=0)
            rows = np.arange(len(at_ns))
            at_ns = np.stack([crossing.at_ns for crossing in crossed])[best, rows]
            bound_ns = np.minimum(
                bound_ns + np.stack([crossing.bound_ns for crossing in crossed])[best, rows], UNKNOWN_NS
            )
        return Instants(at_ns, bound_ns)

    def of_wall(self, wall_ns: Int64, machine: Machine) -> Instants:
        """Return instants of the wall clock on the monotonic one, by the nearest readings of both.

        The bound includes by how much the wall clock was set around them: where it was set back, two instants show one time.
        """
        known_ns, zero_ns, error_ns = self._zeros[machine].T
        after = np.clip(np.searchsorted(known_ns, wall_ns), 0, len(known_ns) - 1)
        before = np.clip(after - 1, 0, None)
        nearest = np.where(np.abs(wall_ns - known_ns[before]) <= np.abs(known_ns[after] - wall_ns), before, after)
        beyond = np.stack([before, after, np.clip(before - 2, 0, None), np.clip(after + 2, None, len(known_ns) - 1)])
        around_ns = zero_ns[beyond if len(known_ns) > 2 else beyond[:2]]
        return Instants(wall_ns - zero_ns[nearest], error_ns[nearest] + np.ptp(around_ns, axis=0))

    def to_wall(self, at_ns: Int64, machine: Machine) -> Instants:
        """The inverse of `of_wall`."""
        zero_ns = int(self._zeros[machine][0, 1])
        back = self.of_wall(at_ns + zero_ns, machine)
        return Instants(at_ns + zero_ns + (at_ns - back.at_ns), back.bound_ns)

    def share_clock(self, first: Machine, other: Machine) -> bool:
        """Return whether two machines are one by boot, and no messages between them say otherwise."""
        if first == other:
            return True
        if not first.boot_id or first.boot_id != other.boot_id:
            return False
        links = self._links[first][other] if first in self._links else []
        if links:
            return all(link.track.same_clock for link in links)
        first_ns, second_ns = (int(self._zeros[machine][-1, 1]) for machine in (first, other))
        return abs(first_ns - second_ns) < 2 * SECOND_NS

    def _path(self, start: Machine, end: Machine) -> list[list[_Link]] | None:
        """Return the links of the shortest way between machines; a step within one clock has no link."""
        paths: dict[Machine, list[list[_Link]]] = {start: []}
        remaining = deque([start])
        while remaining:
            machine = remaining.popleft()
            if machine == end or self.share_clock(machine, end):
                return paths[machine]
            for other in self._zeros:
                if other in paths:
                    continue
                links = self._links[machine][other] if machine in self._links and other in self._links[machine] else []
                if links or self.share_clock(machine, other):
                    paths[other] = [*paths[machine], *([links] if links else [])]
                    remaining.append(other)
        return None


def _messages_by_pair(
    sessions: Collection[Session], runs: Collection[Run], rows: RowStore
) -> Mapping[tuple[Machine, Machine], RelayedMessages]:
    by_id = {session.session_id: machine_of_session(session) for session in sessions}
    pings = {run.run_id: by_id[session_id] for run in runs if (session_id := session_of_run(run)) in by_id}
    started = sorted(sessions, key=lambda session: session.wall_anchor_ns)
    relays = {session.relay_id: machine_of_session(session) for session in started if session.relay_id is not None}
    stamps = ["publish_ns", "relay_in_ns", "relay_out_ns", "receive_ns"]
    under_way = pl.col("receive_ns") - pl.col("publish_ns") - pl.col("relay_out_ns") + pl.col("relay_in_ns")
    thinned = (
        rows.scan()
        .select("run_id", "relay_id", *stamps, under_way.alias("under_way"))
        .filter(pl.all_horizontal(pl.col(stamps).is_not_null()), pl.col("under_way") >= 0)
        .sort("under_way")
        .group_by(
            "run_id", "relay_id", pl.col("publish_ns") // NOTICED_NS, maintain_order=True
        )  # only the fastest shapes a fit
        .agg(pl.col(name).first() if name != "publish_ns" else pl.col(name).first().alias("sent_ns") for name in stamps)
        .collect()
    )
    crossed: dict[tuple[Machine, Machine], list[pl.DataFrame]] = defaultdict(list)
    for (run_id, relay_id), part in thinned.partition_by("run_id", "relay_id", as_dict=True).items():
        if run_id in pings and relay_id in relays:
            crossed[pings[run_id], relays[relay_id]].append(part)
    return {pair: _joined(pair, pl.concat(parts)) for pair, parts in crossed.items()}


def _joined(pair: tuple[Machine, Machine], messages: pl.DataFrame) -> RelayedMessages:
    ping, relay = pair
    return RelayedMessages(
        publish_ns=messages["sent_ns"].to_numpy(),
        relay_in_ns=messages["relay_in_ns"].to_numpy(),
        relay_out_ns=messages["relay_out_ns"].to_numpy(),
        receive_ns=messages["receive_ns"].to_numpy(),
        ping_device=ping.device,
        relay_device=relay.device,
        relay_boot=relay.boot_id or None,
        same_boot=ping.boot_id == relay.boot_id if ping.boot_id and relay.boot_id else None,
    )


_KEYS = ("stamped", "recorded", "topics")


@dataclass(frozen=True, slots=True)
class ClockRequest:
    """The request of `--clock`: a folder of traces, perhaps devices that stamped and recorded, a pattern of topics."""

    folder: Path
    stamped: str = ""
    recorded: str = ""
    topics: str = "*"

    @classmethod
    def parse(cls, text: str) -> ClockRequest:
        """Read `FOLDER [stamped=DEVICE recorded=DEVICE] [topics=PATTERN]`; other texts are an `OptionError`."""
        words = text.split()
        arguments = dict(word.partition("=")[::2] for word in words if word.partition("=")[0] in _KEYS)
        folder = " ".join(word for word in words if word.partition("=")[0] not in _KEYS)
        if not folder or not all(arguments.values()) or ("stamped" in arguments) != ("recorded" in arguments):
            raise OptionError(
                f"--clock {text!r}: write a folder with traces of ping and relay between the two devices, and where it is not "
                "clear which is which: 'runs/ stamped=robot recorded=laptop'"
            )
        return cls(Path(folder), **arguments)


class StampClock:
    def __init__(self, request: ClockRequest, sessions: Sequence[Session], runs: Sequence[Run], rows: RowStore) -> None:
        self._request = request
        self._clocks = DeviceClocks(sessions, runs, rows)
        names = sorted({machine.device for machine in self._clocks.machines})
        self._listed = ", ".join(names)
        if request.stamped:
            unknown = [name for name in (request.stamped, request.recorded) if name not in names]
            if unknown:
                raise OptionError(
                    f"--clock: {request.folder} has no device {unknown[0]!r}; its devices: {self._listed}"
                )
            self._ways: list[tuple[str, str]] = [(request.stamped, request.recorded)]
        elif len(names) == 2:
            self._ways = [(names[0], names[1]), (names[1], names[0])]
        else:
            raise OptionError(
                f"--clock: {request.folder} has the devices {self._listed}; write '{request.folder} stamped=DEVICE recorded=DEVICE'"
            )

    def corrections(self, topics: Mapping[str, tuple[Int64, Int64]]) -> tuple[dict[str, Instants], list[str]]:
        """Return each topic's stamps on the recorder's clock, and notes; topics of other stamps are left out.

        `topics` has log times and stamps, both ns since 1970; those that fit both ways, or none, are an `OptionError`.
        """
        chosen = {
            name: times for name, times in topics.items() if fnmatchcase(name, self._request.topics) and len(times[0])
        }
        by_way = {way: self._fitting(way, chosen) for way in self._ways}
        fitting = [way for way, placed_topics in by_way.items() if placed_topics]
        if len(fitting) != 1 and chosen and len(self._ways) > 1:
            forward, other = self._ways[0]
            raise OptionError(
                f"--clock: the stamps fit {'both devices' if fitting else 'no device'}; say which stamped and which recorded: "
                f"'{self._request.folder} stamped={forward} recorded={other}'"
            )
        (stamped, recorded) = fitting[0] if fitting else self._ways[0]
        placed_topics = by_way[stamped, recorded]
        notes = (
            [f"ages by stamps of {stamped} on the clock of {recorded}, from the traces in {self._request.folder}"]
            if placed_topics
            else []
        )
        notes += [
            f"the stamps of {name} are not of {stamped}, or no trace is near: its ages are not corrected"
            for name in chosen
            if name not in placed_topics
        ]
        return placed_topics, notes

    def _fitting(self, way: tuple[str, str], topics: Mapping[str, tuple[Int64, Int64]]) -> dict[str, Instants]:
        machines = [self._clocks.machine_named(name) for name in way]
        placed_topics = {}
        for name, (log_ns, stamp_ns) in topics.items():
            placed = self._place(stamp_ns, *machines)
            early = log_ns - placed.at_ns < -placed.bound_ns
            is_bounded = bool((placed.bound_ns < UNKNOWN_NS // 2).all())
            if is_bounded and early.mean() <= FEW and not self._is_local(log_ns, stamp_ns, placed.at_ns):
                # Within the bound: nothing arrives before it is sent.
                at_ns = np.where(early, placed.at_ns, np.minimum(placed.at_ns, log_ns))
                placed_topics[name] = Instants(at_ns, placed.bound_ns)
        return placed_topics

    def _is_local(self, log_ns: Int64, stamp_ns: Int64, placed_ns: Int64) -> bool:
        """Return whether stamps are of the recorder's clock: uncorrected ages are possible, and much smaller."""
        is_possible = (log_ns < stamp_ns).mean() <= FEW
        return self._request.topics == "*" and is_possible and np.median(stamp_ns - placed_ns) > SECOND_NS

    def _place(self, stamp_ns: Int64, stamped: Machine | None, recorded: Machine | None) -> Instants:
        assert stamped is not None
        assert recorded is not None
        first = self._clocks.of_wall(stamp_ns, stamped)
        there = self._clocks.convert(first.at_ns, stamped, recorded)
        last = self._clocks.to_wall(there.at_ns, recorded)
        half = UNKNOWN_NS // 2
        bound_ns = np.minimum(there.bound_ns, half) + first.bound_ns + last.bound_ns
        return Instants(last.at_ns, np.minimum(bound_ns, UNKNOWN_NS))


ANCHOR_NS = 5_000
"""Error of reading wall and monotonic clock one after the other."""

_WAIT_NS, _NOISES = 200_000, 6
"""By so much the shortest waits of two seconds differ without load, and by so many times their usual difference under it."""

_LASTING_SECONDS = 5
"""Seconds of equally late events that a clock set back explains, and waiting for a processor does not."""


@dataclass(frozen=True, slots=True, eq=False)
class WallReadings:
    """Seconds of a recording: first and last event on the monotonic clock, wall clock at monotonic zero, and its largest error."""

    session: Session
    first_ns: Int64
    last_ns: Int64
    zero_ns: Int64
    bound_ns: Int64

    @property
    def steps_ns(self) -> Int64:
        """Changes of the wall clock from each second to the next, 0 where their errors explain them."""
        zero_ns = self.session.wall_anchor_ns - self.session.monotonic_anchor_ns
        step_ns = np.diff(self.zero_ns, prepend=zero_ns)
        return np.where(np.abs(step_ns) > self.bound_ns + np.append(ANCHOR_NS, self.bound_ns[:-1]), step_ns, 0)


def follow_wall_clocks(campaign: Campaign) -> Iterator[WallReadings]:
    """Yield the wall clock of each recording against its monotonic one, at every event with a reception stamp.

    A message is received before its event, so `received_ns - monotonic_ns` is below the wall clock at monotonic zero by what the event waited.
    The largest difference of a second shows where the wall clock was set; a shorter wait of a second is no such thing.
    """
    parts: dict[int, list[EventPart]] = defaultdict(list)
    for (stage, _, _), parts_of_key in campaign.events.items():
        for part in parts_of_key if stage in (Stage.TAP, Stage.T2, Stage.T3) else ():
            parts[part.trace].append(part)
    for trace, parts_of_trace in parts.items():
        sessions = campaign.traces[trace].sessions
        if len({(session.device, session.extra.get("boot_id")) for session in sessions}) == 1:
            events = [part.load() for part in parts_of_trace]
            at_ns, wall_ns = (
                np.concatenate([getattr(part, f"{n}_ns") for part in events]) for n in ("monotonic", "received")
            )
            seconds = (
                pl.DataFrame({"at": at_ns, "zero": wall_ns - at_ns})
                .filter(pl.Series(wall_ns > 0))
                .group_by(pl.col("at") // SECOND_NS)
                .agg(first=pl.col("at").min(), last=pl.col("at").max(), zero=pl.col("zero").max())
                .sort("first")
            )
            if len(seconds) > 1:
                yield _read(sessions[0], *(seconds[name].to_numpy() for name in ("first", "last", "zero")))


def _read(session: Session, first_ns: Int64, last_ns: Int64, latest_ns: Int64) -> WallReadings:
    anchor_ns = session.wall_anchor_ns - session.monotonic_anchor_ns
    wait_ns = anchor_ns - latest_ns
    usual_ns = int(min(wait_ns[wait_ns >= 0], default=0))
    noise_ns = np.median(np.abs(np.diff(latest_ns, 2))) / 2 if len(latest_ns) > 2 else 0.0
    slack_ns = int(_WAIT_NS + _NOISES * noise_ns)
    is_late = wait_ns > usual_ns + slack_ns
    is_set = wait_ns < -ANCHOR_NS
    for start in range(len(is_late) - _LASTING_SECONDS + 1):
        part = slice(start, start + _LASTING_SECONDS)
        is_set[part] |= is_late[part].all() and np.ptp(latest_ns[part]) < slack_ns
    is_late_to_the_end = np.logical_and.accumulate(is_late[::-1])[::-1]
    unsure_ns = np.where(is_set, slack_ns, np.where(is_late_to_the_end, wait_ns, ANCHOR_NS))
    return WallReadings(session, first_ns, last_ns, np.where(is_set, latest_ns + usual_ns, anchor_ns), unsure_ns)
