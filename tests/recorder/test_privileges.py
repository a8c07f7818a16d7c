from __future__ import annotations

import os
import subprocess
import sys

import pytest

from recorder import privileges
from recorder.privileges import apply_privileges, parse_cpus, set_realtime
from tracefile import OptionError

# Each runs in a process of its own: priority and affinity must not reach the other tests.
REALTIME = """
import os, threading
from recorder.privileges import apply_privileges, run_in_background
print(apply_privileges(realtime_priority=7))
assert os.sched_getscheduler(0) == os.SCHED_FIFO
seen = []
def work():
    seen.append(os.sched_getscheduler(0))
    run_in_background()
    seen.append(os.sched_getscheduler(0))
thread = threading.Thread(target=work); thread.start(); thread.join()
assert seen == [os.SCHED_FIFO, os.SCHED_OTHER], seen
locked = [line for line in open("/proc/self/status") if line.startswith("VmLck")][0]
assert int(locked.split()[1]) > 0, locked
"""

AFFINITY = """
import os, pathlib, threading
from recorder.privileges import apply_privileges
release = threading.Event()
thread = threading.Thread(target=release.wait); thread.start()
cpu = min(os.sched_getaffinity(0))
assert apply_privileges(cpu_affinity=str(cpu)) == {"cpu_affinity": [cpu]}
tasks = [int(task.name) for task in pathlib.Path("/proc/self/task").iterdir()]
assert len(tasks) >= 2
assert all(os.sched_getaffinity(task) == {cpu} for task in tasks)
release.set()
"""


def run(script):
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)


def test_nothing_asked_for_changes_nothing():
    assert apply_privileges() == {}


@pytest.mark.parametrize(
    ("text", "cpus"),
    [("3", [3]), ("0,2", [0, 2]), ("2-4", [2, 3, 4]), ("0, 2-3", [0, 2, 3]), ("1,1", [1])],
)
def test_cpu_lists(text, cpus):
    assert parse_cpus(text) == cpus


@pytest.mark.parametrize("text", ["", "a", "-1", "3-1", "1,,2", "1;2"])
def test_no_cpu_list_is_one_clear_error(text):
    with pytest.raises(OptionError, match="--cpu-affinity"):
        parse_cpus(text)


def test_cpu_that_is_not_there_is_named():
    with pytest.raises(OptionError, match="CPU 9999 is not among"):
        apply_privileges(cpu_affinity="9999")


def test_all_threads_move_to_the_cpus():
    done = run(AFFINITY)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("priority", [0, 100, -5])
def test_priority_out_of_range(priority):
    with pytest.raises(OptionError, match="1 to 99"):
        set_realtime(priority)


def test_refusal_says_how_to_be_permitted(monkeypatch):
    def refuse(*_arguments):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with pytest.raises(OptionError, match=r"SCHED_FIFO is not permitted .*limits\.conf"):
        set_realtime(50)
    privileges.run_in_background()


def test_realtime_and_locked_memory_where_permitted():
    done = run(REALTIME)
    if "not permitted" in done.stderr:
        pytest.skip("SCHED_FIFO is not permitted here")
    assert done.returncode == 0, done.stderr
    assert "'memory_locked': True" in done.stdout
