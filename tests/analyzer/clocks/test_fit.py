from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pinned import assert_pinned
from plain_clock_fit import plain_fit
from roundtrip_frames import MS, S
from trace_files import relay_session, run

from dds_trace.analyzer.clocks import fit as fit_module
from dds_trace.analyzer.clocks import windows
from dds_trace.analyzer.clocks.boots import machine_of, session_of_run
from dds_trace.analyzer.clocks.fit import RelayedMessages, fit_clocks
from dds_trace.analyzer.clocks.lines import DRIFT, Lines, OffsetIntervals

START_NS = 40 * 24 * 3600 * S  # forty days after boot: an int64 that a float32 or a careless float64 would spoil


def fit_clock(*stamps, **names):
    (fitted,) = fit_clocks([RelayedMessages(*stamps, **names)])
    return fitted


@dataclass(frozen=True)
class Truth:
    """A relay whose clock is `offset_ns` ahead, gains `drift_ppb` and jumps by `step_ns` at `step_at_ns`."""

    offset_ns: int = 0
    drift_ppb: int = 0
    step_ns: int = 0
    step_at_ns: int = 0

    def theta_ns(self, true_ns):
        since = true_ns - START_NS
        drifted = np.rint(self.drift_ppb * since / 1e9).astype(np.int64)
        return self.offset_ns + drifted + np.where(since >= self.step_at_ns, self.step_ns, 0)


@dataclass(frozen=True)
class Drawn:
    t1: np.ndarray
    t3: np.ndarray
    t4: np.ndarray
    t2: np.ndarray
    outbound_ns: np.ndarray
    theta_ns: np.ndarray

    @property
    def stamps(self):
        return self.t1, self.t3, self.t4, self.t2


