import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import PATIENCE_S

from dds_trace.extensions.bridges import BRIDGE_MODULES
from dds_trace.extensions.bridges.command import installed

BRIDGE = [sys.executable, "-m", "dds_trace", "bridge"]


def run(*arguments, **environment):
    variables = {**os.environ, "PATH": "/nowhere", "XDG_DATA_HOME": "/nowhere", **environment}
    for name in ("NDDSHOME", "AMENT_PREFIX_PATH"):
        variables.pop(name, None)
    return subprocess.run([*BRIDGE, *arguments], env=variables, capture_output=True, text=True, check=False)


def test_doctor_lists_the_bridges_and_how_to_get_the_others(monkeypatch):
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.setenv("XDG_DATA_HOME", "/nowhere")
    for name in ("NDDSHOME", "AMENT_PREFIX_PATH"):
        monkeypatch.delenv(name, raising=False)
    checks = {name: (works, detail) for _, name, works, detail in installed()}
    assert list(checks) == list(BRIDGE_MODULES)
    assert not any(checks[name][0] for name in ("zenoh-bridge-dds", "ddsrouter", "routing-service", "domain_bridge"))
    assert "just install-zenoh-bridge" in checks["zenoh-bridge-dds"][1]
    assert "apt install ros-$ROS_DISTRO-domain-bridge" in checks["domain_bridge"][1]
    assert checks["domain_bridge"][1].endswith("(tried: never run)")
    assert "(tried: 3.2.0 " in checks["ddsrouter"][1]


def test_a_missing_program_is_one_line_with_its_name_and_how_to_get_it():
    ran = run("ddsrouter")
    assert ran.returncode == 7
    assert ran.stdout == ""
    (line,) = ran.stderr.splitlines()
    assert "the bridge ddsrouter is not installed; " in line
    assert "https://eprosima-dds-router.readthedocs.io" in line


def test_check_looks_for_the_program_and_runs_nothing():
    ran = run("ddsrouter", "--check")
    assert (ran.returncode, ran.stdout) == (7, "")
    assert "the bridge ddsrouter is not installed; " in ran.stderr
    assert run("zenoh-bridge-dds", "--half", "relay", "--check").returncode != 0
    here = run("builtin", "--check")
    if here.returncode == 0:  # rclpy is here
        assert here.stdout.startswith("builtin can run: ")


def test_an_unknown_bridge_names_the_known_ones():
    ran = run("zenoh")
    assert ran.returncode == 2
    assert f" 'zenoh'; choose one of {', '.join(BRIDGE_MODULES)}" in ran.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("builtin", "--from", "5", "--to", "5"), "a bridge joins two domains"),
        (("builtin", "--to", "233"), "there is no domain 233"),
        (("builtin", "--peer", "pi1:7447"), "has no halves"),
        (("builtin-zenoh", "--half", "relay"), "would never meet the other one"),
        (("builtin-zenoh", "--peer", "pi1"), "write HOST:PORT"),
    ],
)
def test_wrong_value_is_one_line(arguments, said):
    ran = run(*arguments)
    assert ran.returncode == 2
    assert said in ran.stderr
    assert len(ran.stderr.splitlines()) == 1


def test_print_config_is_the_text_alone_on_stdout():
    ran = run("domain_bridge", "--from", "3", "--to", "4", "--depth", "2", "--config")
    assert ran.returncode == 0
    assert ran.stderr == ""
    assert ran.stdout.startswith("name: dds_trace_bridge\ntopics:\n  binary_image:\n")
    assert "from_domain: 3\n    to_domain: 4\n" in ran.stdout
    assert "depth: 2\n" in ran.stdout


def test_print_config_of_both_halves_says_on_stderr_which_is_which():
    ran = run("zenoh-bridge-dds", "--config")
    assert ran.stderr.splitlines() == ["# the ping's half, domain 5", "# the relay's half, domain 10"]
    text, halves = ran.stdout, []
    while text.strip():
        half, end = json.JSONDecoder().raw_decode(text)
        halves.append(half["plugins"]["dds"]["domain"])
        text = text[end:].lstrip()
    assert halves == [5, 10]


def test_print_config_of_one_half():
    ran = run("zenoh-bridge-dds", "--half", "relay", "--peer", "pi1:7447", "--peer", "pi2:7447", "--config")
    assert ran.stderr == ""
    half = json.loads(ran.stdout)
    assert half["plugins"]["dds"]["domain"] == 10
    assert half["connect"]["endpoints"] == ["tcp/pi1:7447", "tcp/pi2:7447"]


@pytest.mark.keeps(2)
@pytest.mark.middleware
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_bridge_runs_until_a_signal_and_leaves_no_process(number, domains, tmp_path):
    import psutil

    arguments = ["builtin", "--from", str(domains.take()), "--to", str(domains.take()), "--discovery", "localhost"]
    with subprocess.Popen(
        [*BRIDGE, *arguments], stderr=subprocess.PIPE, text=True, env={**os.environ, "TMPDIR": str(tmp_path)}
    ) as process:
        line = process.stderr.readline()
        assert line.startswith("builtin runs: domain "), line
        assert line.endswith("Ctrl-C ends it\n")
        children = psutil.Process(process.pid).children(recursive=True)
        assert len(children) == 2  # the guard and the bridge
        process.send_signal(number)
        assert process.wait(PATIENCE_S) == 0
    assert not any(child.is_running() for child in children)
    assert not list(Path(tmp_path).glob("dds-trace-bridge-*"))


@pytest.mark.middleware
def test_a_bridge_that_dies_ends_the_command_with_the_tail_of_its_log(domains):
    import psutil

    arguments = ["builtin", "--from", str(domains.take()), "--to", str(domains.take()), "--discovery", "localhost"]
    with subprocess.Popen([*BRIDGE, *arguments], stderr=subprocess.PIPE, text=True) as process:
        process.stderr.readline()
        guard, bridge = psutil.Process(process.pid).children(recursive=True)
        bridge.kill()
        said = process.stderr.read()
        assert process.wait(PATIENCE_S) == 9
    assert "killed by signal 9 (SIGKILL)" in said
    assert "bridging domains" in said
    assert not guard.is_running()
