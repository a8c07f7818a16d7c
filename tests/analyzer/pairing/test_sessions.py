from __future__ import annotations

from types import SimpleNamespace

import pytest

from dds_trace.analyzer.pairing.exchanges import Doubt, find_ping_session, find_relay_session
from dds_trace.tracefile.format.descriptions import Run, Session


def session(number, role, start_ns, relay_id=None):
    return Session(number, role, "a", "ros2", "fastdds", None, 5, relay_id, "wired", start_ns, start_ns)


def campaign_of(*traces):
    """A campaign of traces, each given as its sessions; run 1 is in the first."""
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
