import fcntl
import json
import os
import signal
import subprocess
import sys
import time

import pytest
from trace_files import relay_session

from dds_trace.extensions.service.running import (
    SUFFIX,
    RunningRecording,
    State,
    causes_of_relays,
    list_recordings,
    runtime_folder,
)
from dds_trace.tracefile.format.ring import ring_path
from dds_trace.tracefile.writing.destination import TraceDestination
from dds_trace.tracefile.writing.sink import TraceSink

LIVE = """
import sys, time
from pathlib import Path
from trace_files import relay_session
from dds_trace.extensions.service.running import RunningRecording
folder = Path(sys.argv[1])
running = RunningRecording(relay_session(session_id=int(sys.argv[2])), folder / "killed.mcap", folder)
running.update(path=folder / "killed.00002.mcap", messages=41, files=2, stopped=None)
print("told", flush=True)
time.sleep(60)
"""


def test_a_living_recording_is_listed_until_it_ends(tmp_path):
    running = RunningRecording(relay_session(), tmp_path / "relay.mcap", tmp_path / "run")
    (listed,) = list_recordings([tmp_path / "run", tmp_path / "nowhere"])
    assert listed.state is State.RUNNING
    entry = listed.entry
    assert (entry.role, entry.domain_id, entry.pid, entry.messages) == ("relay", 10, os.getpid(), 0)
    assert (entry.rmw, entry.path) == ("rmw_fastrtps_cpp", str(tmp_path / "relay.mcap"))
    running.update(path=tmp_path / "other.mcap", messages=7, files=2, stopped="the disk is full")
    (listed,) = list_recordings([tmp_path / "run"])
    assert (listed.entry.messages, listed.entry.files, listed.entry.stopped) == (7, 2, "the disk is full")
    assert listed.entry.told_ns > entry.told_ns
    running.close()
    running.close()
    assert list_recordings([tmp_path / "run"]) == []
    assert list((tmp_path / "run").iterdir()) == []


def test_what_a_relay_sees_of_itself_is_there_for_pings_of_its_domain(tmp_path):
    running = RunningRecording(relay_session(), tmp_path / "relay.mcap")
    running.causes = ("a \x1b cause",)
    running.update(path=tmp_path / "relay.mcap", messages=0, files=1, stopped=None)
    assert [*causes_of_relays(11)] == []
    (said,) = causes_of_relays(10)
    assert said.startswith(f"at the relay (process {os.getpid()}, ros2): a ")
    assert "\x1b" not in said
    running.close()
    assert [*causes_of_relays(10)] == []


def test_a_killed_one_is_told_as_such_and_swept_once_nothing_of_it_waits(tmp_path):
    words = [sys.executable, "-c", LIVE, str(tmp_path), "1"]
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, text=True, env=os.environ | {"PYTHONPATH": ":".join(sys.path)}
    ) as process:
        assert process.stdout.readline() == "told\n"
        assert [each.state for each in list_recordings([tmp_path])] == [State.RUNNING]
        process.send_signal(signal.SIGKILL)
        process.wait()
    (listed,) = list_recordings([tmp_path])
    assert (listed.state, listed.waiting, listed.entry.messages) == (State.KILLED, None, 41)
    ring = tmp_path / "killed.00002.mcap.ring"
    ring.touch()
    assert [each.waiting for each in list_recordings([tmp_path])] == [tmp_path / "killed.00002.mcap"]
    RunningRecording(relay_session(session_id=2), tmp_path / "b.mcap", tmp_path).close()
    assert len(list_recordings([tmp_path])) == 1  # its events wait
    ring.unlink()
    RunningRecording(relay_session(session_id=2), tmp_path / "b.mcap", tmp_path).close()
    assert list_recordings([tmp_path]) == []


