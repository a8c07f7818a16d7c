import configparser
import fnmatch
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from dds_trace import analyze
from dds_trace.base.errors import BackendUnavailableError, OptionError
from dds_trace.base.version import __version__
from dds_trace.extensions.service.running import list_recordings
from dds_trace.tracefile.reading.reader import read_trace

UNIT = Path(__file__).parents[2] / "systemd/dds-trace-relay@.service"


@pytest.fixture
def service():
    parser = configparser.RawConfigParser(delimiters=("=",), comment_prefixes=("#",))
    parser.optionxform = str
    parser.read(UNIT)
    return parser["Service"]


def as_run(command, instance):
    """The words of a command line with specifiers and dollars as systemd.service(5) has them."""
    kept = command.replace("%%", "\0").replace("%i", instance).replace("\0", "%").replace("$$", "$")
    return shlex.split(kept)


def test_only_what_another_start_may_mend_is_started_again(service):
    assert service["Restart"] == "on-failure"
    assert set(map(int, service["RestartPreventExitStatus"].split())) == {
        OptionError.exit_code,
        BackendUnavailableError.exit_code,
    }


@pytest.mark.middleware
def test_its_command_serves_the_domain_of_the_instance_until_sigterm_and_closes_the_trace(service, domain_id, tmp_path):
    setup = tmp_path / "setup.bash"
    setup.write_text("export RELAY_OPTIONS='--backend socket --discovery localhost'\n")
    environment = os.environ | {
        "ROS_SETUP": str(setup),
        "DDS_RECORD": str(Path(sys.executable).with_name("dds-record")),
        "STATE_DIRECTORY": str(tmp_path),
        "RUNTIME_DIRECTORY": str(tmp_path / "run"),
        "NOTIFY_SOCKET": str(tmp_path / "notify"),
        "WATCHDOG_USEC": f"{service['WatchdogSec']}000000",
    }
    manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    manager.bind(environment["NOTIFY_SOCKET"])
    manager.settimeout(60)
    relay = subprocess.Popen(
        as_run(service["ExecStart"], str(domain_id)), env=environment, stderr=subprocess.PIPE, text=True
    )
    try:
        said = next((line for line in relay.stderr if "serves domain" in line), "")
        assert f"serves domain {domain_id}" in said
        words = manager.recv(4096).decode().splitlines()
        assert [each.entry.domain_id for each in list_recordings([tmp_path / "run"])] == [domain_id]
        relay.send_signal(signal.SIGTERM)
        relay.communicate(timeout=60)
    finally:
        relay.kill()
        relay.communicate()
        manager.close()
    assert relay.returncode == 0
    (trace,) = tmp_path.glob("*.mcap")
    assert trace.name == f"relay-{domain_id}.00001.mcap"
    assert words[:2] == ["READY=1", "WATCHDOG=1"]
    assert service["Type"] == "notify"
    (session,) = {each.session_id: each for each in read_trace(trace).sessions}.values()
    assert (session.role, session.state, session.domain_id) == ("relay", "closed", domain_id)


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
    assert analysis.summary["published"].to_list() == [100]
    assert analysis.summary["received"][0] > 50  # of the file's depth of 10, a process that stands still loses some
    assert analysis.summary["bridge"].to_list() == ["builtin"]


def test_the_changelog_begins_with_this_version_and_has_a_heading_for_each_line():
    text = (UNIT.parents[1] / "CHANGELOG.md").read_text(encoding="utf-8")
    latest = text.split("\n## ")[1]
    assert latest.startswith(f"{__version__} ")
    introduction, *groups = latest.split("\n### ")
    assert "\n- " not in introduction
    assert len(groups) > 5
    for group in groups:
        assert re.search(r"\n- \S", group), group
