import ast
import fcntl
import os
import shutil
import signal
import subprocess
import sys

import pytest
from processes import executed
from waiting import PATIENCE_S, wait_until

from dds_trace.base.errors import OptionError
from dds_trace.base.threads import run_in_background
from dds_trace.extensions.bridges import guard
from dds_trace.recorder.host.process import STOP_SIGNALS, apply_privileges, parse_cpus, set_realtime, stop_at_signals

# Each runs in a process of its own: priority and affinity must not reach the other tests.
REALTIME = """
import os, pathlib, sys, threading, time
from dds_trace.recorder.host.process import apply_privileges
from dds_trace.recorder.host.sampling import HostSampler
from dds_trace.tracefile.format.descriptions import Session
from dds_trace.tracefile.writing.destination import TraceDestination
from dds_trace.tracefile.writing.sink import TraceSink
print(apply_privileges(realtime_priority=7))
path, sampled = pathlib.Path(sys.argv[1]), threading.Event()
session = Session(1, "ping", "pi4", "socket", "socket", None, 10, None, "loopback", 10**18, 0)
sink = TraceSink(TraceDestination(path, chunk_seconds=0.01), session)
before = path.stat().st_size
sink.record(1, 1, 0, 5)
done = threading.Event()
threading.Thread(target=done.wait, name="ping").start()
with HostSampler(lambda _: sampled.set(), period_s=0.01):
    assert sampled.wait(60)
    while path.stat().st_size == before:  # the event is in the file: the thread that writes has begun
        time.sleep(0.01)
    print({thread.name: os.sched_getscheduler(thread.native_id) for thread in threading.enumerate()})
done.set()
sink.close()
locked = [line for line in open("/proc/self/status") if line.startswith("VmLck")][0]
assert int(locked.split()[1]) > 0, locked
"""

AFFINITY = """
import os, pathlib, threading
from dds_trace.recorder.host.process import apply_privileges
release = threading.Event()
thread = threading.Thread(target=release.wait); thread.start()
cpu = min(os.sched_getaffinity(0))
assert apply_privileges(cpu_affinity=str(cpu)) == {"cpu_affinity": [cpu]}
tasks = [int(task.name) for task in pathlib.Path("/proc/self/task").iterdir()]
assert len(tasks) >= 2
assert all(os.sched_getaffinity(task) == {cpu} for task in tasks)
release.set()
"""


def run(script, *arguments):
    return executed([sys.executable, "-c", script, *arguments])


def test_without_options_nothing_changes():
    assert apply_privileges() == {}


@pytest.mark.parametrize(
    ("text", "cpus"), [("3", [3]), ("0,2", [0, 2]), ("2-4", [2, 3, 4]), ("0, 2-3", [0, 2, 3]), ("1,1", [1])]
)
def test_cpu_lists(text, cpus):
    assert parse_cpus(text) == cpus


@pytest.mark.parametrize("text", ["", "a", "-1", "3-1", "1,,2", "1;2"])
def test_text_that_is_no_cpu_list_is_refused(text):
    with pytest.raises(OptionError, match=r"cpu[-_]affinity"):
        parse_cpus(text)


def test_a_missing_cpu_is_named():
    with pytest.raises(OptionError, match="CPU 9999 is not among"):
        apply_privileges(cpu_affinity="9999")


def test_all_threads_move_to_the_cpus():
    done = run(AFFINITY)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("priority", [0, 100, -5])
def test_priority_out_of_range(priority):
    with pytest.raises(OptionError, match="99"):
        set_realtime(priority)


def test_refusal_says_how_to_be_permitted(monkeypatch):
    def refuse(*_arguments):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with pytest.raises(OptionError, match=r"SCHED_FIFO is not permitted .*limits\.conf"):
        set_realtime(50)
    run_in_background()


def test_threads_that_stamp_are_realtime_and_those_that_write_are_not(tmp_path):
    done = run(REALTIME, tmp_path / "x.mcap")
    if "not permitted" in done.stderr:
        pytest.skip("SCHED_FIFO is not permitted here")
    assert done.returncode == 0, done.stderr
    applied, scheduled = map(ast.literal_eval, done.stdout.splitlines())
    assert applied == {"realtime_priority": 7, "memory_locked": True}
    realtime, ordinary = os.SCHED_FIFO, os.SCHED_OTHER
    assert scheduled == {
        "MainThread": realtime, "ping": realtime, "trace-sink": ordinary, "host-sampler": ordinary
    }  # fmt: skip


@pytest.fixture(autouse=True)
def own_handlers():
    before = {number: signal.signal(number, signal.SIG_DFL) for number in STOP_SIGNALS}  # `nohup` has one ignored
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", STOP_SIGNALS)
def test_a_signal_sets_the_event(number):
    stop = stop_at_signals()
    assert not stop.is_set()
    signal.raise_signal(number)
    assert stop.wait(PATIENCE_S)


