from collections import Counter
from types import SimpleNamespace

import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dds_trace.analyzer.pairing.exchanges import (
    OVERLAP_NS,
    Doubt,
    Overlap,
    RunSpan,
    count_flows,
    find_overlaps,
    find_ping_session,
    find_relay_session,
)
from dds_trace.analyzer.pairing.one_way import KNOT_SCHEMA, SEGMENT_SCHEMA, pair_devices
from dds_trace.tracefile.format.descriptions import Run, Session


def session(number, role, start_ns, relay_id=None):
    return Session(number, role, "a", "ros2", "fastdds", None, 5, relay_id, "wired", start_ns, start_ns)


def campaign_of(*traces):
    sessions = {each.session_id: each for trace in traces for each in trace}
    return SimpleNamespace(
        sessions=sessions, traces=[SimpleNamespace(sessions=trace) for trace in traces], run_traces={1: {0}}
    )


RUN = Run(1, "binary", 1, 1.0, 1, 0)
EARLY, LATE = session(1, "ping", 100), session(2, "ping", 200)


@pytest.mark.parametrize(("first_ns", "found"), [(50, EARLY), (100, EARLY), (199, EARLY), (200, LATE)])
def test_of_two_sessions_the_last_that_had_started_is_taken_and_doubted(first_ns, found):
    doubts = []
    assert find_ping_session(campaign_of([LATE, EARLY]), RUN, set(), first_ns, doubts) is found
    assert doubts == [Doubt("ping", 1, 0, (1, 2))]


def test_one_session_or_a_named_one_is_not_doubted():
    doubts = []
    relay = session(3, "relay", 0, 7)
    assert find_ping_session(campaign_of([EARLY, relay]), RUN, set(), 500, doubts) is EARLY
    named = Run(1, "binary", 1, 1.0, 1, 0, extra={"session_id": "1"})
    assert find_ping_session(campaign_of([EARLY, LATE]), named, set(), 500, doubts) is EARLY
    assert find_ping_session(campaign_of([relay], [LATE]), RUN, set(), 500, doubts) is None
    assert find_ping_session(campaign_of([relay], [LATE]), RUN, {1}, 500, doubts) is LATE
    assert doubts == []


def test_a_relay_is_known_by_its_id():
    ours, later, other = session(3, "relay", 10, 7), session(4, "relay", 30, 7), session(5, "relay", 90, 8)
    ping = session(6, "ping", 99, 7)
    campaign, doubts = campaign_of([ours, other, ping], [later]), []
    assert find_relay_session(campaign, 1, 7, {0}, 50, doubts) is ours
    assert find_relay_session(campaign, 1, 7, set(), 50, doubts) is later  # without its trace the youngest
    assert find_relay_session(campaign, 1, 9, set(), 50, doubts) is None
    assert doubts == []
    assert find_relay_session(campaign, 1, 7, {0, 1}, 20, doubts) is ours
    assert doubts == [Doubt("relay", 1, 7, (3, 4))]
    unnamed = session(8, "relay", 5)
    assert find_relay_session(campaign_of([unnamed, other]), 1, 7, {0}, 50, []) is unnamed


S = 1_000_000_000


def spans(*seconds, machine="a"):
    return [RunSpan(begin * S, end * S, number, machine) for number, (begin, end) in enumerate(seconds, 1)]


def test_runs_in_the_middle_of_each_other_are_flows():
    drawn = spans((0, 10), (4, 12), (11, 21))
    assert count_flows(drawn) == {1: 2, 2: 2, 3: 1}
    # The first pair shares six of eight seconds; the last one a second, which is in the middle of neither.
    assert list(find_overlaps(drawn)) == [Overlap(1, 2, 0.75, True), Overlap(2, 3, 1 / 8, False)]


def test_runs_of_two_machines_do_not_disturb_each_other():
    drawn = [*spans((0, 10)), RunSpan(0, 10 * S, 2, "b")]
    assert count_flows(drawn) == {1: 1, 2: 1}
    assert list(find_overlaps(drawn)) == []


def test_a_run_with_two_relays_is_one_run():
    drawn = spans((0, 10))
    assert count_flows([*drawn, *drawn]) == {1: 1}
    assert list(find_overlaps([*drawn, *drawn])) == []


def test_a_run_of_one_message_overlaps_what_goes_on_around_it():
    assert list(find_overlaps(spans((0, 10), (5, 5)))) == [Overlap(1, 2, 1.0, True)]


