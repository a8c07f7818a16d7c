from __future__ import annotations

import os
import subprocess
import sys

import pytest

from dds_trace.recorder.sweep.station.programs import environment_program
from dds_trace.tracefile import OptionError

GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"


@pytest.fixture
def environment(tmp_path):
    """Another Python environment whose dds-record prints the variables that the ROS 2 wheels set."""
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
