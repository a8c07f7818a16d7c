import json
import re

import numpy as np
import polars as pl
import pytest
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore
from tap_traces import FAR_NS, LAPTOP, MS, NEAR_NS, ROBOT, SECOND, Clock, arrivals, camera, write_beacon
from typer.testing import CliRunner

from dds_trace.extensions.bags.analyze import analyze_topics
from dds_trace.extensions.bags.command import app

STORE = get_typestore(Stores.ROS2_JAZZY)
AGE_NS = FAR_NS * 4 // 3 + 5 * MS


def write_bag(path, *, stamped=ROBOT, recorded=LAPTOP, topic="/camera/info", also=(), growth_ns=0):
    types = STORE.types
    published = camera(seconds=20)
    arrived = arrivals(published, FAR_NS)
    arrived += np.linspace(0, growth_ns, len(arrived)).astype(np.int64)
    with Writer(path, version=9) as bag:
        for name, clock, offset_ns in ((topic, stamped, 5 * MS), *also):
            connection = bag.add_connection(name, "std_msgs/msg/Header", typestore=STORE)
            sent = clock.wall(published.sent_ns - offset_ns)
            logged = recorded.wall(arrived if clock is not recorded else published.sent_ns + NEAR_NS)
            for stamp_ns, log_ns in zip(sent.tolist(), logged.tolist(), strict=True):
                time = types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
                message = types["std_msgs/msg/Header"](stamp=time, frame_id="camera")
                bag.write(connection, log_ns, STORE.serialize_cdr(message, "std_msgs/msg/Header"))
    return arrived - published.sent_ns + 5 * MS


def run(*arguments):
    return CliRunner().invoke(app, [str(one) for one in arguments])


@pytest.mark.parametrize("growth_ns", [0, 200 * MS])
def test_ages_and_their_course_are_inside_their_bound(tmp_path, growth_ns):
    true_ns = write_bag_and_beacon(tmp_path, growth_ns=growth_ns)
    (before,) = analyze_topics(tmp_path / "bag").topics.iter_rows(named=True)
    assert abs(before["age_p50_ns"]) > SECOND
    assert before["age_bound_ns"] is None
    result = run(tmp_path / "bag", "--clock", tmp_path / "runs", "--report", "json", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    (topic,) = json.loads((tmp_path / "out" / "topics.json").read_text())["topics"]
    assert bool(re.search(r"ms to 20\d ms", result.output)) is (growth_ns > 0)
    assert topic["age_end_ns"] == pytest.approx(np.median(true_ns[-5:]), abs=topic["age_bound_ns"])
    assert 0 < topic["age_bound_ns"] < MS
    assert abs(topic["age_p50_ns"] - np.median(true_ns)) <= topic["age_bound_ns"]
    assert abs(topic["age_p99_ns"] - np.quantile(true_ns, 0.99)) <= topic["age_bound_ns"]
    assert topic["age_negative"] == 0


def test_stamps_of_the_recording_device_stay_as_they_are(tmp_path):
    write_bag_and_beacon(tmp_path, also=[("/local", LAPTOP, 3 * MS)])
    result = run(tmp_path / "bag", "--clock", tmp_path / "runs", "--export", "csv", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    local, camera_info = pl.read_csv(tmp_path / "out" / "topics.csv").sort("topic", descending=True).to_dicts()
    assert local["age_bound_ns"] is None
    assert local["age_p50_ns"] == pytest.approx(3 * MS + NEAR_NS, abs=2_000)  # its clock runs 200 ppm too fast
    assert camera_info["age_p50_ns"] == pytest.approx(AGE_NS, rel=0.1)


def write_bag_and_beacon(folder, **bag):
    write_beacon(folder / "runs", LAPTOP, ROBOT, seconds=23)
    return write_bag(folder / "bag", **bag)


def test_limits_on_ages_rest_on_the_bound(tmp_path):
    write_bag_and_beacon(tmp_path)
    clock = ("--clock", tmp_path / "runs", "--fail-if")
    assert run(tmp_path / "bag", *clock, "age_p99(/camera/info) > 50ms").exit_code == 0
    assert run(tmp_path / "bag", *clock, "age_p50(/camera/info) > 2ms").exit_code == 20


def test_where_both_ways_are_possible_the_devices_are_asked_for(tmp_path):
    robot = Clock("robot", "11111111-1111-1111-1111-111111111111")
    laptop = Clock("laptop", "22222222-2222-2222-2222-222222222222", 9 * SECOND, 2 * MS)
    write_bag(tmp_path / "bag", stamped=robot, recorded=laptop)
    write_beacon(tmp_path / "runs", laptop, robot, seconds=23)
    result = run(tmp_path / "bag", "--clock", tmp_path / "runs")
    assert (result.exit_code, "stamped=" in result.output + str(result.exception)) == (1, True) or result.exit_code == 2
    named = f"{tmp_path / 'runs'} stamped=robot recorded=laptop"
    result = run(tmp_path / "bag", "--clock", named, "--fail-if", "age_p50(/camera/info) > 7ms")
    assert result.exit_code == 0, result.output


UNKNOWN = "{}/runs stamped=rover recorded=laptop"


@pytest.mark.parametrize("clock", ["", "stamped=a recorded=b", "runs/ stamped=a", "runs/ stamped= recorded=b", UNKNOWN])
def test_what_cannot_be_a_clock_is_refused(tmp_path, clock):
    write_bag_and_beacon(tmp_path)
    result = run(tmp_path / "bag", "--clock", clock.format(tmp_path))
    assert result.exit_code != 0
    assert ("rover" if clock == UNKNOWN else "--clock") in str(result.exception) + result.output
