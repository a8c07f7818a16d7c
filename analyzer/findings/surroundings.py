"""Checks of what surrounds a recording on purpose: a load of its machine, a link that replays a file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from dds_trace.base.printable import printable
from dds_trace.base.units import format_duration, three_digits
from dds_trace.tracefile.format.descriptions import Session

from ..model.finding import Severity, Subject
from ..model.foreign import number_of, object_of
from .evidence import Evidence, Observation, check

_LEAST_BUSY = {"cpu": 0.5, "memory": 0.3, "network": 0.01, "awake": 0.01}
"""Processors that a load uses at least where it is the one that was requested."""


@check(
    "loaded",
    Severity.INFO,
    Subject.RECORDING,
    "Read it next to the same result without a load; no answer mixes the two.",
)
def loads(evidence: Evidence) -> Iterator[Observation]:
    """A machine was loaded on purpose."""
    for session, load in _loads(evidence):
        if load.works:
            program = "our own program" if load.program == "own" else printable(load.program)
            yield evidence.recording(
                session, f"Under load ({load.kind}) by {program}, which used {three_digits(load.busy)} processors."
            )


@check(
    "load_missing",
    Severity.WARNING,
    Subject.RECORDING,
    "Do not read this result as one under load: look at what else uses the machine, and record again.",
)
def missing_loads(evidence: Evidence) -> Iterator[Observation]:
    """A load that was requested did nothing."""
    for session, load in _loads(evidence):
        if not load.works:
            yield evidence.recording(
                session, f"Load ({load.kind}) was requested, and its program used {three_digits(load.busy)} processors."
            )


@dataclass(frozen=True, slots=True)
class _Load:
    kind: str
    program: str
    busy: float

    @property
    def works(self) -> bool:
        return self.busy >= _LEAST_BUSY.get(self.kind, 0.0)


def _loads(evidence: Evidence) -> Iterator[tuple[Session, _Load]]:
    """Yield the session that made a load; a second one of the same machine waits for its end."""
    for session in evidence.campaign.sessions.values():
        load = object_of(session.extra.get("load"))
        cpu_s, elapsed_s = number_of(load.get("cpu_s")), number_of(load.get("elapsed_s"))
        waited_s = number_of(load.get("waited_s")) or 0.0
        if cpu_s is not None and elapsed_s and load.get("program") and waited_s < elapsed_s / 2:
            yield session, _Load(printable(str(load.get("kind"))), str(load["program"]), cpu_s / elapsed_s)


_LATE_SHARE = 0.01
"""Lateness of half of the frames, as a share of the least delay, up to which delays are as the file says."""


@check(
    "link_replayed",
    Severity.INFO,
    Subject.RECORDING,
    "Results over the same file can be compared; the figure of processor load shows the link below the latency.",
)
def replayed_links(evidence: Evidence) -> Iterator[Observation]:
    """An emulated link replayed a file."""
    for session, replay in _replays(evidence):
        yield evidence.recording(session, f"The link replayed {replay.name} in each run: {replay.words}.")


@check(
    "link_late",
    Severity.WARNING,
    Subject.RECORDING,
    "Its delays are longer than the file says: a free CPU or a lower rate may help, as the forwarder is a Python process.",
)
def late_links(evidence: Evidence) -> Iterator[Observation]:
    """An emulated link handed frames on later than its file says."""
    for session, replay in _replays(evidence):
        if replay.late_ns and replay.late_ns > _LATE_SHARE * replay.least_delay_ns:
            yield evidence.recording(
                session,
                f"In a run half of the frames were handed on {format_duration(replay.late_ns)} late or later, where the least "
                f"delay of {replay.name} is {format_duration(replay.least_delay_ns)}.",
            )


@dataclass(slots=True)
class _Replay:
    """What one session's link did; `late_ns` is the median lateness of its worst run."""

    name: str = ""
    late_ns: float = 0.0
    rows: list[tuple[float, float, float]] = field(default_factory=list)

    @property
    def least_delay_ns(self) -> float:
        return min(delay_ms for _, delay_ms, _ in self.rows) * 1e6

    @property
    def words(self) -> str:
        rates, delays, losses = zip(*self.rows, strict=True)
        spans = (("rate", rates, "Mbit/s"), ("delay", delays, "ms"), ("loss", losses, "%"))
        return ", ".join(
            f"{name} {min(values):g} to {max(values):g} {unit}" for name, values, unit in spans if max(values)
        )


def _replays(evidence: Evidence) -> Iterator[tuple[Session, _Replay]]:
    replays: dict[int, _Replay] = {}
    for trace in evidence.campaign.traces:
        for sample in trace.host_samples if trace.sessions else ():
            replay = replays.setdefault(trace.sessions[-1].session_id, _Replay())
            now, link = object_of(sample.get("link_now")), object_of(sample.get("link"))
            values = [number_of(now.get(name)) for name in ("rate_mbit_s", "delay_ms", "loss_percent")]
            rate, delay, loss = (-1.0 if value is None else value for value in values)
            if min(rate, delay, loss) >= 0:
                replay.rows.append((rate, delay, loss))
            if "file" in link:
                replay.name = printable(str(link["file"]))
                ways = object_of(sample.get("forwarder")).values()
                late_us = [number_of(object_of(way).get("lateness_p50_us")) or 0.0 for way in ways]
                replay.late_ns = max([replay.late_ns, *(late * 1e3 for late in late_us)])
    for session_id, replay in replays.items():
        if replay.rows and replay.name:
            yield evidence.campaign.sessions[session_id], replay