def draw(truth, *, messages=600, rate_hz=20, floor_ns=100_000, slow_return=3.0, seed=0):
    """Messages with exponential jitter that is `slow_return` times larger on the way back."""
    generator = np.random.default_rng(seed)
    t1 = START_NS + np.arange(messages, dtype=np.int64) * (S // rate_hz)
    outbound = floor_ns + generator.exponential(200_000, messages).astype(np.int64)
    relay = generator.exponential(100_000, messages).astype(np.int64)
    back = floor_ns + generator.exponential(200_000 * slow_return, messages).astype(np.int64)
    arrived, left = t1 + outbound, t1 + outbound + relay
    t2 = left + back
    t3, t4 = arrived + truth.theta_ns(arrived), left + truth.theta_ns(left)
    return Drawn(t1, t3, t4, t2, outbound, truth.theta_ns((t1 + t2) // 2))


def test_one_message_gives_the_middle_of_its_interval_and_half_its_width():
    # ping's clock:  T1=0 ........................ T2=300      under way 200 of 300
    # relay's clock:      T3=1100 ... T4=1200
    # theta is between T4-T2 = 900 and T3-T1 = 1100.
    fit, offsets = fit_clock(*(np.array([t], np.int64) for t in (0, 1100, 1200, 300)))
    assert offsets.offset_ns.tolist() == [1000]
    assert offsets.bound_ns.tolist() == [101]  # 100, and the rounding
    assert [s.messages for s in fit.segments] == [1]
    assert fit.segments[0].offset_ns == 1000
    assert fit.steps == ()


def test_a_slow_message_borrows_the_bound_of_its_fast_neighbour():
    # theta = 1000 throughout. Fast message at 0: 100 out, 100 back. Slow one 1 ms later: 9900 out, 100 back.
    t1 = np.array([0, 1_000_000], np.int64)
    outbound, back = np.array([100, 9900]), np.array([100, 100])
    t3, t4 = t1 + outbound + 1000, t1 + outbound + 1000
    fit, offsets = fit_clock(t1, t3, t4, t1 + outbound + back)
    # In 1 ms clocks part by at most 1100 ns, so theta is in [900 - 1100, 1100 + 1100] by the fast one; the slow
    # one's way back says theta >= 900, and the lines through both leave [900, 2200] and a little slack.
    assert abs(int(offsets.offset_ns[1]) - 1550) <= 6
    assert 650 <= offsets.bound_ns[1] <= 663
    assert len(fit.segments) == 1


@given(
    offset_ns=st.integers(-(10**15), 10**15),
    drift_ppb=st.integers(-200_000, 200_000),
    slow_return=st.floats(0.1, 10),
    rate_hz=st.sampled_from([1, 10, 100]),
    messages=st.integers(1, 400),
    seed=st.integers(0, 2**32),
)
@settings(max_examples=60)
def test_a_known_offset_and_drift_come_back_within_the_bound(
    *, offset_ns, drift_ppb, slow_return, rate_hz, messages, seed
):
    drawn = draw(Truth(offset_ns, drift_ppb), messages=messages, rate_hz=rate_hz, slow_return=slow_return, seed=seed)
    fit, offsets = fit_clock(*drawn.stamps)
    assert np.all(np.abs(offsets.offset_ns - drawn.theta_ns) <= offsets.bound_ns)
    half_under_way = ((drawn.t2 - drawn.t1) - (drawn.t4 - drawn.t3)) / 2
    assert np.all(offsets.bound_ns <= half_under_way * 1.01 + (drawn.t2 - drawn.t1) * 0.001 + 2)
    (segment,) = fit.segments
    assert segment.messages == messages
    assert abs(segment.drift_ppb - drift_ppb) <= segment.drift_bound_ppb + 1
    for knot in segment.knots:
        true = offset_ns + drift_ppb * (knot.at_ns - START_NS) / 1e9
        assert abs(knot.offset_ns - true) <= knot.bound_ns + 1


@given(
    step_ns=st.integers(3 * MS, 10**13),
    backwards=st.booleans(),
    drift_ppb=st.integers(-100_000, 100_000),
    step_at_ms=st.integers(2_000, 28_000),
    seed=st.integers(0, 2**32),
)
@settings(max_examples=60)
def test_a_step_is_found_and_splits_the_fit(*, step_ns, backwards, drift_ppb, step_at_ms, seed):
    jump = -step_ns if backwards else step_ns
    drawn = draw(Truth(10**9, drift_ppb, jump, step_at_ms * MS), seed=seed)
    keep = (drawn.t2 - drawn.t1) >= (drawn.t4 - drawn.t3)  # the message under way during the step may be absurd
    fit, offsets = fit_clock(*(stamp[keep] for stamp in drawn.stamps))
    touched = (drawn.t1 < START_NS + step_at_ms * MS) & (drawn.t2 >= START_NS + step_at_ms * MS)
    wrong = np.abs(offsets.offset_ns - drawn.theta_ns[keep]) > offsets.bound_ns
    assert not np.any(wrong & ~touched[keep])
    sizes = [s for s in fit.steps if abs(s.size_ns) > MS]
    total = sum(s.size_ns for s in sizes)
    assert abs(total - jump) <= sum(s.bound_ns for s in sizes)
    assert sizes[0].after_ns - START_NS <= step_at_ms * MS + 50 * MS
    assert sizes[-1].before_ns - START_NS >= step_at_ms * MS
    assert len(fit.segments) == len(fit.steps) + 1


def test_a_suspended_relay_is_a_step_back_by_the_time_it_slept():
    # The relay sleeps one hour between message 299 and 300; its monotonic clock stands still meanwhile.
    t1 = START_NS + np.arange(600, dtype=np.int64) * 50 * MS
    t1[300:] += 3600 * S
    asleep = np.where(np.arange(600) >= 300, 3600 * S, 0)
    t3, t4, t2 = t1 + 200_000 - asleep, t1 + 250_000 - asleep, t1 + 450_000
    fit, offsets = fit_clock(t1, t3, t4, t2)
    assert [s.messages for s in fit.segments] == [300, 300]
    (step,) = fit.steps
    assert abs(step.size_ns + 3600 * S) <= step.bound_ns
    assert (step.after_ns, step.before_ns) == (int(t1[299] + 225_000), int(t1[300] + 225_000))
    assert np.array_equal(offsets.offset_ns, -asleep)


def test_a_slewed_clock_bends_the_fit_without_a_step():
    # 400 ppm for five of twenty seconds: 2 ms in all, with messages whose own bound is 50 us.
    t1 = START_NS + np.arange(2000, dtype=np.int64) * 10 * MS
    slewed = np.clip((t1 - START_NS - 7 * S) * 400 // 1_000_000, 0, 2 * MS)
    t3, t4, t2 = t1 + 50_000 + slewed, t1 + 60_000 + slewed, t1 + 110_000
    fit, offsets = fit_clock(t1, t3, t4, t2)
    assert fit.steps == ()
    assert len(fit.segments[0].knots) > 2
    assert fit.segments[0].residual_ns > 100_000
    assert np.all(np.abs(offsets.offset_ns - slewed) <= offsets.bound_ns + 10)


def wrong_share_of_a_bent_clock():
    """Share of messages outside of their bound, where the relay's clock gains 100 ppm from the fifth second on."""
    wrong, generator = [], np.random.default_rng(0)
    for _ in range(10):
        t1 = START_NS + np.arange(400, dtype=np.int64) * 50 * MS
        outbound, back = (100_000 + generator.exponential(200_000, 400).astype(np.int64) for _ in range(2))

        def theta(true_ns):
            return np.clip(true_ns - START_NS - 5 * S, 0, None) // 10_000

        arrived = t1 + outbound
        t2 = arrived + back
        _, offsets = fit_clock(t1, arrived + theta(arrived), arrived + theta(arrived), t2)
        wrong.append(np.abs(offsets.offset_ns - theta((t1 + t2) // 2)) > offsets.bound_ns)
    return np.mean(wrong)


def test_a_window_whose_halves_disagree_is_widened(monkeypatch):
    assert wrong_share_of_a_bent_clock() < 0.05
    monkeypatch.setattr(windows, "_are_bent", lambda _points, start, *_: np.zeros(len(start), np.bool_))
    assert wrong_share_of_a_bent_clock() > 0.1


@pytest.mark.parametrize("slow_return", [1.0, 3.0, 10.0])
def test_a_straight_clock_is_fitted_as_without_its_halves(monkeypatch, slow_return):
    drawn = [draw(Truth(10**9, 20_000), slow_return=slow_return, seed=seed) for seed in range(10)]
    held = [fit_clock(*each.stamps) for each in drawn]
    monkeypatch.setattr(windows, "_are_bent", lambda _points, start, *_: np.zeros(len(start), np.bool_))
    for (fit, offsets), each in zip(held, drawn, strict=True):
        alone, unheld = fit_clock(*each.stamps)
        assert fit == alone
        assert np.array_equal(offsets.bound_ns, unheld.bound_ns)


def test_on_one_machine_the_fit_is_zero_within_its_bound():
    drawn = draw(Truth(), slow_return=6)
    fit, _ = fit_clock(*drawn.stamps, ping_device="a", relay_device="b")
    assert not fit.same_clock  # two names: the method must do without knowing
    for knot in fit.segments[0].knots:
        assert abs(knot.offset_ns) <= knot.bound_ns
    assert abs(fit.segments[0].drift_ppb) <= fit.segments[0].drift_bound_ppb
    known, offsets = fit_clock(*drawn.stamps, ping_device="pi", relay_device="pi")
    assert known.same_clock
    assert not offsets.offset_ns.any()
    assert not offsets.bound_ns.any()


def test_two_devices_of_one_name_are_not_taken_for_one_machine():
    fit, _ = fit_clock(*draw(Truth(offset_ns=5 * S)).stamps, ping_device="raspberrypi", relay_device="raspberrypi")
    assert not fit.same_clock


@pytest.mark.parametrize(("boot_id", "machine"), [("one", "one"), ("", "beta"), (7, "beta"), (None, "beta")])
def test_a_machine_is_known_by_its_boot_else_by_its_name(boot_id, machine):
    assert machine_of(relay_session(extra={"boot_id": boot_id})) == machine
    assert session_of_run(run(extra={})) == -1


def test_the_boot_id_tells_one_machine_whatever_the_names_are():
    drawn = draw(Truth())
    fit, offsets = fit_clock(*drawn.stamps, ping_device="robot", relay_device="base", same_boot=True)
    assert fit.same_clock
    assert not offsets.bound_ns.any()
    apart, _ = fit_clock(*drawn.stamps, ping_device="pi", relay_device="pi", same_boot=False)
    assert not apart.same_clock
    shifted = draw(Truth(offset_ns=5 * S))  # a time namespace of one machine
    namespace, _ = fit_clock(*shifted.stamps, ping_device="robot", relay_device="base", same_boot=True)
    assert not namespace.same_clock


def test_nothing_to_fit_gives_no_segment():
    nothing = np.empty(0, np.int64)
    fit, offsets = fit_clock(nothing, nothing, nothing, nothing)
    assert fit.segments == fit.steps == ()
    assert len(offsets.offset_ns) == 0


def test_a_message_longer_in_the_relay_than_under_way_is_refused():
    with pytest.raises(ValueError, match="leave it out"):
        fit_clock(*(np.array([t], np.int64) for t in (0, 10, 90, 20)))


def test_a_long_campaign_has_a_knot_every_ten_seconds():
    drawn = draw(Truth(drift_ppb=20_000), messages=4000, rate_hz=20)
    fit, _ = fit_clock(*drawn.stamps)
    (segment,) = fit.segments
    assert len(segment.knots) == 20
    assert segment.drift_bound_ppb < 2_000  # twice 0.2 ms over 200 s
    assert segment.residual_ns < 50_000


@settings(max_examples=50)
@given(messages=st.integers(1, 200), drift=st.floats(-DRIFT, DRIFT), seed=st.integers(0, 2**32))
def test_the_corners_of_the_lines_reach_as_far_as_all_lines(messages, drift, seed):
    generator = np.random.default_rng(seed)
    time = np.sort(generator.integers(0, 10 * S, messages)).astype(np.float64)
    lower = drift * time - generator.exponential(MS, messages).round()
    points = OffsetIntervals(time, lower, lower + generator.exponential(MS, messages).round() + MS)
    through = Lines.through(points, np.array([0]), np.array([messages]))
    if not through.exist[0]:  # the drift is at its limit, and no line is as steep
        return
    (lowest,), (highest,) = through.range_at(time[None, :])
    centre = time[messages // 2]
    for slope in np.linspace(-DRIFT, DRIFT, 2001):
        low = (points.lower - slope * (time - centre)).max()
        high = (points.upper - slope * (time - centre)).min()
        if low <= high:  # a line of this slope respects every message, so it lies within what the corners reach
            assert (low + slope * (time - centre) >= lowest - 0.01).all()
            assert (high + slope * (time - centre) <= highest + 0.01).all()


def drawn_by_chance(seed):
    """Messages of a clock that drifts, and may jump, bend or stand in gaps; in any order, some at equal instants."""
    generator = np.random.default_rng(seed)
    count = int(generator.choice([1, 2, 3, 15, 40, 300, 2000]))
    t1 = START_NS + np.arange(count, dtype=np.int64) * (S // int(generator.choice([1, 5, 10, 100])))
    if generator.random() < 0.3:
        t1 += np.arange(count) // 50 * 20 * S
    if generator.random() < 0.2:
        t1 //= 100 * MS
        t1 *= 100 * MS
    jitter = generator.choice([0, 1000, 200_000, 2_000_000])
    outbound, back = (50_000 + generator.exponential(jitter + 1, count).astype(np.int64) for _ in range(2))
    relay = generator.exponential(100_000, count).astype(np.int64)
    drift_ppb, jump_ns, bend = (
        int(generator.choice([0, -400, 20_000])),
        int(generator.choice([0, 50 * MS])),
        generator.random() < 0.3,
    )

    def theta_ns(true_ns):
        since = true_ns - START_NS
        offset = 1_234_567 + np.rint(since * (drift_ppb / 1e9)).astype(np.int64)
        offset += np.where(since > (t1[-1] - START_NS) // 2, jump_ns, 0)
        return offset + np.clip(since - 5 * S, 0, None) // 10_000 * bend

    arrived, left = t1 + outbound, t1 + outbound + relay
    t2 = left + back
    stamps = (t1, arrived + theta_ns(arrived), left + theta_ns(left), t2)
    fits = stamps[3] - stamps[0] >= stamps[2] - stamps[1]
    order = generator.permutation(np.flatnonzero(fits)) if generator.random() < 0.3 else np.flatnonzero(fits)
    return tuple(stamp[order] for stamp in stamps)


def test_all_windows_at_once_give_what_one_after_another_gives():
    """To the nanosecond: a middle that is half a nanosecond rounds either way, by the rounding of the lines."""
    drawn = [drawn_by_chance(seed) for seed in range(150)]
    fitted = fit_clocks([RelayedMessages(*stamps) for stamps in drawn])
    messages = apart = 0
    for stamps, (fit, offsets) in zip(drawn, fitted, strict=True):
        offset_ns, bound_ns, segments = plain_fit(*stamps)
        assert np.abs(offsets.offset_ns - offset_ns).max() <= 1
        assert np.abs(offsets.bound_ns - bound_ns).max() <= 1
        messages += len(offset_ns)
        apart += np.count_nonzero((offsets.offset_ns != offset_ns) | (offsets.bound_ns != bound_ns))
        knots = [[(k.at_ns, k.offset_ns, k.bound_ns) for k in segment.knots] for segment in fit.segments]
        assert [len(of_segment) for of_segment in knots] == [len(of_segment) for of_segment in segments]
        for of_segment, plain in zip(knots, segments, strict=True):
            assert np.abs(np.array(of_segment) - np.array(plain)).max() <= 1
    assert messages > 30_000
    assert apart < messages / 1000


def test_a_fit_does_not_depend_on_the_fits_beside_it():
    drawn = [drawn_by_chance(seed) for seed in range(20)]
    together = fit_clocks([RelayedMessages(*stamps) for stamps in drawn])
    for stamps, (fit, offsets) in zip(drawn, together, strict=True):
        alone, of_alone = fit_clock(*stamps)
        assert fit == alone
        assert np.array_equal(offsets.offset_ns, of_alone.offset_ns)
        assert np.array_equal(offsets.bound_ns, of_alone.bound_ns)


def test_windows_are_cut_into_blocks_without_a_trace_of_it(monkeypatch):
    drawn = [drawn_by_chance(seed) for seed in range(30)]
    in_one_block = fit_clocks([RelayedMessages(*stamps) for stamps in drawn])
    monkeypatch.setattr(windows, "_BLOCK_MESSAGES", 1000)
    monkeypatch.setattr(windows, "_BLOCK_WINDOWS", 5)
    monkeypatch.setattr(windows, "_CACHED_MESSAGES", 50)
    monkeypatch.setattr(fit_module, "_BLOCK_MESSAGES", 7)
    in_many = fit_clocks([RelayedMessages(*stamps) for stamps in drawn])
    for (fit, offsets), (other, of_other) in zip(in_one_block, in_many, strict=True):
        assert fit == other
        assert np.array_equal(offsets.offset_ns, of_other.offset_ns)


def test_fits_say_of_drawn_clocks_what_they_said():
    assert_pinned("clocks", "clocks")


S = 1_000_000_000


def fitted(*messages, **names):
    stamps = np.array(messages, np.int64).reshape(-1, 4).T
    ((fit, offsets),) = fit_clocks([RelayedMessages(*stamps, **names)])
    return fit, offsets


def test_a_message_that_took_no_time_tells_the_offset():
    fit, offsets = fitted((100, 105, 105, 100))
    assert (offsets.offset_ns.tolist(), offsets.bound_ns.tolist()) == ([5], [1])
    assert (fit.segments[0].start_ns, fit.segments[0].end_ns, fit.segments[0].messages) == (100, 100, 1)
    told = fit.segments[0].drift_ppb, fit.segments[0].drift_bound_ppb
    assert told == pytest.approx((0, 1_100_000), rel=1e-12)


def test_two_messages_that_took_no_time_tell_the_drift():
    fit, _ = fitted((0, 0, 0, 0), (S, S + 100_000, S + 100_000, S))
    assert fit.segments[0].drift_ppb == pytest.approx(100_000, rel=1e-12)
    assert fit.segments[0].drift_bound_ppb == pytest.approx(0, abs=1e-6)


def test_one_machine_may_take_no_time_either_way():
    for message in ((100, 100, 105, 110), (100, 105, 110, 110)):
        assert fitted(message, same_boot=True)[0].same_clock
    for message in ((100, 99, 105, 110), (100, 105, 111, 110)):  # received before it was sent
        assert not fitted(message, same_boot=True)[0].same_clock
    assert not fitted()[0].same_clock


def test_the_drift_of_one_window_is_the_middle_of_its_lines():
    # After one second the relay's clock is 100 us ahead, each time within 10 ns.
    messages = [(at, at + 10 + ahead, at + 10 + ahead, at + 20) for at, ahead in ((0, 0), (S, 100_000))]
    fit, offsets = fitted(*messages)
    assert fit.segments[0].drift_ppb == pytest.approx(100_000, abs=0.1)
    assert fit.segments[0].drift_bound_ppb == pytest.approx(20, abs=0.1)
    assert offsets.offset_ns.tolist() == [0, 100_000]
    assert fitted(*messages[::-1])[1].offset_ns.tolist() == [100_000, 0]


def test_a_step_lies_between_the_messages_that_surely_know_one_clock():
    # 3 ms ahead from the third message on, 10 ns each way, a second apart: clocks part by 1.1 ms in between.
    messages = [
        (at * S, at * S + 10 + ahead, at * S + 10 + ahead, at * S + 20)
        for at, ahead in enumerate([0, 0, 3 * 10**6, 3 * 10**6])
    ]
    fit, _ = fitted(*messages)
    (step,) = fit.steps
    assert (step.after_ns, step.before_ns) == (S + 10, 2 * S + 10)
    assert (step.size_ns, step.bound_ns) == (3 * 10**6, 1_100_021)
    assert [segment.messages for segment in fit.segments] == [2, 2]
