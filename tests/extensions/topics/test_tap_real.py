import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from middlewares import needs
from rosbags.highlevel import AnyReader
from waiting import PATIENCE_S, read_past, wait_until

from dds_trace.analyzer.pipeline import analyze
from dds_trace.recorder.backends import open_node
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.choices import Discovery
from dds_trace.recorder.errors import NothingHeardError
from dds_trace.recorder.options import RecordOptions, TapOptions, chosen_qos
from dds_trace.recorder.payloads import data_types
from dds_trace.recorder.recording import record
from dds_trace.tracefile.format.descriptions import Qos
from dds_trace.tracefile.format.events import Stage, TapColumns, hash_content
from dds_trace.tracefile.reading.reader import read_trace
from dds_trace.tracefile.writing.destination import TraceDestination

pytestmark = pytest.mark.middleware

IMAGE = "sensor_msgs/msg/Image"
BACKENDS = [pytest.param(name, marks=needs(name)) for name in ("ros2", "cyclonedds", "zenoh")]
STRANGER = Path(__file__).parents[2] / "support" / "hostile_graph.py"
STAMP_NS = 1_700_000_000_123_456_789


class Watch:
    def __init__(self):
        self.notes, self.messages = [], 0

    def note(self, text):
        self.notes.append(text)

    def progress(self, progress):
        self.messages = progress.messages


@contextmanager
def tapping(path, backend, domain_id, *topics, **more):
    options = RecordOptions(
        TraceDestination(path),
        NodeOptions(domain_id=domain_id, discovery=Discovery.LOCALHOST),
        tap=TapOptions(topics, **more),
        tap_qos=chosen_qos(None, None, None),
        backend=backend,
        own_cost=False,
    )
    stop, watch, result = threading.Event(), Watch(), []
    thread = threading.Thread(target=lambda: result.append(record(options, stop, watch)))
    thread.start()
    try:
        yield watch, result
    finally:
        stop.set()
        thread.join(PATIENCE_S)


def image(number):
    data_type = data_types()["binary"]
    message = data_type.make(1001 + number % 3, number).messages[0].data
    data_type.raw.stamp.write(message, 5, number)
    data_type.raw.stamp.write_nanoseconds(message, STAMP_NS - data_type.raw.stamp.write_second(message, STAMP_NS))
    return bytes(message)


def publish_until(publisher, watches, enough=5):
    contents = []

    def heard():
        contents.append(image(len(contents)))
        publisher.publish(contents[-1])
        time.sleep(0.05)
        return all(watch.messages >= enough for watch in watches)

    wait_until(heard)
    return contents


@pytest.mark.parametrize("backend", BACKENDS[:2])
def test_a_tap_records_every_message_with_its_identity(tmp_path, domain_id, backend):
    options = NodeOptions(domain_id=domain_id, name="driver", discovery=Discovery.LOCALHOST, listens=True)
    with (
        open_node(backend, options) as node,
        tapping(tmp_path / "tap.mcap", backend, domain_id, "/camera/*") as (watch, result),
    ):
        publisher = node.create_publisher("camera/image", IMAGE)
        node.start()
        before_ns = time.monotonic_ns()
        contents = publish_until(publisher, [watch])
    trace = read_trace(tmp_path / "tap.mcap")
    taps = TapColumns.from_events(trace.events[Stage.TAP])
    assert len(taps) == result[0].trace.events >= 5
    expected = {hash_content(content): len(content) for content in contents}
    assert set(taps.content_hash.tolist()) <= set(expected)
    assert np.all(taps.header_ns == STAMP_NS)
    assert np.all(taps.payload_bytes - [expected[one] for one in taps.content_hash.tolist()] <= 3)
    assert np.all((taps.monotonic_ns >= before_ns) & (taps.source_ns > 0))
    (described,) = trace.publishers
    assert (described["topic"], described["type"], described["state"]) == ("/camera/image", IMAGE, "closed")
    assert described["has_header"]
    assert len(bytes.fromhex(described["publisher"])) == 16
    assert described["qos"]["reliability"] == "reliable"
    assert trace.sessions[0].role == "tap"
    assert trace.sessions[0].extra["own_cost"]["messages"] == len(taps)
    if backend == "ros2":
        assert np.all(np.diff(taps.publication_sequence) == 1)


