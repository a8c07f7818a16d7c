from __future__ import annotations

import pytest
from trace_files import Message, ping_events, ping_session, run, write_trace

from dds_trace.base.errors import TraceFormatError
from dds_trace.recorder.sweep.run.result import read_result
from dds_trace.tracefile.format.events import Stage

MS = 1_000_000

#           planned     sent        back
TIMELINE = [
    Message(0, t0=0 * MS, t1=0 * MS, t2=90 * MS),  # warm-up
    Message(1, t0=10 * MS, t1=10 * MS, t2=11 * MS),
    Message(2, t0=20 * MS, t1=22 * MS, t2=24 * MS),  # sent 2 ms late
    Message(3, t0=30 * MS, t1=30 * MS),  # lost
    Message(4, t0=40 * MS, t1=40 * MS, t2=43 * MS),
]


def write(path, messages=TIMELINE, *, dropped=0, **fields):
    described = run(**{"planned_messages": 4, "warmup_messages": 1, "published": 5, **fields})
    events = ping_events(messages)
    # a duplicate of the reply to message 1, later than the first
    events[Stage.T2].append(ping_events([Message(1, t2=50 * MS)])[Stage.T2][0])
    return write_trace(path, ping_session(dropped_events=dropped), [described], events)


def test_numbers_of_a_run_by_hand(tmp_path, sentences):
    result = read_result(write(tmp_path / "a.mcap", dropped=2))
    assert (result.planned, result.published, result.received) == (4, 4, 3)
    assert result.sent_bytes == 5 * 33_000
    assert result.loss_percent == 25.0
    assert result.rtt_ms["p50"] == 2.0  # of 1, 2, 3
    assert result.response_ms["p50"] == 3.0  # of 1, 4, 3
    assert result.achieved_rate_hz == 100.0  # 4 messages over 30 ms
    assert result.dropped_events == 2
    assert not result.cut_off
    sentences(str(result))


def test_what_was_not_applied_is_in_the_cells_line(tmp_path):
    words = "asked for UDP, the bytes went through shared memory"
    session = ping_session(extra={"not_applied": [{"words": words}]})
    described = run(planned_messages=4, warmup_messages=1, published=5)
    result = read_result(write_trace(tmp_path / "a.mcap", session, [described], ping_events(TIMELINE)))
    assert result.not_applied == words
    assert str(result).endswith(f"; not applied: {words}")


def test_run_that_was_ended_early(tmp_path, sentences):
    result = read_result(write(tmp_path / "a.mcap", TIMELINE[:3], published=3))
    assert result.cut_off
    sentences(str(result))


def test_run_without_any_reply(tmp_path):
    path = write_trace(tmp_path / "a.mcap", ping_session(), [run()], ping_events([Message(0, t1=0)]))
    result = read_result(path)
    assert (result.rtt_ms, result.achieved_rate_hz, result.loss_percent) == (None, None, 100.0)
    assert str(result).startswith("no reply, 0/1 message,")


def test_a_run_that_was_not_finished_and_a_relays_trace_are_no_result(tmp_path):
    with pytest.raises(TraceFormatError, match="not finished"):
        read_result(write(tmp_path / "a.mcap", state="started"))
    with pytest.raises(TraceFormatError, match="has 0 runs"):
        read_result(write_trace(tmp_path / "b.mcap", ping_session()))
