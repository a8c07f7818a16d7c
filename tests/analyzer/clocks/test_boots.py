from __future__ import annotations

from dds_trace.analyzer.clocks.boots import (
    boot_id_of,
    machine_of,
    ping_boots,
    ping_wall_offsets,
    session_of_run,
    share_boot,
)
from dds_trace.tracefile.format.descriptions import Run, Session

S = 1_000_000_000


def session(number, device, wall_ns, monotonic_ns, boot_id=None):
    return Session(
        number,
        "ping",
        device,
        "ros2",
        "fastdds",
        None,
        5,
        None,
        "wired",
        wall_ns,
        monotonic_ns,
        extra={} if boot_id is None else {"boot_id": boot_id},
    )


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
        session(5, "a", 1502 * S, 600 * S),  # two seconds on: another boot
    ]
    runs = [run(10, 1), run(20, 2), run(30, 3), run(40, 4), run(50, 77), run(60, 5)]
    boots = ping_boots(sessions, runs)
    assert boots == {10: 900, 20: 900, 30: 4950, 40: 900, 50: 0, 60: 902}
    assert ping_boots([], [UNNAMED]) == {6: 0}


def test_wall_offsets_are_known_of_runs_that_name_a_session():
    assert ping_wall_offsets([session(1, "a", 1000, 100)], [run(5, 1), UNNAMED, run(7, 9)]) == {5: 900}


def test_the_boot_id_decides_before_the_wall_clock():
    sessions = [
        session(1, "a", 1000 * S, 100 * S, "one"),
        session(2, "a", 9000 * S, 600 * S, "one"),  # the wall clock was set by more than two hours
        session(3, "a", 1001 * S, 100 * S, "two"),  # another machine of that name, started a second later
        session(4, "a", 1000 * S, 100 * S),  # an older recorder on the first
        session(5, "b", 900 * S, 0, "one"),
    ]
    boots = ping_boots(sessions, [run(10 * n, n) for n in range(1, 6)])
    assert boots == {10: 900, 20: 900, 30: 901, 40: 900, 50: 900}
    together = [session(1, "a", 1000, 100, "one"), session(2, "a", 1000, 100, "two")]
    assert ping_boots(together, [run(10, 1), run(20, 2)]) == {10: 0, 20: 1}


def test_two_sessions_share_a_boot_by_the_kernels_text():
    one, other = session(1, "a", 0, 0, "one"), session(2, "b", 0, 0, "one")
    assert share_boot(one, other) is True
    assert share_boot(one, session(2, "a", 0, 0, "two")) is False
    assert share_boot(one, session(2, "a", 0, 0)) is None
    assert share_boot(one, None) is None
    for no_text in ("", 5):
        nameless = session(2, "a", 0, 0, no_text)
        assert boot_id_of(nameless) is None
        assert share_boot(nameless, nameless) is None


def test_a_machine_is_named_by_its_boot_or_its_device():
    assert machine_of(session(1, "pi", 0, 0, "b1")) == "b1"
    assert machine_of(session(1, "pi", 0, 0)) == machine_of(session(1, "pi", 0, 0, "")) == "pi"


def test_a_run_names_its_session_or_none():
    assert (session_of_run(run(1, 0xAB)), session_of_run(UNNAMED)) == (0xAB, -1)
