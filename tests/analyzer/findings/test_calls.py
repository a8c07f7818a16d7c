"""Findings about calls, from what a run's description says of them."""

from __future__ import annotations

import pytest
from trace_files import Message, ping_events, ping_session, relay_events, relay_session, run, write_trace

from dds_trace.analyzer.pipeline import analyze

COUNT, PERIOD = 50, 100_000_000
TIMES = {"first_ns": 12_000_000, "typed_ns": 40_000, "accepted_p50_ns": 900_000, "feedback_p50_ns": 1_100_000}


def findings_of(folder, call):
    messages = [
        Message(s, t0=s * PERIOD, t1=s * PERIOD + 50, t3=s * PERIOD, t4=s * PERIOD + 20, t2=s * PERIOD + 1000 + s % 7)
        for s in range(COUNT)
    ]
    described = run(planned_messages=COUNT, published=COUNT, extra={"call": call})
    write_trace(folder / "ping.mcap", ping_session(), [described], ping_events(messages))
    write_trace(folder / "relay.mcap", relay_session(), (), relay_events(messages))
    return {finding.code: finding.what for finding in analyze(folder).findings}


def test_a_call_is_reported_with_its_first_one_and_its_conversion(tmp_path, sentences):
    found = findings_of(tmp_path, {"timeout_s": 10.0, "timed_out": 0, **TIMES})
    assert "calls_timed_out" not in found
    sentences(found["calls"])


def test_calls_beyond_their_timeout_are_counted(tmp_path, sentences):
    sentences(findings_of(tmp_path, {"timeout_s": 0.5, "timed_out": 3, **TIMES})["calls_timed_out"])


@pytest.mark.parametrize(
    "call", [{}, [], {"first_ns": "x", "timed_out": -1, "typed_ns": True}, "x", {"timed_out": None}]
)
def test_a_description_of_others_is_no_error(tmp_path, call):
    assert not {"calls", "calls_timed_out"} & findings_of(tmp_path, call).keys()
