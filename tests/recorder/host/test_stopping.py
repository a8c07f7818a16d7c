"""Processes are told to end, also at the worst moment."""

from __future__ import annotations

import fcntl
import os
import shutil
import signal
import subprocess
import sys

import pytest
from waiting import wait_until

from dds_trace.recorder.bridges.process import guard
from dds_trace.recorder.host.stopping import STOP_SIGNALS, stop_at_signals

PATIENCE_S = 60.0


@pytest.fixture(autouse=True)
def own_handlers():
    before = {number: signal.getsignal(number) for number in STOP_SIGNALS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", STOP_SIGNALS)
def test_a_signal_sets_the_event(number):
    stop = stop_at_signals()
    assert not stop.is_set()
    signal.raise_signal(number)
    assert stop.wait(PATIENCE_S)


@pytest.mark.timeout(PATIENCE_S)
def test_a_signal_inside_the_lock_of_the_event_ends_too():
    # Where `wait()` is interrupted in its first or last steps, and where one handler interrupts another.
    stop = stop_at_signals()
    with stop._cond:
        for number in STOP_SIGNALS:
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
        "from dds_trace.recorder.host.stopping import dying_with_us\n"
        "lock, started = int(sys.argv[1]), sys.argv[2]\n"
        "work = ['sh', '-c', 'touch $0; exec sleep 600', started]\n"
        "subprocess.Popen([*dying_with_us(), *work], pass_fds=[lock]).wait()"
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
