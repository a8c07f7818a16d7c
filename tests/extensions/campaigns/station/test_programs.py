import os
import subprocess
import sys

import pytest
from waiting import wait_until

from dds_trace.base.errors import BackendUnavailableError, OptionError
from dds_trace.extensions.campaigns.plan.link import PRESETS, Link
from dds_trace.extensions.campaigns.station.emulation import queue_disciplines
from dds_trace.extensions.campaigns.station.programs import Program, environment_program

GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"


@pytest.fixture
def environment(tmp_path):
    program = tmp_path / "bin" / "dds-record"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\necho "${{{GUARD}-unset}} ${{LD_LIBRARY_PATH-unset}} $1"\n')
    program.chmod(0o755)
    return tmp_path


def said(command):
    return subprocess.run([*command, "--version"], capture_output=True, text=True, check=True).stdout


def test_other_environment_does_not_get_the_library_path_of_our_ros_wheels(environment, monkeypatch):
    monkeypatch.setenv(GUARD, "1")
    monkeypatch.setenv("LD_LIBRARY_PATH", os.pathsep.join([f"{sys.prefix}/lib", "/opt/own"]))
    assert said(environment_program(environment, "dds-record")) == "unset /opt/own --version\n"
    monkeypatch.setenv("LD_LIBRARY_PATH", f"{sys.prefix}/lib")
    assert said(environment_program(environment, "dds-record")) == "unset unset --version\n"


def test_library_path_of_the_users_is_left_alone(environment, monkeypatch):
    monkeypatch.delenv(GUARD, raising=False)
    monkeypatch.setenv("LD_LIBRARY_PATH", "/opt/own")
    assert said(environment_program(environment, "dds-record")) == "unset /opt/own --version\n"


def test_folder_without_the_command_is_refused(tmp_path):
    with pytest.raises(OptionError, match="no bin/dds-record; install dds-trace there"):
        environment_program(tmp_path, "dds-record")


@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("echo first line; kill -9 $$", "killed by signal 9 (SIGKILL)"),
        ("echo first line; kill -6 $$", "killed by signal 6 (SIGABRT): first line"),
        ("echo 'dds-record: no echo'; exit 8", "no echo"),
        ("exit 3", "it said nothing"),
        ("echo starting; echo 'dds-record: no echo'; echo '  saw: nobody'; echo", "no echo; saw: nobody"),
        (f"{sys.executable} -c \"raise ValueError('x')\"", "ValueError: x"),
    ],
)
def test_end_of_a_program_in_words(tmp_path, script, words):
    program = Program(["sh", "-c", script], tmp_path / "log")
    assert program.wait(60) is not None
    assert program.failure == program.last_words() == words


def test_program_that_ignores_sigterm_is_killed(tmp_path):
    program = Program(["sh", "-c", "trap '' TERM; echo deaf; while :; do sleep 0.1; done"], tmp_path / "log")
    wait_until(program.log.read_text)
    assert program.stop(patience_s=0.1) == -9


def test_missing_program_is_a_clear_error(tmp_path):
    with pytest.raises(BackendUnavailableError, match="dds-nothing is not installed"):
        Program(["dds-nothing"], tmp_path / "log")


def test_token_bucket_saves_up_as_little_as_timers_allow():
    slow, fast = Link(rate_mbit_s=54), Link(rate_mbit_s=1000, queue_ms=20)
    words = "root handle 1: tbf rate {} burst {} latency {}"
    for link, shown in (
        (slow, ("54mbit", "3028b", "100ms")),
        (fast, ("1000mbit", "25000b", "20ms")),  # 0.2 ms of 1 Gbit/s are 25,000 bytes
    ):
        assert queue_disciplines(link, kernel_does_all=True) == [words.format(*shown).split()]


def test_netem_is_below_the_token_bucket_if_there_is_one():
    link = Link(rate_mbit_s=54, delay_ms=1, jitter_ms=0.5, loss_percent=0.1)
    netem = "handle 10: netem delay 1ms 0.5ms distribution normal loss 0.1% limit 50000"
    assert queue_disciplines(link, kernel_does_all=True)[1] == ["parent", "1:1", *netem.split()]
    delay = Link(delay_ms=1, jitter_ms=0.5, loss_percent=0.1)
    assert queue_disciplines(delay, kernel_does_all=True) == [["root", *netem.split()]]


@pytest.mark.parametrize("link", PRESETS.values(), ids=str)
def test_forwarder_leaves_only_the_rate_to_the_kernel(link):
    assert len(queue_disciplines(link, kernel_does_all=False)) == 1