def test_a_file_that_was_begun_behind_the_last_word_of_a_killed_one_waits_too(tmp_path):
    """As where the process dies between the change of the file and its word of it; another recording's file is not its own."""
    path = tmp_path / "relay.00009.mcap"
    running = RunningRecording(relay_session(session_id=7), path, tmp_path)
    (entry,) = tmp_path.glob(f"*{SUFFIX}")
    (tmp_path / f"killed{SUFFIX}").write_text(entry.read_text())
    running.close()
    for number, session_id in ((8, 7), (10, 6), (11, 7)):
        later = tmp_path / f"relay.{number:05}.mcap"
        TraceSink(TraceDestination(later), relay_session(session_id=session_id)).close()
        ring_path(later).touch()
    (listed,) = list_recordings([tmp_path])
    assert (listed.state, listed.waiting) == (State.KILLED, tmp_path / "relay.00011.mcap")
    ring_path(path).touch()
    assert [each.waiting for each in list_recordings([tmp_path])] == [path]


def test_an_entry_is_believed_only_with_its_lock_and_its_process(tmp_path):
    running = RunningRecording(relay_session(), tmp_path / "relay.mcap", tmp_path)
    (path,) = tmp_path.glob(f"*{SUFFIX}")
    told = json.loads(path.read_text())
    copy = tmp_path / f"copy{SUFFIX}"
    copy.write_text(json.dumps(told))  # says the same, and nobody holds it
    states = {each.name: each for each in (path, copy)}
    assert len(states) == 2
    assert sorted(each.state.value for each in list_recordings([tmp_path])) == ["killed", "running"]
    with copy.open("r+") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        copy.write_text(json.dumps(told | {"pid_start": told["pid_start"] - 1}))  # an earlier process of this id
        assert sorted(each.state.value for each in list_recordings([tmp_path])) == ["running", "unseen"]
    for damage in ("", "{", "[]", "null", '{"role": 1}', "\0" * 9000):
        copy.write_text(damage)
        assert len(list_recordings([tmp_path])) == 1
    copy.unlink()
    copy.symlink_to(path)
    os.mkfifo(tmp_path / f"pipe{SUFFIX}")
    assert len(list_recordings([tmp_path])) == 1
    running.close()


def test_the_folder_is_the_services_else_the_users_else_a_temporary_one_of_its_own():
    both = {"RUNTIME_DIRECTORY": "/run/dds-trace/10:/run/b", "XDG_RUNTIME_DIR": "/run/user/7"}
    assert str(runtime_folder(both)) == "/run/dds-trace/10"
    assert str(runtime_folder({"XDG_RUNTIME_DIR": "/run/user/7"})) == "/run/user/7/dds-trace"
    assert runtime_folder({}).name == f"dds-trace-{os.getuid()}"


@pytest.mark.parametrize("kind", ["a link", "everybody's", "a file", "gone"])
def test_a_folder_that_is_not_ours_alone_gets_no_entry_and_recording_goes_on(tmp_path, kind):
    folder = tmp_path / "run"
    if kind == "a link":
        (tmp_path / "elsewhere").mkdir()
        folder.symlink_to(tmp_path / "elsewhere")
    elif kind == "everybody's":
        folder.mkdir()
        folder.chmod(0o777)
    elif kind == "a file":
        folder.touch()
    else:
        folder = tmp_path / "no" / "run"
    running = RunningRecording(relay_session(), tmp_path / "relay.mcap", folder)
    running.update(path=tmp_path, messages=1, files=1, stopped=None)
    assert list_recordings([folder, tmp_path / "elsewhere"]) == []
    running.close()


def test_the_time_of_a_word_moves_on(tmp_path):
    running = RunningRecording(relay_session(), tmp_path / "relay.mcap", tmp_path)
    began = list_recordings([tmp_path])[0].entry
    time.sleep(0.001)
    running.update(path=tmp_path / "relay.mcap", messages=0, files=1, stopped=None)
    later = list_recordings([tmp_path])[0].entry
    assert (later.began_ns, later.told_ns > began.told_ns) == (began.began_ns, True)
    running.close()
