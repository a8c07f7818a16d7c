"""ROS 2's packaging in `ros2/`: it says what pyproject.toml says, holds what the wheel holds, and its launch file starts both roles.

setuptools and launch are stand-ins: neither is among what the tests install.
"""

import re
import runpy
import signal
import subprocess
import sys
import types
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from processes import RunningCommand

from dds_trace import __version__
from dds_trace.tracefile.reading.reader import read_trace

ROOT = Path(__file__).parents[2]
ROS2 = ROOT / "ros2"
ROOMS = ("src/dds_trace/base", "analyzer", "cli", "extensions", "recorder", "reports", "tracefile")


@pytest.fixture
def project():
    toml = pytest.importorskip("tomllib" if sys.version_info >= (3, 11) else "tomli")
    return toml.loads((ROOT / "pyproject.toml").read_text())["project"]


@pytest.fixture
def told(monkeypatch):
    arguments = {}
    setuptools = types.ModuleType("setuptools")
    setuptools.setup = arguments.update
    monkeypatch.setitem(sys.modules, "setuptools", setuptools)
    runpy.run_path(str(ROS2 / "setup.py"))
    return arguments


def test_every_file_that_names_the_version_names_this_one(told):
    citation = re.search(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert re.search(r"^date-released: \d{4}-\d\d-\d\d\b", (ROOT / "CITATION.cff").read_text(), re.MULTILINE), "a year"
    manifest = ET.parse(ROS2 / "package.xml").getroot()
    assert [told["version"], citation[1], manifest.findtext("version")] == [__version__] * 3


def test_the_manifest_is_that_of_an_ament_python_package(told, project):
    manifest = ET.parse(ROS2 / "package.xml").getroot()
    assert (manifest.tag, manifest.get("format")) == ("package", "3")
    assert manifest.findtext("name") == told["name"] == "dds_trace"
    assert manifest.findtext("export/build_type") == "ament_python"
    assert manifest.findtext("license") == told["license"] == project["license"]
    assert manifest.findtext("description") == told["description"] == project["description"]


def test_its_executables_are_the_commands_of_the_project(told, project):
    scripts = [text.split(" = ") for text in told["entry_points"]["console_scripts"]]
    assert {f"dds-{name}": target for name, target in scripts} == project["scripts"]


def test_its_requirements_are_the_dependencies_of_the_project(project):
    lines = [line for line in (ROS2 / "requirements.txt").read_text().splitlines() if line[:1] != "#"]
    assert lines == project["dependencies"]


def test_it_holds_every_file_that_the_wheel_holds(told):
    ((top, path),) = told["package_dir"].items()
    held = set()
    for package in told["packages"]:
        folder = (ROS2 / path).joinpath(*package.split(".")[1:])
        names = [
            *folder.glob("*.py"),
            *(n for glob in told["package_data"].get(package, ()) for n in folder.glob(glob)),
        ]
        held |= {f"{package.replace('.', '/')}/{name.relative_to(folder)}" for name in names}
    listed = ["git", "ls-files", "--cached", "--others", "--exclude-standard", *ROOMS]
    ours = subprocess.run(listed, cwd=ROOT, check=True, capture_output=True, text=True).stdout.split()
    assert held == {
        f"{top}/{name.removeprefix('src/dds_trace/')}" for name in [*ours, "__init__.py", "__main__.py", "py.typed"]
    }


def test_the_files_of_its_share_are_there(told):
    files = [name for _, names in told["data_files"] for name in names]
    assert "resource/dds_trace" in files  # the marker by which ROS 2 finds the package
    assert [name for name in files if not (ROS2 / name).is_file()] == []


class Entity:
    def __init__(self, *args, **kwargs):
        self.args, self.kwargs = args, kwargs

    def perform(self, context):
        return context[self.args[0]]


@pytest.fixture
def launched(monkeypatch):
    classes = {
        "launch": ["LaunchDescription"],
        "launch.actions": [
            "DeclareLaunchArgument",
            "EmitEvent",
            "ExecuteProcess",
            "OpaqueFunction",
            "RegisterEventHandler",
        ],
        "launch.event_handlers": ["OnProcessExit"],
        "launch.events": ["Shutdown"],
        "launch.substitutions": ["LaunchConfiguration"],
        "launch_ros": [],
        "launch_ros.substitutions": ["ExecutableInPackage"],
    }
    for name, members in classes.items():
        module = types.ModuleType(name)
        for member in members:
            setattr(module, member, type(member, (Entity,), {}))
        monkeypatch.setitem(sys.modules, name, module)
    described = runpy.run_path(str(ROS2 / "launch/ping_relay.launch.py"))["generate_launch_description"]()
    *declared, opaque = described.args[0]

    def actions(**given):
        defaults = {argument.args[0]: argument.kwargs["default_value"] for argument in declared}
        assert set(given) <= set(defaults)
        return opaque.kwargs["function"](defaults | given)

    return actions


def test_an_argument_that_is_not_given_is_left_to_the_command(launched):
    relay, ping, _ = launched()
    assert relay.kwargs["cmd"][1:] == ["--role", "relay", "--out", "runs/launch/relay.mcap"]
    assert ping.kwargs["cmd"][1:] == ["--role", "ping", "--out", "runs/launch/ping.mcap"]
    for process in (relay, ping):
        assert process.kwargs["cmd"][0].kwargs == {"executable": "record", "package": "dds_trace"}


def test_one_role_alone_is_started_and_a_launch_ends_with_its_ping(launched):
    (relay,) = launched(role="relay", size="33KB")
    assert "--size" not in relay.kwargs["cmd"]  # of the ping
    ping, ended = launched(role="ping", size="33KB")
    assert ping.kwargs["cmd"][-2:] == ["--size", "33KB"]
    (handler,) = ended.args
    assert handler.kwargs["target_action"] is ping
    with pytest.raises(ValueError, match="role:=pong"):
        launched(role="pong")


@pytest.mark.middleware
def test_its_commands_record_a_ping_and_a_relay(launched, domain_id, tmp_path):
    given = {"out": str(tmp_path), "domain": str(domain_id), "discovery": "localhost", "rate": "200", "messages": "20"}
    relay, ping, _ = (
        action.kwargs.get("cmd", [])[1:]
        for action in launched(**given, ping_options="--backend socket --warmup 2", relay_options="--backend socket")
    )
    serving = RunningCommand("dds-record", *relay)
    try:
        serving.wait_for_line("serves domain")
        done = RunningCommand("dds-record", *ping).finish()
        assert done.status == 0, done.stderr
        assert serving.stop(signal.SIGINT).status == 0  # what launch sends when it shuts down
    finally:
        serving.clean_up()
    for role in ("ping", "relay"):
        assert read_trace(tmp_path / f"{role}.mcap").sessions[-1].state == "closed"
