from __future__ import annotations

import io

from rich.console import Console

from dds_trace.recorder.sweep.plan.schedule import Remaining
from dds_trace.recorder.sweep.run.progress import PlainProgress, RichProgress, make_progress


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
