"""Flows that a sweep records at the same time, with stand-ins: they succeed, fail and go on together."""

import io
from collections import Counter

import pytest
from rich.console import Console
from trace_files import Message, ping_events, ping_session, run, write_trace

from dds_trace.base.errors import TraceFormatError
from dds_trace.extensions.campaigns.plan.schedule import Remaining
from dds_trace.extensions.campaigns.run.progress import PlainProgress, RichProgress, make_progress
from dds_trace.extensions.campaigns.run.result import read_result
from dds_trace.extensions.campaigns.run.state import Status
from dds_trace.tracefile.format.events import Stage

PLAN = """
[run]
seconds = 0.01
warmup = 1
settle_seconds = 0
cutoff_seconds = 0
order = "listed"
[[flows]]
name = "a"
rate = 100
[[flows]]
name = "b"
rate = 200
"""
A, B = "ros2_same_binary_100Hz_a", "ros2_same_binary_200Hz_b"
A_WITH_B, B_WITH_A = f"{A}_with-b", f"{B}_with-a"


def argument(start, name):
    return start["arguments"][start["arguments"].index(name) + 1]


def test_alone_then_together_with_one_start_for_all(desk):
    outcome = desk.sweep(PLAN)
    assert outcome.missing == {}
    assert desk.started == {A: 1, B: 1, A_WITH_B: 1, B_WITH_A: 1, "relay": 1}
    pings = {start["cell"]: start for start in desk.starts if start["cell"] != "relay"}
    assert "--start-at" not in pings[A]["arguments"]
    assert argument(pings[A_WITH_B], "--start-at") == argument(pings[B_WITH_A], "--start-at")


def test_one_that_fails_fails_its_neighbour_and_both_are_tried_again(desk):
    desk.script(**{A_WITH_B: ["fail", "ok"]})
    outcome = desk.sweep(PLAN)
    assert outcome.missing == {}
    assert desk.state(A_WITH_B, PLAN).attempts == desk.state(B_WITH_A, PLAN).attempts == 2


def test_a_resumed_sweep_records_both_again_if_one_has_no_recording(desk):
    desk.script(**{A_WITH_B: ["fail", "fail"]})
    first = desk.sweep(PLAN)
    assert set(first.missing) == {A_WITH_B, B_WITH_A}
    before = Counter(desk.started)
    desk.script(number=4)
    assert desk.sweep(PLAN).missing == {}
    assert desk.started - before == {A_WITH_B: 1, B_WITH_A: 1, "relay": 1}
    assert desk.state(B_WITH_A, PLAN).status is Status.COMPLETE


def tell(progress):
    progress.begin(3, 1)
    progress.relay("ros2")
    progress.cell("a_10Hz", Remaining(61))
    progress.ended("a_10Hz", "RTT p50 0.92 p99 2.10 ms, 50/50 messages", complete=True)
    progress.ended("b_10Hz", "failed: [bold]no echo[/bold]", complete=False)
    progress.end()


def console(*, terminal):
    return Console(file=io.StringIO(), force_terminal=terminal, width=120, _environ={"TERM": "xterm"})


def test_plain_lines_for_a_log(sentences):
    there = console(terminal=False)
    progress = make_progress(there)
    assert type(progress) is PlainProgress
    tell(progress)
    sentences(*there.file.getvalue().splitlines())


def test_bar_on_a_terminal_shows_the_time_left_and_the_last_percentiles():
    there = console(terminal=True)
    progress = make_progress(there)
    assert type(progress) is RichProgress
    tell(progress)
    task = progress._progress.tasks[0]
    assert (task.completed, task.total) == (2, 3)
    assert task.fields["left"] == "1 min 01 s left"
    assert "a_10Hz: RTT p50 0.92 p99 2.10" in there.file.getvalue()


def test_the_line_of_the_bar_is_whole_at_80_columns():
    there = Console(file=io.StringIO(), force_terminal=True, width=80, _environ={"TERM": "xterm"})
    progress = RichProgress(there)
    progress.begin(1250, 0)
    progress.cell("cyclonedds_zenoh-bridge-dds_binary-145KB_100Hz_r12", Remaining(3599))
    there.print(progress._progress.get_renderable())
    progress.end()
    shown = [line for line in there.file.getvalue().splitlines() if "cyclonedds" in line]
    assert shown
    assert all("zenoh-bridge-…" in line and "0/1250" in line and f"{Remaining(3599)} left" in line for line in shown)


def test_number_of_cells_may_be_unknown():
    there = console(terminal=False)
    progress = PlainProgress(there)
    progress.begin(0, 0)
    progress.ended("a", "held", complete=True)
    assert there.file.getvalue() == "[1] a: held\n"


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
    assert str(result).startswith("no reply, 0/1, 100 % lost")


def test_a_run_that_was_not_finished_and_a_relays_trace_are_no_result(tmp_path):
    with pytest.raises(TraceFormatError, match="not finished"):
        read_result(write(tmp_path / "a.mcap", state="started"))
    with pytest.raises(TraceFormatError, match="has 0 runs"):
        read_result(write_trace(tmp_path / "b.mcap", ping_session()))