def test_a_run_of_one_message_at_the_edge_of_another_run_overlaps_it():
    assert list(find_overlaps(spans((0, 10), (10, 10)))) == [Overlap(1, 2, 1.0, False)]
    assert list(find_overlaps(spans((5, 5), (5, 15)))) == [Overlap(1, 2, 1.0, False)]
    assert list(find_overlaps([RunSpan(0, 9, 1, "a"), RunSpan(10, 10, 2, "a")])) == []


instants = st.integers(0, 6 * OVERLAP_NS)


@given(st.lists(st.tuples(instants, instants), max_size=12))
def test_what_counts_as_a_flow_is_an_overlap(drawn):
    runs = [RunSpan(min(pair), max(pair), number, "a") for number, pair in enumerate(drawn)]
    of_run = Counter(run_id for overlap in find_overlaps(runs) for run_id in (overlap.one, overlap.other))
    flows = count_flows(runs)
    assert all(flows[run.run_id] - 1 <= of_run[run.run_id] for run in runs)
    mutual = Counter(
        run_id for overlap in find_overlaps(runs) if overlap.is_mutual for run_id in (overlap.one, overlap.other)
    )
    assert all(flows[run.run_id] - 1 >= mutual[run.run_id] for run in runs)


MS = 1_000_000


def fits_of(*segments):
    """Segments of `(boot, start and end in s, drift bound in ppb, step and its bound in ms)`, of alpha and beta."""
    rows = [
        {
            "ping_device": "alpha",
            "relay_device": "beta",
            "boot": boot,
            "segment": 0,
            "start_ns": begin * S,
            "end_ns": end * S,
            "drift_ppb": drift[0],
            "drift_bound_ppb": drift[1],
            "step_before_ns": step_ns,
            "step_bound_ns": bound_ns,
        }
        for boot, begin, end, drift, step_ns, bound_ns in segments
    ]
    return pl.DataFrame(rows, schema=SEGMENT_SCHEMA)


def knots_of(*knots):
    """Knots of `(run, instant in s, offset in ms)`, of alpha and beta."""
    rows = [(0, run_id, 1, "alpha", "beta", 1, at * S, offset * MS, 10_000, None, None) for run_id, at, offset in knots]
    return pl.DataFrame(rows, schema=KNOT_SCHEMA, orient="row")


def test_each_boot_of_a_ping_has_its_own_knots_by_time():
    still = (0.0, 1000.0)
    fits = fits_of((0, 0, 9, still, None, None), (4, 0, 9, still, None, None), (7, 0, 9, still, None, None))
    knots = knots_of((1, 8, 3), (2, 5, 1), (3, 2, 2))  # of the third run no boot is known
    pairs = list(pair_devices(fits, knots, {1: 0, 2: 4}))
    assert [pair.segments[0]["boot"] for pair in pairs] == [0, 4, 7]
    assert [pair.knots["run_id"].to_list() for pair in pairs] == [[3, 1], [2], []]
    assert {tuple(pair.knots.columns) for pair in pairs} == {tuple(KNOT_SCHEMA)}
    assert [pair.slews for pair in pairs] == [()] * 3


def test_steps_from_the_second_segment_on_are_slews():
    # 10 ms each five seconds; the first segment, which has no step, is as near as the others.
    unsure = (0.0, 500_000.0)
    starts = (5, 10, 15)
    fits = fits_of((0, 0, 5, unsure, None, None), *((0, at, at + 5, unsure, 10 * MS, MS // 10) for at in starts))
    (pair,) = pair_devices(fits, knots_of(*((1, at, 2 * at) for at in range(21))), {1: 0})
    (slew,) = pair.slews
    assert (slew.first, slew.after, slew.rate_ppm) == (1, 4, 2000.0)
    assert len(pair.segments) == 4


def test_a_step_counts_with_its_bound():
    # It barely shows beside a clock that ran fast: a slew; known ten times as well it is a jump.
    fast, still = (400_000.0, 50_000.0), (0.0, 1000.0)
    knots = knots_of(*((1, at, at) for at in range(100)))
    found = []
    for bound_ns in (11 * MS, MS):
        fits = fits_of((0, 0, 40, fast, None, None), (0, 40, 100, still, 12 * MS, bound_ns))
        (pair,) = pair_devices(fits, knots, {1: 0})
        found.append([(slew.first, slew.after) for slew in pair.slews])
    assert found == [[(1, 2)], []]
