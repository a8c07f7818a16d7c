"""Ctrl-C ends a search or a sweep, wherever it comes: each script presses it where it was once lost."""

import sys

import pytest
from processes import executed

SCRIPT = """
import ctypes, gc, signal, sys, threading, time, weakref
from pathlib import Path
import typer
from dds_trace.extensions.campaigns.commands.common import run_until_interrupted
from dds_trace.extensions.campaigns.studio.desk import Desk

def press(*_):
    signal.raise_signal(signal.SIGINT)

def press_elsewhere(main=threading.get_ident()):
    while sys._current_frames()[main].f_code.co_name != "wait":
        time.sleep(0.01)
    signal.pthread_kill(threading.get_ident(), signal.SIGINT)

def run():
    {pressed}
    time.sleep(600)

{before}
try:
    run_until_interrupted(run, Path("runs"))
except typer.Exit as end:
    sys.exit(end.exit_code)
"""
PRESSED = {
    "between two lines": "press()",
    "a destructor": "type('Gone', (), dict(__del__=press))()",
    "a weak reference": "gone = set(); kept = weakref.ref(gone, press); del gone",
    "the garbage collector": "gc.callbacks.append(press); gc.collect(); gc.callbacks.clear()",
    "a callback from C": "ctypes.CFUNCTYPE(None)(press)()",
    "another thread, while a question is awaited": "threading.Thread(target=press_elsewhere).start(); Desk(Path('runs')).work()",
}
IGNORED = "signal.signal(signal.SIGINT, signal.SIG_IGN)"
"""As a shell starts `command &` where it has no jobs."""


@pytest.mark.parametrize("before", ["", IGNORED], ids=["foreground", "background"])
@pytest.mark.parametrize("pressed", PRESSED)
def test_ctrl_c_is_never_lost(tmp_path, pressed, before):
    done = executed([sys.executable, "-c", SCRIPT.format(pressed=PRESSED[pressed], before=before)], cwd=tmp_path)
    assert done.returncode == 130, done.stderr
    assert "Interrupted" in done.stderr


def test_nohup_keeps_a_search_that_has_lost_its_terminal():
    script = SCRIPT.format(pressed="signal.raise_signal(signal.SIGHUP); return 0", before=IGNORED.replace("INT", "HUP"))
    assert executed([sys.executable, "-c", script]).returncode == 0