def test_a_signal_inside_the_lock_of_the_event_ends_too():
    # Where `wait()` is interrupted in its first or last steps, and where one handler interrupts another.
    stop = stop_at_signals()
    with stop._cond:
        for number in STOP_SIGNALS[:2]:  # a third one ends the process
            signal.raise_signal(number)
    assert stop.wait(PATIENCE_S)


@pytest.mark.skipif(shutil.which("setpriv") is None, reason="setpriv (util-linux) is not installed")
@pytest.mark.parametrize("killed", ["before the kernel is asked", "after"])
def test_a_program_ends_with_the_process_that_started_it(tmp_path, killed):
    """The program's lock becomes free; what was left held it for ever, and went on into other recordings."""
    slow = tmp_path / "bin" / "setpriv"
    slow.parent.mkdir()
    wait = f"until test -e {tmp_path}/go; do sleep 0.01; done"
    slow.write_text(f'#!/bin/sh\ntouch {tmp_path}/forked\n{wait}\nexec {shutil.which("setpriv")} "$@"\n')
    slow.chmod(0o755)
    script = (
        "import subprocess, sys\n"
        "from dds_trace.recorder.host.child import ending_with_parent\n"
        "lock, started = int(sys.argv[1]), sys.argv[2]\n"
        "work = ['sh', '-c', 'touch $0; exec sleep 600', started]\n"
        "subprocess.Popen([*ending_with_parent(), *work], pass_fds=[lock]).wait()"
    )
    started = tmp_path / "started"
    with (tmp_path / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        parent = subprocess.Popen(
            [sys.executable, "-c", script, str(lock.fileno()), started],
            env={**os.environ, "PATH": f"{slow.parent}:{os.environ['PATH']}"},
            pass_fds=[lock.fileno()],
        )
    if killed == "after":
        (tmp_path / "go").touch()
        wait_until(started.exists)
    wait_until((tmp_path / "forked").exists)
    parent.kill()
    parent.wait()
    (tmp_path / "go").touch()
    wait_until(lambda: is_free(tmp_path / "lock"))
    assert started.exists() == (killed == "after")


def test_a_program_of_a_guard_that_is_gone_does_not_begin():
    script = f"import os, runpy; runpy.run_path({guard.__file__!r})['die_with'](os.getpid()); print('began')"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (-signal.SIGKILL, "")


def is_free(path):
    with path.open() as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
    return True


@pytest.mark.parametrize(("after_s", "code"), [(0.2, 0), (0.2, 12), (0.2, 130), (600, 7)])
def test_a_process_ends_with_its_code_whoever_keeps_the_interpreters_lock(after_s, code):
    """`PyDLL` calls with the lock held, as a middleware's binding does; the last exit is called off."""
    script = "import ctypes, sys\nfrom dds_trace.recorder.host.process import exit_after\n"
    call = "exit_after(600, 9)()\nsys.exit(7)" if after_s == 600 else f"exit_after({after_s}, {code})"
    done = run(f"{script}{call}\nctypes.PyDLL(None).sleep(600)")
    assert done.returncode == code, done.stderr


def test_a_third_signal_closes_what_is_open_first(tmp_path):
    done = run(
        "import os, signal, sys\nfrom pathlib import Path\n"
        "from dds_trace.recorder.host.process import stop_at_signals\n"
        "stop = stop_at_signals()\nstop.last_act = Path(sys.argv[1]).touch\n"
        "for number in (signal.SIGINT, signal.SIGTERM, signal.SIGTERM):\n    os.kill(os.getpid(), number)\n"
        "signal.pause()\nsignal.pause()",
        tmp_path / "closed",
    )
    assert done.returncode == 128 + signal.SIGTERM, done.stderr
    assert (tmp_path / "closed").exists()


SPINS = """
import hashlib, os, threading
from dds_trace.recorder.host.process import set_realtime, stop_at_signals
stop = stop_at_signals()
set_realtime(5)
spinning = threading.Thread(target=hashlib.pbkdf2_hmac, args=("sha256", b"x", b"x", 10**9), daemon=True)
spinning.start()
while not stop.wait(0.1):  # the signal interrupts the thread that spins
    pass
print(stop.is_spinning, os.sched_getscheduler(spinning.native_id) == os.SCHED_OTHER)
"""


def test_a_thread_that_spins_in_real_time_gives_its_priority_back():
    done = run(SPINS)
    if "not permitted" in done.stderr:
        pytest.skip("SCHED_FIFO is not permitted here")
    assert (done.returncode, done.stdout.split()) == (0, ["True", "True"]), done.stderr
