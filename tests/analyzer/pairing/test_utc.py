from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from dds_trace.analyzer.pairing.pair import MISSING
from dds_trace.analyzer.pairing.utc import is_synchronized, utc_columns, utc_text
from dds_trace.tracefile.format.descriptions import Session

SANE_NS = 1 << 61


def session(wall_ns, monotonic_ns, **extra):
    return Session(1, "ping", "a", "ros2", "fastdds", None, 5, None, "wired", wall_ns, monotonic_ns, extra=extra)


def utc_of(*of_exchanges):
    """The UTC of T1 and T3 from (ping, relay, instants) of each exchange."""
    exchanges = [SimpleNamespace(ping=ping, relay=relay) for ping, relay, _ in of_exchanges]
    instants_ns = np.concatenate([np.array(each, np.int64) for *_, each in of_exchanges])
    bounds = np.cumsum([0, *(len(each) for *_, each in of_exchanges)])
    columns = utc_columns(exchanges, bounds, {"publish_ns": instants_ns, "relay_in_ns": instants_ns})
    return [column.to_physical().to_list() for column in columns]


def test_an_instant_is_as_far_from_the_anchor_on_both_clocks():
    instants_ns = [99, 100, 250, SANE_NS - 1, SANE_NS, MISSING]
    publish, relay_in = utc_of(
        (session(1100, 100), session(5000, 0), instants_ns), (None, session(7000, 3000), [250, 3000])
    )
    # Before its session's start, beyond 73 years and without an event there is none.
    assert publish == [None, 1100, 1250, SANE_NS - 1 + 1000, None, None, None, None]
    assert relay_in == [5099, 5100, 5250, SANE_NS - 1 + 5000, None, None, None, 7000]


@pytest.mark.parametrize("way", [1, -1])
def test_a_wall_clock_that_is_off_by_73_years_tells_nothing(way):
    assert utc_of((session(way * SANE_NS, 0), None, [0, 5]))[0] == [None, None]
    assert utc_of((session(way * (SANE_NS - 1), 0), None, [0, 5]))[0] == [way * (SANE_NS - 1), way * (SANE_NS - 1) + 5]


def test_the_kernel_says_whether_a_clock_is_synchronized():
    assert is_synchronized(session(0, 0, clock={"begin": {"status": 0x2001}})) is True
    assert is_synchronized(session(0, 0, clock={"begin": {"status": 0x41}})) is False
    for clock in (None, 5, {"begin": 5}, {"begin": {"status": "64"}}):
        assert is_synchronized(session(0, 0, clock=clock)) is None


def test_an_instant_is_written_as_far_as_an_int64_reaches():
    assert utc_text(0) == "1970-01-01T00:00:00.000000000Z"
    assert utc_text(2**63 - 1) == utc_text(2**63 + 5) == "2262-04-11T23:47:16.854775807Z"
    assert utc_text(-(2**63) + 1) == utc_text(-(2**63) - 5) == "1677-09-21T00:12:43.145224193Z"
