"""Integration Service's two modes: what is configured, and what its program, or a stand-in for it, makes of that."""

import os
import subprocess
import sys

import pytest
from processes import executed
from ruamel.yaml import YAML
from stand_in_integration_service import install
from waiting import wait_until

from dds_trace.extensions.bridges import integration_service
from dds_trace.extensions.bridges.base import BridgedTopic, BridgeOptions, load_bridge
from dds_trace.extensions.bridges.running import open_bridge
from dds_trace.tracefile.format.descriptions import Qos

POINTS = BridgedTopic("points", "sensor_msgs/msg/PointCloud2")


@pytest.fixture
def installed(tmp_path, monkeypatch):
    for variable in integration_service.PREFIX_VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(integration_service, "SYSTEM_PREFIXES", ())

    def with_handles(*handles):
        prefix = tmp_path / "prefix"
        monkeypatch.setenv("PATH", str(install(prefix, *handles)), prepend=os.pathsep)
        monkeypatch.setenv("IS_PREFIX_PATH", str(prefix / "lib"))
        return prefix

    return with_handles


def configuration(**options):
    return YAML(typ="safe").load(load_bridge("integration-service").configuration(BridgeOptions(**options)))


def test_the_dynamic_handle_gets_its_types_by_name(installed):
    installed("ros2_dynamic")
    found = configuration()
    using = ["sensor_msgs/Image", "sensor_msgs/Imu", "std_msgs/String"]
    assert found["systems"] == {
        f"domain_{number}": {
            "type": "ros2_dynamic",
            "domain": number,
            "node_name": f"dds_trace_bridge_{number}",
            "using": using,
        }
        for number in (5, 10)
    }
    assert {name: topic["type"] for name, topic in found["topics"].items() if not name.endswith("_relay")} == {
        "binary_image": "sensor_msgs::msg::Image",
        "string_data": "std_msgs::msg::String",
        "imu_data": "sensor_msgs::msg::Imu",
    }
    further = configuration(topics=(POINTS,))
    assert further["systems"]["domain_5"]["using"] == ["sensor_msgs/PointCloud2"]
    assert further["topics"]["points_relay"]["type"] == "sensor_msgs::msg::PointCloud2"


@pytest.mark.parametrize("handles", [(), ("ros2",), ("ros2", "ros2_dynamic")])
def test_the_static_handle_is_taken_where_it_is_installed_or_none_is(installed, handles):
    installed(*handles)
    found = configuration()
    assert [system["type"] for system in found["systems"].values()] == ["ros2", "ros2"]
    assert all("using" not in system for system in found["systems"].values())
    assert found["topics"]["imu_data"]["type"] == "sensor_msgs/Imu"


@pytest.mark.parametrize("variable", integration_service.PREFIX_VARIABLES)
def test_a_handle_is_found_where_the_program_looks_for_it(installed, monkeypatch, tmp_path, variable):
    installed()
    install(tmp_path / "elsewhere", "ros2_dynamic")
    monkeypatch.setenv(variable, f"/nowhere{os.pathsep}{tmp_path / 'elsewhere' / 'lib'}")
    assert configuration()["systems"]["domain_5"]["type"] == "ros2_dynamic"
    monkeypatch.setenv(variable, "/nowhere")
    assert configuration()["systems"]["domain_5"]["type"] == "ros2"
    monkeypatch.setattr(integration_service, "SYSTEM_PREFIXES", (str(tmp_path / "elsewhere" / "lib"),))
    assert configuration()["systems"]["domain_5"]["type"] == "ros2_dynamic"


@pytest.mark.parametrize(("history", "expected"), [("keep_all", {}), ("keep_last", {"depth": 7})])
def test_keep_all_has_no_depth(installed, history, expected):
    installed("ros2_dynamic")
    qos = configuration(qos=Qos(history=history, depth=7))["topics"]["imu_data"]["domain_5"]["qos"]
    assert qos["history"] == {"kind": history.upper(), **expected}


@pytest.mark.parametrize("handle", ["ros2", "ros2_dynamic"])
def test_the_program_serves_with_either_handle_and_its_log_has_no_colours(installed, handle):
    installed(handle)
    with open_bridge("integration-service", BridgeOptions(topics=(POINTS,))) as bridge:
        wait_until(lambda: "serves" in bridge.log_tail())
        assert bridge.log_tail() == "[Integration Service][INFO] [is::core::Config] serves"
        bridge.check()
    (program,) = bridge.describe()["programs"]
    assert program["exit_code"] == 0
    assert "\x1b" not in program["log_tail"]


def test_a_program_without_any_handle_ends_with_exit_code_9_and_its_own_line(installed):
    installed()
    done = executed([sys.executable, "-m", "dds_trace", "bridge", "integration-service"])
    assert done.returncode == 9
    assert "\x1b" not in done.stderr
    assert "ended with status 1" in done.stderr
    assert "Failed to load middlewares!" in done.stderr.splitlines()[-1]


def test_the_stand_in_dies_as_the_real_program_does_of_a_type_in_the_other_spelling(installed):
    prefix = installed("ros2_dynamic")
    bridge = load_bridge("integration-service")
    text = bridge.configuration(BridgeOptions()).replace("::msg::", "/")
    (prefix / "wrong.yaml").write_text(text)
    done = subprocess.run([bridge.find(), prefix / "wrong.yaml"], check=False)
    assert done.returncode == -11
