import numpy as np
import pytest

from dds_trace.analyzer.clocks.boots import (
    boot_id_of,
    machine_of,
    ping_boots,
    ping_wall_offsets,
    session_of_run,
    share_boot,
)
from dds_trace.analyzer.clocks.fit import RelayedMessages
from dds_trace.extensions.topics.clock_track import REACH_NS, UNKNOWN_NS, track_clock
from dds_trace.tracefile.format.descriptions import Run, Session

SECOND = 1_000_000_000
OFFSET_NS, PPM = 2 * SECOND, 200


def relay_clock(ping_ns, step_ns=0, step_at_ns=None):
    offset_ns = OFFSET_NS + ping_ns * PPM // 1_000_000
    return ping_ns + offset_ns + (step_ns * (ping_ns >= step_at_ns) if step_at_ns is not None else 0)


def messages(*, seconds=60, rate_hz=2, seed=1, step_ns=0, step_at_ns=None, gap_s=None):
    draw = np.random.default_rng(seed)
    sent = np.arange(seconds * rate_hz) * (SECOND // rate_hz)
    if gap_s is not None:
        sent = sent[(sent < gap_s[0] * SECOND) | (sent >= gap_s[1] * SECOND)]
    out, back = (150_000 + draw.exponential(100_000, len(sent)).astype(np.int64) for _ in range(2))
    there = sent + out
    left = there + 30_000
    return RelayedMessages(
        publish_ns=sent,
        relay_in_ns=relay_clock(there, step_ns, step_at_ns),
        relay_out_ns=relay_clock(left, step_ns, step_at_ns),
        receive_ns=left + back,
    )


def error_and_bound(track, at_ns, **clock):
    found = track.at(at_ns)
    return np.abs(found.offset_ns - (relay_clock(at_ns, **clock) - at_ns)), found.bound_ns


@pytest.mark.parametrize("seed", range(5))
def test_between_messages_the_offset_is_inside_its_bound(seed):
    track = track_clock(messages(seed=seed))
    at_ns = np.random.default_rng(seed).integers(0, 59 * SECOND, 5000)
    error, bound = error_and_bound(track, at_ns)
    assert (error <= bound).all()
    assert bound.max() < 300_000


def test_the_same_by_the_clock_of_the_relay():
    track = track_clock(messages())
    at_ns = np.random.default_rng(2).integers(0, 59 * SECOND, 1000)
    found = track.at_relay(relay_clock(at_ns))
    assert (np.abs(found.offset_ns - (relay_clock(at_ns) - at_ns)) <= found.bound_ns).all()


def test_the_bound_grows_with_the_distance_and_ends():
    track = track_clock(messages())
    at_ns = np.array([-5, 65, 120, 600]) * SECOND
    error, bound = error_and_bound(track, at_ns)
    assert (error <= bound).all()
    assert bound[1] < bound[2] < bound[3] < UNKNOWN_NS
    far = np.array([-REACH_NS - SECOND, 61 * SECOND + REACH_NS])
    assert (track.at(far).bound_ns == UNKNOWN_NS).all()


def test_in_a_gap_the_bound_is_wider():
    track = track_clock(messages(seconds=200, gap_s=(60, 140)))
    at_ns = np.array([30, 100, 170]) * SECOND
    error, bound = error_and_bound(track, at_ns)
    assert (error <= bound).all()
    assert bound[1] > bound[0]
    assert bound[1] > bound[2]


def test_at_a_step_the_offset_is_not_known():
    step = {"step_ns": 40_000_000, "step_at_ns": 30 * SECOND}
    track = track_clock(messages(**step))
    at_ns = np.random.default_rng(3).integers(0, 59 * SECOND, 2000)
    error, bound = error_and_bound(track, at_ns, **step)
    assert (error <= bound).all()
    unknown = at_ns[bound == UNKNOWN_NS]
    assert len(unknown)
    assert unknown.min() > 29 * SECOND
    assert unknown.max() < 31 * SECOND


def test_one_clock_needs_no_fit():
    one = messages()
    same = RelayedMessages(
        one.publish_ns, one.publish_ns + 1000, one.publish_ns + 2000, one.publish_ns + 3000, same_boot=True
    )
    found = track_clock(same).at(np.array([0, 10**15]))
    assert (found.offset_ns == 0).all()
    assert (found.bound_ns == 0).all()


def test_a_single_message_is_enough():
    few = messages(seconds=1, rate_hz=1)
    error, bound = error_and_bound(track_clock(few), np.array([0, SECOND]))
    assert (error <= bound).all()


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
