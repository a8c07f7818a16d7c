"""Boots of a device, and its wall clock against its monotonic clock."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from dds_trace.tracefile.format.descriptions import Run, Session

_SAME_BOOT_S = 2
"""Largest difference of the wall clock at monotonic zero between two sessions of one boot: NTP slews it."""


@dataclass(frozen=True, slots=True)
class _Boot:
    number: int
    boot_id: str | None

    def includes(self, zero_s: int, boot_id: str | None) -> bool:
        if boot_id is not None and self.boot_id is not None:
            return boot_id == self.boot_id
        return abs(self.number - zero_s) < _SAME_BOOT_S


def boot_id_of(session: Session) -> str | None:
    boot_id = session.extra.get("boot_id")
    return boot_id if isinstance(boot_id, str) and boot_id else None


def machine_of(session: Session) -> str:
    return boot_id_of(session) or session.device


def share_boot(first: Session, other: Session | None) -> bool | None:
    ids = boot_id_of(first), boot_id_of(other) if other is not None else None
    return None if None in ids else ids[0] == ids[1]


def session_boots(sessions: Iterable[Session]) -> dict[int, int]:
    """Return the boot of each session by session_id: wall clock of its device at monotonic zero in whole seconds."""
    boot_of_session: dict[int, int] = {}
    boots_of_device: dict[str, list[_Boot]] = {}
    for session in sessions:
        zero_s, boot_id = _monotonic_zero_ns(session) // 1_000_000_000, boot_id_of(session)
        boots = boots_of_device.setdefault(session.device, [])
        boot = next((other for other in boots if other.includes(zero_s, boot_id)), None)
        if boot is None:
            while any(other.number == zero_s for other in boots):  # two machines of one name, started together
                zero_s += 1
            boot = _Boot(zero_s, boot_id)
            boots.append(boot)
        boot_of_session[session.session_id] = boot.number
    return boot_of_session


def ping_boots(sessions: Iterable[Session], runs: Iterable[Run]) -> dict[int, int]:
    """Return the boot of each run's ping by run_id, 0 if unknown: stamps of two boots must not be mixed."""
    boots = session_boots(sessions)
    return {run.run_id: boots.get(session_of_run(run), 0) for run in runs}


def ping_wall_offsets(sessions: Iterable[Session], runs: Iterable[Run]) -> dict[int, int]:
    offsets = {session.session_id: _monotonic_zero_ns(session) for session in sessions}
    return {run.run_id: offsets[s] for run in runs if (s := session_of_run(run)) in offsets}


def session_of_run(run: Run) -> int:
    try:
        return int(str(run.extra["session_id"]), 16)
    except (KeyError, ValueError):
        return -1


def _monotonic_zero_ns(session: Session) -> int:
    return session.wall_anchor_ns - session.monotonic_anchor_ns