@pytest.mark.parametrize("backend", BACKENDS[:2])
def test_a_second_publisher_of_a_topic_is_no_loss(tmp_path, domain_id, backend):
    first, second = (
        NodeOptions(domain_id=domain_id, name=name, discovery=Discovery.LOCALHOST) for name in ("first", "second")
    )
    with (
        open_node(backend, first) as node,
        open_node(backend, second) as other,
        tapping(tmp_path / "tap.mcap", backend, domain_id, "/camera/image") as (watch, _),
    ):
        publisher = node.create_publisher("camera/image", IMAGE)
        node.start()
        publish_until(publisher, [watch], enough=30)
        joining, sent = other.create_publisher("camera/image", IMAGE), 0
        other.start()

        def heard():
            nonlocal sent
            sent += 1
            publisher.publish(image(sent))
            for _ in range(3):
                joining.publish(image(sent))
                time.sleep(0.01)
            return watch.messages >= 150

        wait_until(heard)
    trace = read_trace(tmp_path / "tap.mcap")
    messages = len(trace.events[Stage.TAP])
    assert sum(text["messages"] for text in trace.publishers) == messages >= 150
    assert not any(text["missing"] for text in trace.publishers)
    assert len({text["publisher"] for text in trace.publishers} - {None}) == len(trace.publishers) == 2
    topics = analyze(tmp_path / "tap.mcap").topics
    assert (topics["lost_unknown"].sum(), topics["reordered"].sum()) == (0, 0)
    assert topics["received"].sum() == messages


