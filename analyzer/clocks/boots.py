"""Boots of a device, and its wall clock beside its monotonic clock, by the anchors that its sessions recorded."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

    from dds_trace.tracefile import Run, Session

_SAME_BOOT_S = 2
"""Seconds by which the wall clock at monotonic zero of two sessions of one boot differs at most: NTP slews it."""


def ping_boots(sessions: Iterable[Session], runs: Iterable[Run]) -> dict[int, int]:
    """Return the boot of the ping's device in which each run took place, as a number.

    A device's monotonic clock starts again at every boot, so stamps of two boots must not be mixed. Sessions of one
    device whose monotonic zero lies at the same wall clock time, within two seconds, are of one boot.

    Returns:
        run_id -> wall clock at monotonic zero in whole seconds, which numbers the boot; 0 for a run that does not name
        its session.
    """
    boot_of_session: dict[int, int] = {}
    boots_of_device: dict[str, list[int]] = {}
    for session in sessions:
        zero_s = _monotonic_zero_ns(session) // 1_000_000_000
        boots = boots_of_device.setdefault(session.device, [])
        boot = next((known for known in boots if abs(known - zero_s) < _SAME_BOOT_S), None)
        if boot is None:
            boots.append(zero_s)
        boot_of_session[session.session_id] = zero_s if boot is None else boot
    return {run.run_id: boot_of_session.get(session_of_run(run), 0) for run in runs}


def ping_wall_offsets(sessions: Iterable[Session], runs: Iterable[Run]) -> dict[int, int]:
    """Return the wall clock minus the monotonic clock of the ping in each run that names its session.

    Returns:
        run_id -> offset in ns.
    """
    offsets = {session.session_id: _monotonic_zero_ns(session) for session in sessions}
    return {run.run_id: offsets[s] for run in runs if (s := session_of_run(run)) in offsets}


def session_of_run(run: Run) -> int:
    """Return the id of the ping session that a run names (`session_id` in its description), or -1."""
    try:
        return int(str(run.extra["session_id"]), 16)
    except (KeyError, ValueError):
        return -1


def _monotonic_zero_ns(session: Session) -> int:
    """Return the wall clock at monotonic zero, ns since 1970."""
    return session.wall_anchor_ns - session.monotonic_anchor_ns
