import pytest
from middlewares import needs
from processes import own_port, ping, relay, running
from record_reader import last_json

pytest.importorskip("rclpy", reason="no ROS 2 here")
pytestmark = pytest.mark.middleware

DATA = ("--data", "imu", "--messages", 10, "--warmup", 0, "--rate", 50, "--depth", 1000)


def test_a_bridge_that_runs_already_is_left_alone(domains, tmp_path):
    near, far, out = domains.take(), domains.take(), tmp_path / "ping.mcap"
    with (
        relay(far, tmp_path / "relay.mcap", "--depth", 1000),
        running("dds-trace", "bridge", "builtin", "--from", near, "--to", far, "--depth", 1000) as bridge,
    ):
        bridge.wait_for_line("builtin runs")
        done = ping(near, out, "--bridge", "builtin", "--bridge-running", "--relay-domain", far, *DATA)
        assert done.status == 0, done.stderr
        assert bridge.stop().status == 0
    run = last_json(out, "run")
    assert (run["bridge"], run["bridge_running"], run["relay_domain_id"]) == ("builtin", True, far)
    assert run["published"] == 10
    assert "bridge" not in last_json(out, "session")


def test_nodes_without_ros_discovery_info_are_refused_a_bridge_that_needs_it(domain_id, tmp_path):
    done = ping(
        *(domain_id, tmp_path / "ping.mcap", "--backend", "socket", *DATA),
        *("--bridge", "zenoh-bridge-ros2dds", "--relay-domain", domain_id + 1),
    )
    assert done.status == 2
    assert "ros_discovery_info" in done.stderr
    assert "backend socket" in done.stderr
    assert not (tmp_path / "ping.mcap").exists()


@needs("zenoh")
def test_each_device_has_its_half(domains, tmp_path):
    near, far, out = domains.take(), domains.take(), tmp_path / "ping.mcap"
    address, name = f"127.0.0.1:{own_port(near)}", "builtin-zenoh"
    # Both ends of every bridged topic must offer the deadline that the other side requests.
    durations = ("--deadline", "2s", "--lifespan", "3s")
    with (
        relay(far, tmp_path / "relay.mcap", "--depth", 1000, *durations),
        running(
            *("dds-trace", "bridge", name, "--from", near, "--to", far, "--depth", 1000, *durations),
            *("--half", "relay", "--listen", address),
        ) as bridge,
    ):
        bridge.wait_for_line("builtin-zenoh runs")
        halves = ("--bridge", name, "--bridge-peer", address, "--relay-domain", far)
        done = ping(near, out, *halves, *DATA, *durations)
        assert done.status == 0, done.stderr
        assert bridge.stop().status == 0
    described = last_json(out, "session")["bridge"]
    assert described["state"] == "stopped"
    assert [program["half"] for program in described["programs"]] == ["ping"]
    assert last_json(out, "run")["published"] == 10


def test_a_bridge_that_runs_already_carries_a_further_type(domains, tmp_path):
    pytest.importorskip("rosbags", reason="rosbags is not installed")
    from bags import points, write_bag2

    near, far, out = domains.take(), domains.take(), tmp_path / "ping.mcap"
    bag, points_type = write_bag2(tmp_path / "bag", {"/points": [points(7)]}), "sensor_msgs/msg/PointCloud2"
    with (
        relay(far, tmp_path / "relay.mcap", "--type", points_type, "--depth", 1000),
        running(
            *("dds-trace", "bridge", "builtin", "--from", near, "--to", far, "--depth", 1000),
            *("--topic", f"data_sensor_msgs_PointCloud2:{points_type}"),
        ) as bridge,
    ):
        bridge.wait_for_line("builtin runs")
        done = ping(
            *(near, out, "--data", f"bag:{bag}#/points", "--messages", 5, "--rate", 50, "--depth", 1000),
            *("--bridge", "builtin", "--bridge-running", "--relay-domain", far),
        )
        assert done.status == 0, done.stderr
    assert last_json(out, "run")["published"] == 15  # warm-up included
