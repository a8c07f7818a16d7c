"""Header stamps of one device on the wall clock of another that recorded them, for a bag: `--clock runs/`."""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dds_trace.base.errors import OptionError

from ..clocks.track import UNKNOWN_NS
from .device_clocks import DeviceClocks, Instants, Machine

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from dds_trace.tracefile.format.descriptions import Run, Session

    from ..clocks.fit import Int64
    from ..pairing.rows import RowStore

_KEYS = ("stamped", "recorded", "topics")

MOST_EARLY = 0.01
"""Share of the messages of a topic that may be received before they were stamped, if its stamps are of the device."""


MUCH_OLDER_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class ClockRequest:
    """What `--clock` asks for: a folder of traces, perhaps the devices that stamped and recorded, and a pattern of topics."""

    folder: Path
    stamped: str = ""
    recorded: str = ""
    topics: str = "*"

    @classmethod
    def parse(cls, text: str) -> ClockRequest:
        """Read `FOLDER [stamped=DEVICE recorded=DEVICE] [topics=PATTERN]`.

        Raises:
            OptionError: this is not such a text.
        """
        words = text.split()
        given = dict(word.partition("=")[::2] for word in words if word.partition("=")[0] in _KEYS)
        folder = " ".join(word for word in words if word.partition("=")[0] not in _KEYS)
        if not folder or not all(given.values()) or ("stamped" in given) != ("recorded" in given):
            raise OptionError(
                f"--clock {text!r}: write a folder with traces of ping and relay between the two devices, and where it is not "
                "clear which is which: 'runs/ stamped=robot recorded=laptop'"
            )
        return cls(Path(folder), **given)


class StampClock:
    """The clocks by which stamps of a bag are placed on the clock of its recorder."""

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
        """Return for each topic its stamps on the recorder's clock, and notes; left out are topics of other stamps.

        Args:
            topics: name -> log times and stamps, both ns since 1970.

        Raises:
            OptionError: the stamps fit both ways, or none, and the request does not say which.
        """
        chosen = {
            name: times for name, times in topics.items() if fnmatchcase(name, self._request.topics) and len(times[0])
        }
        by_way = {way: self._fitting(way, chosen) for way in self._ways}
        fitting = [way for way, placed_topics in by_way.items() if placed_topics]
        if len(fitting) != 1 and chosen and len(self._ways) > 1:
            one, other = self._ways[0]
            raise OptionError(
                f"--clock: the stamps fit {'both devices' if fitting else 'no device'}; say which stamped and which recorded: "
                f"'{self._request.folder} stamped={one} recorded={other}'"
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
            if is_bounded and early.mean() <= MOST_EARLY and not self._is_local(log_ns, stamp_ns, placed.at_ns):
                # Within the bound: nothing arrives before it is sent.
                at_ns = np.where(early, placed.at_ns, np.minimum(placed.at_ns, log_ns))
                placed_topics[name] = Instants(at_ns, placed.bound_ns)
        return placed_topics

    def _is_local(self, log_ns: Int64, stamp_ns: Int64, placed_ns: Int64) -> bool:
        """Return whether stamps are of the recorder's own clock: without a correction the ages are possible, and much smaller."""
        is_possible = (log_ns < stamp_ns).mean() <= MOST_EARLY
        return self._request.topics == "*" and is_possible and np.median(stamp_ns - placed_ns) > MUCH_OLDER_NS

    def _place(self, stamp_ns: Int64, stamped: Machine | None, recorded: Machine | None) -> Instants:
        assert stamped is not None
        assert recorded is not None
        first = self._clocks.of_wall(stamp_ns, stamped)
        there = self._clocks.convert(first.at_ns, stamped, recorded)
        last = self._clocks.to_wall(there.at_ns, recorded)
        half = UNKNOWN_NS // 2
        bound_ns = np.minimum(there.bound_ns, half) + first.bound_ns + last.bound_ns
        return Instants(last.at_ns, np.minimum(bound_ns, UNKNOWN_NS))