@pytest.mark.parametrize("backend", BACKENDS[:2])
def test_messages_are_kept_as_they_came_where_that_is_asked(tmp_path, domain_id, backend):
    options = NodeOptions(domain_id=domain_id, name="driver", discovery=Discovery.LOCALHOST, listens=True)
    file = tmp_path / "tap.mcap"
    with (
        open_node(backend, options) as node,
        tapping(file, backend, domain_id, "/camera/*", payload=True) as (watch, result),
    ):
        publisher = node.create_publisher("camera/image", IMAGE)
        node.start()
        contents = publish_until(publisher, [watch])
    with file.open("rb") as stream:
        kept = [
            (schema.name, channel.message_encoding, message)
            for schema, channel, message in make_reader(stream).iter_messages(topics=["/camera/image"])
        ]
    assert len(kept) == result[0].trace.events
    assert {one[:2] for one in kept} == {(IMAGE, "cdr")}
    sent = {content.ljust(-(-len(content) // 4) * 4, b"\0")[4:] for content in contents}  # RTPS may pad
    assert {one[2].data.ljust(-(-len(one[2].data) // 4) * 4, b"\0")[4:] for one in kept} <= sent
    trace = read_trace(file)
    arrivals_ns = trace.events[Stage.TAP].monotonic_ns + trace.sessions[0].wall_ns(0)
    assert [one[2].log_time for one in kept] == arrivals_ns.tolist()
    assert trace.sessions[0].extra["payloads_left_out"] == 0
    with AnyReader([file]) as reader:
        (connection,) = (one for one in reader.connections if one.topic == "/camera/image")
        images = [reader.deserialize(data, IMAGE) for _, _, data in reader.messages([connection])]
    stamp = images[0].header.stamp
    assert stamp.sec * 10**9 + stamp.nanosec == STAMP_NS


@needs("ros2", "cyclonedds")
def test_taps_of_two_vendors_agree_about_publisher_time_and_content(tmp_path, domain_id):
    options = NodeOptions(domain_id=domain_id, name="driver", discovery=Discovery.LOCALHOST)
    files = {backend: tmp_path / f"{backend}.mcap" for backend in ("ros2", "cyclonedds")}
    with (
        open_node("ros2", options) as node,
        tapping(files["ros2"], "ros2", domain_id, "/camera/image") as (first, _),
        tapping(files["cyclonedds"], "cyclonedds", domain_id, "/camera/image") as (second, _),
    ):
        publisher = node.create_publisher("camera/image", IMAGE)
        node.start()
        publish_until(publisher, [first, second])
    traces = {backend: read_trace(file) for backend, file in files.items()}
    publishers = {trace.publishers[0]["publisher"] for trace in traces.values()}
    assert len(publishers) == 1
    keys = [
        set(zip(taps.source_ns.tolist(), taps.content_hash.tolist(), strict=True))
        for taps in (TapColumns.from_events(trace.events[Stage.TAP]) for trace in traces.values())
    ]
    assert len(keys[0] & keys[1]) >= 3


@needs("cyclonedds")
def test_a_type_that_nobody_here_knows_is_heard(tmp_path, domain_id):
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.idl import make_idl_struct
    from cyclonedds.idl.types import float64, sequence
    from cyclonedds.pub import DataWriter
    from cyclonedds.topic import Topic

    scan = make_idl_struct("Scan_", "my_msgs.msg.dds_.Scan_", {"ranges": sequence[float64], "name": str})
    with tapping(tmp_path / "tap.mcap", "cyclonedds", domain_id, "/scan") as (watch, _):
        wait_until(lambda: watch.notes)  # its settings of the domain come first
        participant = DomainParticipant(domain_id)
        writer = DataWriter(participant, Topic(participant, "rt/scan", scan))

        def heard():
            writer.write(scan(ranges=[1.0, 2.0], name="front"))
            time.sleep(0.05)
            return watch.messages >= 3

        wait_until(heard)
        writer.__del__()
        participant.__del__()
    (described,) = read_trace(tmp_path / "tap.mcap").publishers
    assert (described["type"], described["has_header"]) == ("my_msgs/msg/Scan", False)


@needs("zenoh")
def test_zenoh_topics_keys_and_nodes_of_ros_2_are_heard(tmp_path, domain_id):
    options = NodeOptions(domain_id=domain_id, name="driver", discovery=Discovery.LOCALHOST, listens=True)
    ros_key = f"{domain_id}/camera/front/sensor_msgs::msg::dds_::Image_/RIHS01_aa"
    token = (
        f"@ros2_lv/{domain_id}/aa/0/1/MP/%/%/driver/%camera%front/sensor_msgs::msg::dds_::Image_/RIHS01_aa/::,10:,:,:,,"
    )
    gid = bytes(range(16))
    with open_node("zenoh", options) as node:
        own = node.create_publisher("camera_image", IMAGE)
        alive = node._session.liveliness().declare_token(token)
        node.start()
        with tapping(tmp_path / "tap.mcap", "zenoh", domain_id, "/camera*", "robot/speed") as (watch, _):
            sequence = 0

            def heard():
                nonlocal sequence
                sequence += 1
                own.publish(image(sequence))
                numbers = b"".join(number.to_bytes(8, "little") for number in (sequence, STAMP_NS))
                node._session.put(ros_key, image(sequence), attachment=numbers + gid)
                node._session.put("robot/speed", b"12 m/s")
                time.sleep(0.05)
                return watch.messages >= 15

            wait_until(heard)
        alive.undeclare()
    trace = read_trace(tmp_path / "tap.mcap")
    taps = TapColumns.from_events(trace.events[Stage.TAP])
    described = {text["topic"]: text for text in trace.publishers}
    assert described.keys() == {"/camera_image", "/camera/front", "robot/speed"}
    ros = described["/camera/front"]
    assert (ros["publisher"], ros["type"], ros["node"]) == (gid.hex(), IMAGE, "/driver")
    of_ros = taps.publisher_id == ros["publisher_id"]
    assert np.all(np.diff(taps.publication_sequence[of_ros]) == 1)
    assert np.all(taps.source_ns[of_ros] == STAMP_NS)


@needs("ros2")
def test_a_tap_without_a_publisher_says_what_it_looked_for(tmp_path, domain_id, sentences):
    with tapping(tmp_path / "tap.mcap", "ros2", domain_id, "/nothing") as (watch, result):
        wait_until(lambda: any(note.startswith("listening to") for note in watch.notes))
    error = result[0].error
    assert isinstance(error, NothingHeardError)
    sentences(str(error).replace(str(domain_id), "DOMAIN"))
    assert not list(tmp_path.iterdir())  # the next try may have the name


def test_a_best_effort_reader_matches_every_offer():
    from dds_trace.recorder.backends.qos import mismatches

    offers = [Qos(r, d) for r in ("reliable", "best_effort") for d in ("volatile", "transient_local")]
    assert not any(mismatches(offer, chosen_qos(None, None, None)) for offer in offers)


@needs("cyclonedds")
@pytest.mark.skipif(find_spec("diagnostic_msgs") is None, reason="no diagnostic_msgs here")
def test_the_state_of_the_topics_is_on_diagnostics(tmp_path, domain_id):
    options = NodeOptions(domain_id=domain_id, name="driver", discovery=Discovery.LOCALHOST, listens=True)
    with (
        open_node("ros2", options) as node,
        tapping(tmp_path / "tap.mcap", "ros2", domain_id, "/camera/*", diagnostics=True) as (watch, _),
        tapping(tmp_path / "seen.mcap", "cyclonedds", domain_id, "/diagnostics", payload=True) as (seen, _),
    ):
        publisher = node.create_publisher("camera/image", IMAGE)
        node.start()
        publish_until(publisher, [watch])
        wait_until(lambda: seen.messages >= 2)
    with (tmp_path / "seen.mcap").open("rb") as file:
        states = [
            message.data
            for schema, channel, message in make_reader(file).iter_messages()
            if channel.topic == "/diagnostics" and schema.name == "diagnostic_msgs/msg/DiagnosticArray"
        ]
    assert any(b"/camera/image" in state for state in states)


@pytest.mark.thorough
@needs("cyclonedds")  # announces them
@pytest.mark.parametrize("backend", BACKENDS)
def test_names_of_strangers_cost_only_their_topics(tmp_path, domain_id, backend, monkeypatch):
    package = tmp_path / "hostile_package"
    (package / "msg").mkdir(parents=True)
    (package / "__init__.py").write_text("import pathlib; pathlib.Path(__file__).with_name('ran').touch()\n")
    (package / "msg" / "__init__.py").write_text("X = object\n")
    monkeypatch.syspath_prepend(tmp_path)
    stranger = [sys.executable, STRANGER, "zenoh" if backend == "zenoh" else "cyclonedds", str(domain_id)]
    with (
        subprocess.Popen(stranger, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process,
        tapping(tmp_path / "tap.mcap", backend, domain_id, "/*", "/good", "*") as (watch, result),
    ):
        read_past(process.stdout, "announced")
        wait_until(lambda: any(note.startswith("joined /good (std_msgs/msg/Header)") for note in watch.notes))
        process.stdin.write("\n")
        process.stdin.flush()
        wait_until(lambda: any(note.startswith("joined /good (std_msgs/msg/String)") for note in watch.notes))
        enough = watch.messages + 20
        wait_until(lambda: watch.messages >= enough and sum("not joined" in note for note in watch.notes) >= 5)
        process.stdin.close()
    assert result[0].error is None
    described = {
        (text["topic"], text["type"]): text["messages"] for text in read_trace(tmp_path / "tap.mcap").publishers
    }
    assert described["/good", "std_msgs/msg/String"] >= 5
    (both_types,) = (note for note in watch.notes if note.startswith("joined /good (std_msgs/msg/String)"))
    assert both_types.endswith("also announced as std_msgs/msg/Header")
    refused = [note.partition(" is not joined")[0] for note in watch.notes if "is not joined" in note]
    assert len(refused) == len(set(refused))
    assert all(note.isprintable() for note in watch.notes)
    assert not (package / "ran").exists()
