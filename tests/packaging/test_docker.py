from __future__ import annotations

import fnmatch
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from dds_trace import analyze

TOP = Path(__file__).parents[2]
DOCKER = TOP / "docker"
COMPOSE = yaml.safe_load((DOCKER / "compose.yaml").read_text())
DATA = "/data/"


def test_everything_that_the_image_is_built_from_is_there_and_nothing_recorded_is():
    lines = (DOCKER / "Dockerfile.dockerignore").read_text().splitlines()
    assert next(line for line in lines if not line.startswith("#")) == "*"
    let_in = [line.removeprefix("!") for line in lines if line.startswith("!")]
    assert all((TOP / each).exists() for each in let_in)
    assert not fnmatch.filter(let_in, "*run*") + fnmatch.filter(let_in, "*sample*")
    # The wheel's own list of files, which hatchling takes from pyproject.toml.
    assert {"analyzer", "cli", "recorder", "reports", "tracefile", "src"} <= set(let_in)


def test_nobody_is_root():
    said = [line.split()[1] for line in (DOCKER / "Dockerfile").read_text().splitlines() if line.startswith("USER")]
    assert said
    assert said[-1] not in {"root", "0"}
    assert all("user" in service for service in COMPOSE["services"].values())


def test_all_containers_share_one_network_and_one_shared_memory():
    shared = {name: (each.get("network_mode"), each["ipc"]) for name, each in COMPOSE["services"].items()}
    assert shared.pop("relay") == (None, "shareable")
    assert set(shared.values()) == {("service:relay", "service:relay")}


@pytest.fixture
def start(tmp_path):
    """Start a command of the compose file as a process of this machine."""
    running = []

    def started(name, domains):
        words = [str(each).replace(DATA, f"{tmp_path}/") for each in COMPOSE["services"][name]["command"]]
        command = [domains.get(word, word) for word in words]
        process = subprocess.Popen(
            [Path(sys.executable).with_name(command[0]), *command[1:]],
            env={**os.environ, **COMPOSE["services"][name]["environment"]},
            stderr=subprocess.PIPE,
            text=True,
        )
        running.append(process)
        return process

    yield started
    for process in running:
        process.kill()
        process.communicate()


@pytest.mark.middleware
def test_the_commands_of_the_compose_file_cross_two_domains(start, domains, tmp_path):
    pytest.importorskip("rclpy")
    own = {"5": str(domains.take()), "10": str(domains.take())}
    relay, bridge, ping = (start(name, own) for name in ("relay", "bridge", "ping"))
    said = ping.communicate(timeout=150)[1]
    assert ping.returncode == 0, said
    for process in (bridge, relay):
        process.send_signal(signal.SIGINT)  # the Dockerfile's STOPSIGNAL
        process.communicate(timeout=60)
    assert relay.returncode == 0
    analysis = analyze(tmp_path)
    assert analysis.summary["received"].to_list() == [100]
    assert analysis.summary["bridge"].to_list() == ["builtin"]
