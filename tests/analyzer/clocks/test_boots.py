"""Boots and wall clocks from the anchors of drawn sessions."""

from __future__ import annotations

from dds_trace.analyzer.clocks.boots import ping_boots, ping_wall_offsets
from dds_trace.tracefile.format.descriptions import Run, Session

S = 1_000_000_000


def session(number, device, wall_ns, monotonic_ns):
    return Session(number, "ping", device, "ros2", "fastdds", None, 5, None, "wired", wall_ns, monotonic_ns)


def run(number, session_id):
    return Run(number, "binary", 1, 1.0, 1, 0, extra={"session_id": f"{session_id:016x}"})


UNNAMED = Run(6, "binary", 1, 1.0, 1, 0)
"""A run that does not name its session."""


def test_boots_are_told_apart_by_the_wall_clock_at_monotonic_zero():
    sessions = [
        session(1, "a", 1000 * S, 100 * S),
        session(2, "a", 1501 * S, 600 * S),  # same boot, wall clock one second on
        session(3, "a", 5000 * S, 50 * S),  # after a reboot
        session(4, "b", 1000 * S, 100 * S),
    ]
    boots = ping_boots(sessions, [run(10, 1), run(20, 2), run(30, 3), run(40, 4), run(50, 77)])
    assert boots == {10: 900, 20: 900, 30: 4950, 40: 900, 50: 0}
    assert ping_boots([], [UNNAMED]) == {6: 0}


def test_wall_offsets_are_known_of_runs_that_name_a_session():
    assert ping_wall_offsets([session(1, "a", 1000, 100)], [run(5, 1), UNNAMED, run(7, 9)]) == {5: 900}
