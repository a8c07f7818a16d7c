"""The derived MCAP is read back with the public readers; the layout names what is in it."""

import json
import math

import polars as pl
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from roundtrip_frames import MS, steady, with_one_way

from dds_trace.base.errors import OutputError, OutputExistsError
from dds_trace.extensions.exports.foxglove import PLOTTED_TOPICS, foxglove_layout, topic_name, write_derived

WALL = 1_700_000_000 * 10**9


def frame():
    runs = [
        steady([5 * MS, None, 7 * MS], run_id=0xA1, relay_id=3),
        steady([50 * MS], run_id=0xB2, relay_id=3, vendor="zenoh", data_type="imu", rate_hz=2.5),
    ]
    return with_one_way(pl.concat(runs))


def test_rosbags_reads_back_every_number(tmp_path):
    made = write_derived(frame(), tmp_path / "latency.mcap", {0xA1: WALL, 0xB2: WALL + 50 * MS})
    with AnyReader([made.path]) as reader:
        found = [
            (connection.topic, log_ns - WALL, reader.deserialize(data, connection.msgtype))
            for connection, log_ns, data in reader.messages()
        ]
    first, second = "/latency/fastdds/none/binary_33000B_10Hz", "/latency/zenoh/none/imu_33000B_2_5Hz"
    one, two = f"{first}/run_{0xA1:016x}/relay_00000003", f"{second}/run_{0xB2:016x}/relay_00000003"
    assert [(topic, since) for topic, since, _ in found] == [(one, 0), (two, 50 * MS), (one, 100 * MS), (one, 200 * MS)]
    message = found[0][2]
    assert (message.sequence, message.payload_bytes, message.lost) == (0, 33_000, False)
    assert (message.latency_ms, message.rtt_ms, message.response_ms) == (5.0, 10.001, 10.001)
    assert message.intermediate_ms == 0.001
    assert message.outbound_ms + message.return_ms == pytest.approx(10.0)
    assert message.clock_bound_ms > 0
    lost = found[2][2]
    assert (lost.sequence, lost.lost) == (1, True)
    assert math.isnan(lost.latency_ms)
    assert math.isnan(lost.clock_bound_ms)
    assert made.topics == (one, two)
    assert made.messages == 4


def test_the_public_reader_passes_it(tmp_path):
    made = write_derived(frame(), tmp_path / "latency.mcap")
    with made.path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary.statistics.message_count == 4
        assert {s.encoding for s in summary.schemas.values()} == {"ros2msg"}
        assert {c.message_encoding for c in summary.channels.values()} == {"cdr"}
        times = [message.log_time for _, _, message in reader.iter_messages()]
        assert times == sorted(times)
        assert reader.get_header().profile == "ros2"


def test_the_layout_plots_topics_that_are_in_the_file(tmp_path):
    made = write_derived(frame(), tmp_path / "latency.mcap")
    assert made.layout == tmp_path / "latency.foxglove.json"
    layout = json.loads(made.layout.read_text())
    values = [path["value"] for panel in layout["configById"].values() for path in panel["paths"]]
    assert {value.rsplit(".", 1)[0] for value in values} == set(made.topics)
    fields = {value.rsplit(".", 1)[1] for value in values}
    labels = {path["label"] for path in layout["configById"]["Plot!latency"]["paths"]}
    words = ("fastdds", "binary 33 KB", "10 Hz", "run 1"), ("zenoh", "imu 33 KB", "2.5 Hz", "run 1")
    assert labels == set(map(", ".join, words))
    with made.path.open("rb") as file:
        channels = make_reader(file).get_summary().channels.values()
    assert {channel.metadata["name"] for channel in channels} == labels
    assert fields == {"latency_ms", "response_ms", "outbound_ms", "return_ms", "clock_bound_ms", "lost"}

    def panels(node):
        return [node] if isinstance(node, str) else panels(node["first"]) + panels(node["second"])

    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])


def test_a_large_campaign_is_plotted_in_part():
    layout = foxglove_layout({f"/latency/{i}": str(i) for i in range(500)})
    assert len(layout["configById"]["Plot!latency"]["paths"]) == PLOTTED_TOPICS


def test_hostile_names_make_plain_topics():
    row = {"vendor": "a b/<c>", "bridge": "../x", "data_type": "bag:x#y", "payload_bytes": 1, "rate_hz": 0.5}
    name = topic_name({**row, "run_id": 2**64 - 1, "relay_id": 1})
    assert name == "/latency/a_b_c_/_x/bag_x_y_1B_0_5Hz/run_ffffffffffffffff/relay_00000001"


def test_nothing_is_overwritten_without_force(tmp_path):
    made = write_derived(frame(), tmp_path / "latency.mcap")
    before = made.path.read_bytes()
    with pytest.raises(OutputExistsError, match="--force"):
        write_derived(frame(), made.path)
    made.path.unlink()
    with pytest.raises(OutputExistsError, match="foxglove"):
        write_derived(frame(), made.path)
    assert write_derived(frame(), made.path, force=True).path.read_bytes() == before


def test_a_place_that_cannot_be_written_is_one_clear_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        write_derived(frame(), tmp_path / "file" / "latency.mcap")


def test_nothing_to_write_is_a_sound_file(tmp_path):
    made = write_derived(frame().clear(), tmp_path / "latency.mcap")
    assert (made.messages, made.topics) == (0, ())
    with made.path.open("rb") as file:
        assert make_reader(file).get_summary().statistics.message_count == 0
