import os
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest
from backend_pairs import ROOMY
from processes import PATIENCE_S, counts_in, ping, relay
from record_reader import events_of, last_json
from warm_start import BRIEF_FLOOR_MESSAGES

pytest.importorskip("rclpy", reason="no ROS 2 here")
pytest.importorskip("rosbags", reason="rosbags is not installed")

from bags import ROS1, image, imu, jpeg, points, text, write_bag1, write_bag2

pytestmark = pytest.mark.middleware

POINTS, JPEG = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/CompressedImage"


def sizes_of(path, stage):
    return {event["sequence"]: event["payload_bytes"] for event in events_of(path, stage)}


def test_files_and_bags_go_there_and_back(domain_id, tmp_path):
    (tmp_path / "photos").mkdir()
    for name, size in (("a.jpg", 3000), ("b.jpg", 500)):
        (tmp_path / "photos" / name).write_bytes(os.urandom(size))
    bag2 = write_bag2(
        tmp_path / "bag",
        {
            "/points": [points(n) for n in (100, 3, 7)],
            "/jpeg": [jpeg(501)] * 2,
            "/imu": [imu(0.5)] * 2,
            "/text": [text("hello"), text("")],
        },
    )
    bag1 = write_bag1(tmp_path / "x.bag", {"/camera": [image(40, ROS1)] * 2, "/points": [points(9, ROS1)] * 2})
    # --data, data_type, rate, bytes of the first messages (None: what the type adds to its data is counted elsewhere)
    cases = {
        f"file:{tmp_path}/photos": ("binary", 10.0, [3000, 500, 3000]),
        f"bag:{bag2}#/points": ("pointcloud2", 50.0, None),
        f"bag:{bag2}#/jpeg": ("compressedimage", 50.0, [520, 520, 520]),
        f"bag:{bag2}#/imu": ("imu", 50.0, [296, 296, 296]),
        f"bag:{bag2}#/text": ("string", 50.0, [5, 0, 5]),
        f"bag:{bag1}#/camera": ("binary", 50.0, [1200, 1200, 1200]),
        f"bag:{bag1}#/points": ("pointcloud2", 50.0, None),
    }
    relayed = []
    with relay(domain_id, tmp_path / "relay.mcap", "--type", POINTS, "--type", JPEG, *ROOMY) as command:
        for number, (data, (data_type, rate_hz, sizes)) in enumerate(cases.items()):
            out = tmp_path / f"ping{number}.mcap"
            done = ping(domain_id, out, "--data", data, "--messages", 8, "--warmup", 0, *ROOMY)
            assert done.status == 0, done.stderr
            assert "sent 8/8, received 8, lost 0" in done.stdout
            run = last_json(out, "run")
            assert (run["data_type"], run["rate_hz"]) == (data_type, pytest.approx(rate_hz))
            assert run["data_source"] == data
            sent = sizes_of(out, "t1")
            assert run["payload_bytes"] == max(sent.values())
            assert sizes_of(out, "t2") == sent
            if sizes is not None:
                assert [sent[n] for n in range(3)] == sizes
            relayed.append((int(run["run_id"], 16), sent))
        assert command.stop().status == 0
    for run_id, sent in relayed:
        for stage in ("t3", "t4"):
            events = [event for event in events_of(tmp_path / "relay.mcap", stage) if event["run_id"] == run_id]
            assert {event["sequence"]: event["payload_bytes"] for event in events} == sent
    session = last_json(tmp_path / "relay.mcap", "session")
    assert session["recorder_cost"]["record_median_ns"] > 0
    floor = session["client_library_floor"]
    assert 0 < floor["median_ns"] <= floor["p99_ns"]
    assert floor["messages"] == BRIEF_FLOOR_MESSAGES


@contextmanager
def lidar(domain_id, topic, rate_hz):
    script = Path(__file__).parents[2] / "support" / "topic_publisher.py"
    process = subprocess.Popen(
        [sys.executable, "-W", "ignore", script, topic, str(rate_hz), "1000"],
        env={**os.environ, "ROS_DOMAIN_ID": str(domain_id)},
    )
    try:
        yield
    finally:
        process.kill()
        process.wait(PATIENCE_S)


@pytest.mark.filterwarnings("ignore")
def test_each_message_of_a_live_topic_becomes_a_ping(domain_id, tmp_path):
    out = tmp_path / "ping.mcap"
    with (
        lidar(domain_id, "/lidar/points", 25),
        relay(domain_id, tmp_path / "relay.mcap", "--type", POINTS, *ROOMY) as command,
    ):
        done = ping(
            *(domain_id, out, "--data", "topic:/lidar/points", "--messages", 20, "--warmup", 2),
            *("--wait", PATIENCE_S, *ROOMY),
        )
        assert done.status == 0, done.stderr
        assert counts_in(done.stdout.splitlines()[1])[:5] == [
            20,
            20,
            2,
            20,
            0,
        ]  # sent, planned, warm-up, received, lost
        assert command.stop().status == 0
    run = last_json(out, "run")
    assert (run["data_type"], run["data_source"]) == ("pointcloud2", "topic:/lidar/points")
    assert (run["skipped_messages"], run["published"]) == (0, 22)
    assert 0 < run["rate_hz"] <= 50
    assert set(sizes_of(out, "t1").values()) == {run["payload_bytes"]}
    assert 16_000 < run["payload_bytes"] < 16_100
    t1, t2 = events_of(out, "t1"), events_of(out, "t2")
    assert all(event["scheduled_ns"] < event["monotonic_ns"] for event in t1)  # arrival, then publish
    arrivals = [event["scheduled_ns"] for event in t1]
    assert arrivals == sorted(set(arrivals))
    assert len(t2) == len(events_of(tmp_path / "relay.mcap", "t3")) == 22


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("/nobody", "--data topic:/nobody: it has no publisher in domain"),
        ("/binary_image_relay", "topic of our own messages"),
    ],
)
def test_a_topic_that_cannot_be_sent_is_one_line(domain_id, tmp_path, name, line):
    done = ping(domain_id, tmp_path / "x.mcap", "--data", f"topic:{name}", "--wait", 0.5)
    assert done.status == 2
    assert line in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "x.mcap").exists()


def test_a_deadline_that_never_matches_is_named(domain_id, tmp_path):
    with relay(domain_id, tmp_path / "relay.mcap", "--deadline", "20ms", "--lifespan", "2s") as command:
        done = ping(domain_id, tmp_path / "x.mcap", "--deadline", "1.5s", "--wait", PATIENCE_S * 10)
        assert done.status == 8
        assert "deadline (1.5s offered, 20ms requested)" in done.stderr
        out = tmp_path / "ping.mcap"
        same = ("--deadline", "20ms", "--lifespan", "2s")
        done = ping(domain_id, out, *same, "--data", "imu", "--messages", 5, "--rate", 100)
        assert done.status == 0, done.stderr
        command.stop()
    qos = last_json(out, "run")["qos"]
    assert (qos["deadline_ns"], qos["lifespan_ns"]) == (20_000_000, 2_000_000_000)
