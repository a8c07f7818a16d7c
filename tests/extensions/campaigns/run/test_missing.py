from dds_trace.extensions.campaigns.plan.plan_file import parse_plan
from dds_trace.extensions.campaigns.run.runner import middlewares_of, missing_middlewares
from dds_trace.extensions.campaigns.station.devices import RelayDevice
from dds_trace.recorder.backends import load_backend

PLAN = """
[run]
messages = 10
[devices.relay]
ssh = "robot@robot"
[axes]
backend = "socket"
relay_backend = ["socket", "zenoh"]
size = [100, 200]
rate = [10, 20]
"""


class Robot(RelayDevice):
    def __init__(self):
        self.asked = []

    def rehearse(self, arguments):
        self.asked.append(arguments)
        return "robot: zenoh is not installed" if "zenoh" in arguments else None


def test_a_remote_device_is_asked_once_for_each_middleware():
    plan, robot = parse_plan(PLAN, "x", "x", list), Robot()
    found = missing_middlewares(plan, robot)
    without = [cell for cell in plan.cells if middlewares_of(cell) in found]
    assert len(plan.cells) == 8
    assert {cell.relay_backend for cell in without} == {"zenoh"}
    assert len(without) == 4
    assert set(found.values()) == {"robot: zenoh is not installed"}
    assert len(robot.asked) == 2
    assert all(arguments[:2] == ["--role", "relay"] for arguments in robot.asked)


def test_the_software_of_another_environment_is_unknown(tmp_path):
    plan = parse_plan(f'[axes]\nenvironment = "{tmp_path}"\nrmw = "rmw_of_somebody_cpp"\n', "x", "x", list)
    (reason,) = missing_middlewares(plan, Robot()).values()
    assert reason.startswith(f"{tmp_path} has no bin/dds-record")
    program = tmp_path / "bin" / "dds-record"
    program.parent.mkdir()
    program.touch(0o755)
    assert missing_middlewares(plan, Robot()) == {}


def test_an_installed_ros_middleware_is_not_missing(tmp_path, monkeypatch):
    from dds_trace.recorder.backends.ros2 import installation

    asked = load_backend("ros2").missing_rmw
    monkeypatch.setattr(installation, "has_package", lambda _: True)
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    assert asked("rmw_fastrtps_cpp") is None, "of the wheels"
    assert "ros-$ROS_DISTRO-rmw-cyclonedds-cpp" in asked("rmw_cyclonedds_cpp")
    index = tmp_path / installation.RMW_INDEX
    index.mkdir(parents=True)
    (index / "rmw_cyclonedds_cpp").touch()
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    assert asked("rmw_cyclonedds_cpp") is None
    assert asked("rmw_fastrtps_cpp")
