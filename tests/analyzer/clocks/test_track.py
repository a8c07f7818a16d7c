from __future__ import annotations

import numpy as np
import pytest

from dds_trace.analyzer.clocks.fit import RelayedMessages
from dds_trace.analyzer.clocks.track import REACH_NS, UNKNOWN_NS, track_clock

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
