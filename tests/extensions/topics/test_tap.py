from dataclasses import replace

import numpy as np
import polars as pl
import pytest
from fake_clock import FakeClock
from fake_tap_node import FakeTapNode, JsonSink
from rosbags.typesys import Stores, get_typestore
from trace_files import ping_session

from dds_trace.extensions.bags.analyze import analyze_topics
from dds_trace.extensions.topics.tap import MOST_ANNOUNCED, TAP, Tap, definition_of, reader_of, summarize
from dds_trace.recorder.backends.node import Publication, TopicPatterns
from dds_trace.recorder.choices import Durability, Reliability
from dds_trace.recorder.options import chosen_qos
from dds_trace.tracefile.format.descriptions import Qos
from dds_trace.tracefile.format.events import PUBLISHER_TOPIC, hash_content
from dds_trace.tracefile.writing.destination import TraceDestination
from dds_trace.tracefile.writing.sink import TraceSink

IMAGE = "sensor_msgs/msg/Image"
MS = 1_000_000
MESSAGE = b"\0\1\0\0" + (5).to_bytes(4, "little") + (6).to_bytes(4, "little") + b"rest"
CAMERA = Publication("/camera/image", IMAGE, "aa" * 16, "/driver", Qos("reliable", "transient_local"))
SECOND = Publication(CAMERA.topic, IMAGE, "bb" * 16, "/second")


class Bench:
    def __init__(
        self, *patterns, graph=(CAMERA,), keeps_payload=False, open_sink=lambda _: JsonSink(), node=None, asked=None
    ):
        self.node, self.clock, self.notes = node or FakeTapNode(), FakeClock(), []
        self.sink = open_sink(self.clock.monotonic_ns)
        self.node.graph = list(graph)
        self.node.definitions = {IMAGE: {"header": "std_msgs/Header"}}
        qos = chosen_qos(asked, None, None)
        self.tap = Tap(
            self.node,
            self.sink,
            TopicPatterns(patterns or ("/camera/*",)),
            session_id=0xA1,
            qos=qos,
            note=self.notes.append,
            clock=self.clock,
            keeps_payload=keeps_payload,
        )
        self.tap.look()

    def hear(self, sequence=0, topic=CAMERA.topic, source=None, message=MESSAGE, source_ns=11):
        self.node.subscriptions[topic].receive(message, source_ns, 12, sequence, source)

    def look(self, after_ms=1000):
        self.clock.now_ns += after_ms * MS
        self.tap.look()

    def states(self):
        return [(text["state"], text["messages"], text["missing"]) for topic, text in self.sink.texts]


def test_every_message_is_an_event():
    bench = Bench()
    bench.clock.now_ns = 700
    bench.hear(1)
    stamp_ns = 5_000_000_006
    assert bench.sink.events == [(TAP, hash_content(MESSAGE), 1, 700, stamp_ns, 11, 12, len(MESSAGE), 1)]


def test_its_publisher_is_described_once_heard_and_at_the_end():
    bench = Bench()
    bench.hear(1)
    bench.hear(4)
    bench.look()
    bench.tap.close()
    assert [topic for topic, _ in bench.sink.texts] == [PUBLISHER_TOPIC] * 2
    assert bench.states() == [("heard", 2, 2), ("closed", 2, 2)]
    text = bench.sink.texts[0][1]
    assert text["session_id"] == "00000000000000a1"
    assert (text["topic"], text["type"], text["publisher"]) == (CAMERA.topic, IMAGE, CAMERA.publisher)
    assert (text["node"], text["has_header"], text["sequence_is_given"]) == ("/driver", True, True)
    assert text["qos"]["durability"] == "transient_local"
    assert text["subscribed"]["reliability"] == "best_effort"
    assert not bench.node.subscriptions[CAMERA.topic].is_open


@pytest.mark.parametrize(("skipped", "silences"), [(0, [400]), (3, [400]), (3, range(300, 700, 25))])
def test_a_bag_of_a_taps_own_file_has_the_taps_own_counts(tmp_path, skipped, silences):
    destination = TraceDestination(tmp_path / "tap.mcap")
    bench = Bench(keeps_payload=True, open_sink=lambda now_ns: TraceSink(destination, ping_session(), clock_ns=now_ns))
    for number in range(1, 803):
        bench.clock.now_ns += 1000 * MS // len(silences) if number in silences else 2_290_000  # at 437 Hz, 430 missing
        bench.hear(number + skipped * (number >= 400))
    bench.tap.close()
    bench.sink.close()
    report = analyze_topics(destination.path)
    row = report.topics.row(by_predicate=pl.col("topic") == CAMERA.topic, named=True)
    assert (row["messages"], row["missing_from"]) == (bench.tap.messages, "tap") == (802, "tap")
    assert row["missing"] == row["missing_low"] == row["missing_high"] == bench.tap.streams[0].missing == skipped
    assert report.holes.filter(topic=CAMERA.topic)["missing"].sum() == skipped
    assert report.verdict == ("holes" if skipped else "whole")


def test_nobody_writes_to_the_topics_of_the_trace():
    forged = Publication("/dds_trace/session", "std_msgs/msg/String", "cc" * 16)
    bench = Bench("*", graph=[CAMERA, forged], keeps_payload=True)
    for topic in (CAMERA.topic, forged.topic):
        bench.hear(topic=topic)
    assert [(kept.name, data) for kept, data, _ in bench.sink.payloads] == [(CAMERA.topic, MESSAGE)]


@pytest.mark.parametrize(
    ("pattern", "topics"),
    [
        ("/camera/image", ["/camera/image"]),
        ("/camera/*", ["/camera/depth/points", "/camera/image"]),
        ("/camera/?mage", ["/camera/image"]),
        ("/lidar", []),
        ("*", ["/camera/depth/points", "/camera/image", "/tf"]),
    ],
)
def test_patterns_choose_topics(pattern, topics):
    others = [
        Publication("/tf", "tf2_msgs/msg/TFMessage"),
        Publication("/camera/depth/points", "sensor_msgs/msg/PointCloud2"),
    ]
    assert Bench(pattern, graph=[CAMERA, *others]).tap.topics == topics


@pytest.mark.parametrize(
    ("graph", "unseen", "word"),
    [
        ([replace(CAMERA, is_seen=False)], [CAMERA.topic], "does not show"),
        ([CAMERA], [], "1 publisher"),
        ([replace(CAMERA, is_seen=False), CAMERA], [], "2 publishers"),
    ],
)
def test_what_was_asked_for_is_not_said_to_be_there(graph, unseen, word):
    bench = Bench(graph=graph)
    assert bench.tap.unseen == unseen
    assert any(word in note for note in bench.notes)
    bench.node.graph = []  # all left
    bench.look()
    assert bench.tap.unseen == [CAMERA.topic]


def test_a_topic_that_appears_later_is_joined():
    bench = Bench(graph=[])
    assert bench.tap.topics == []
    bench.node.graph = [CAMERA]
    bench.look(after_ms=10)
    assert bench.tap.topics == []  # the graph is looked at twice a second
    bench.look()
    bench.hear(1)
    assert (bench.tap.topics, bench.tap.messages) == ([CAMERA.topic], 1)


def test_a_tap_asks_nothing_of_a_publisher():
    assert chosen_qos(None, None, None) == Qos("best_effort", "volatile", "keep_last", 32)
    assert Bench().node.subscribed == {CAMERA.topic: chosen_qos(None, None, None)}
    asked = chosen_qos(Reliability.RELIABLE, Durability.TRANSIENT_LOCAL, 5)
    assert asked == Qos("reliable", "transient_local", "keep_last", 5)


def test_publishers_without_numbers_that_cannot_be_distinguished_share_a_record():
    bench = Bench()
    bench.hear()
    bench.node.graph.append(SECOND)
    bench.look()
    bench.hear()
    assert [(event[2], event[-1]) for event in bench.sink.events] == [(0, 1), (0, 2)]
    bench.node.graph.remove(SECOND)
    bench.look()
    bench.hear()
    assert [event[-1] for event in bench.sink.events] == [1, 2, 1]
    assert [stream.publisher for stream in bench.tap.streams] == [CAMERA.publisher, None]


def feed(bench, publishers, looks_ms=500):
    """Hear publishers, each a list of pairs of time (ms) and number, in the order of time; return all in this order."""
    heard = sorted((at_ms, sequence, name) for name, sent in publishers.items() for at_ms, sequence in sent)
    looked_ms, start_ns = 0, bench.clock.now_ns
    for at_ms, sequence, _ in heard:
        bench.clock.now_ns = start_ns + round(at_ms * MS)
        bench.hear(sequence, source_ns=bench.clock.now_ns)
        if at_ms - looked_ms > looks_ms:
            looked_ms = at_ms
            bench.tap.look()
    return heard


def sent(rng, rate_hz, start_s, end_s, first, loss=0.0):
    period_ms = 1000 / rate_hz
    count = int((end_s - start_s) * rate_hz)
    times_ms = start_s * 1000 + period_ms * (np.arange(count) + rng.random() + rng.normal(0, 0.05, count))
    return [pair for pair in zip(times_ms.tolist(), range(first, first + count), strict=True) if rng.random() >= loss]


@pytest.mark.parametrize("seed", range(40))
def test_a_second_publisher_is_no_loss(seed):
    rng = np.random.default_rng(seed)
    rates = rng.uniform(5, 200, 2)
    joined_s, left_s = rng.uniform(1, 8), rng.uniform(10, 20)
    bench = Bench()
    firsts = rng.integers(1, 5000, 2) if seed % 2 else (1, 1)
    publishers = {
        "a": sent(rng, rates[0], 0, 20, int(firsts[0])),
        "b": sent(rng, rates[1], joined_s, left_s, int(firsts[1])),
    }
    bench.node.graph.append(SECOND)  # the graph has a publisher before the first message of it comes
    heard = feed(bench, publishers)
    assert sum(stream.missing for stream in bench.tap.streams) == 0
    by_id = [
        [event[2] for event in bench.sink.events if event[-1] == stream.publisher_id] for stream in bench.tap.streams
    ]
    assert len(by_id) == 2
    assert all(np.all(np.diff(numbers) == 1) for numbers in by_id)
    assert sorted(map(len, by_id)) == sorted(map(len, publishers.values()))
    assert len(heard) == bench.tap.messages
    assert not any("stopped" in note for note in bench.notes if "nothing for" in note and left_s > 18)


@pytest.mark.parametrize("seed", range(20))
def test_losses_of_one_publisher_are_its_numbers(seed):
    rng = np.random.default_rng(seed)
    rate_hz, bench = rng.uniform(5, 200), Bench()
    messages = sent(rng, rate_hz, 0, 20, 7, loss=rng.uniform(0, 0.9))
    feed(bench, {"a": messages})
    (stream,) = bench.tap.streams
    assert stream.missing == messages[-1][1] - messages[0][1] + 1 - len(messages)
    assert stream.rate_hz == pytest.approx(rate_hz, rel=0.05)


def test_a_publisher_that_starts_again_is_another_one():
    bench = Bench()
    again = replace(CAMERA, publisher="dd" * 16)
    feed(bench, {"a": [(10 * number, number) for number in range(1, 100)]})
    bench.node.graph = [again]
    feed(bench, {"a": [(1000 + 10 * number, number) for number in range(1, 50)]}, looks_ms=100)
    assert [(stream.publisher, stream.messages, stream.missing) for stream in bench.tap.streams] == [
        (CAMERA.publisher, 99, 0),
        (again.publisher, 49, 0),
    ]


@pytest.mark.parametrize(
    ("offered", "asked", "has_cure"),
    [("reliable", None, True), ("best_effort", None, False), ("reliable", Reliability.RELIABLE, False)],
)
def test_what_the_tap_lost_is_its_own_and_has_a_cure_where_there_is_one(offered, asked, has_cure):
    bench = Bench(graph=[replace(CAMERA, qos=Qos(offered))], asked=asked)
    feed(bench, {"a": [(66 * number, number) for number in (1, 14, 30, 31, 70)]})
    (line,) = summarize(bench.tap.streams)
    assert "5 messages, 15.2 Hz, 65 missing:" in line
    assert ("-o reliability=reliable" in line) == has_cure


def test_a_middleware_that_names_the_publisher_keeps_them_apart():
    bench = Bench(graph=[CAMERA, SECOND])
    bench.node.sources = {1: CAMERA.publisher, 2: SECOND.publisher}
    for source, sequence in ((1, 1), (2, 50), (1, 2), (2, 51)):
        bench.hear(sequence, source=source)
    assert [(event[2], event[-1]) for event in bench.sink.events] == [(1, 1), (50, 2), (2, 1), (51, 2)]
    assert [stream.publication.node_name for stream in bench.tap.streams] == ["/driver", "/second"]
    assert sum(stream.missing for stream in bench.tap.streams) == 0
    for sequence in (4, 3, 5):
        bench.hear(sequence, source=1)
    assert [(stream.missing, stream.reordered) for stream in bench.tap.streams] == [(0, 1), (0, 0)]


def test_silence_and_return_are_reported():
    bench = Bench()
    for sequence in range(1, 31):
        bench.clock.now_ns += 100 * MS
        bench.hear(sequence)
    bench.look(after_ms=1900)
    assert [state for state, *_ in bench.states()] == ["heard"]
    bench.look(after_ms=300)
    assert bench.states()[-1] == ("stopped", 30, 0)
    bench.look(after_ms=5000)
    assert len(bench.states()) == 2  # once
    (line,) = summarize(bench.tap.streams)
    assert "30 messages, 10 Hz, 0 missing" in line
    assert "stopped" in line
    bench.hear(31)
    bench.look(after_ms=1)
    assert bench.notes[-1] == "/camera/image is back"


def test_a_slow_topic_is_not_taken_for_a_stopped_one():
    bench = Bench()
    for sequence in range(1, 31):
        bench.clock.now_ns += 1000 * MS
        bench.hear(sequence)
        bench.look(after_ms=0)
    bench.look(after_ms=9000)
    assert [state for state, *_ in bench.states()] == ["heard"]


def test_a_publisher_that_leaves_is_reported():
    bench = Bench()
    bench.hear(1)
    bench.node.graph = []
    bench.look()
    assert bench.states()[-1][0] == "stopped"
    assert "/driver" in bench.notes[-1]


def test_a_type_that_is_not_installed_costs_only_its_topic():
    lidar = Publication("/camera/lidar", "my_msgs/msg/Scan", "cc" * 16)
    bench = Bench(graph=[])
    bench.node.unknown = {"my_msgs/msg/Scan"}
    bench.node.graph = [lidar, CAMERA]
    bench.look()
    bench.look()
    assert bench.tap.topics == [CAMERA.topic]
    assert list(bench.tap.refused) == ["/camera/lidar"]
    assert sum("/camera/lidar" in note for note in bench.notes) == 1


STORE = get_typestore(Stores.LATEST)
T = STORE.types


nobody_knows = {}.get


def header(sec, nanosec):
    return T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](sec, nanosec), "map")


def transforms(*stamps):
    zero, unit = T["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0), T["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    stamped, transform = T["geometry_msgs/msg/TransformStamped"], T["geometry_msgs/msg/Transform"](zero, unit)
    return T["tf2_msgs/msg/TFMessage"]([stamped(header(*stamp), "child", transform) for stamp in stamps])


POINT = T["geometry_msgs/msg/PointStamped"](header(7, 8), T["geometry_msgs/msg/Point"](1.0, 2.0, 3.0))
AS_RCLPY = {
    "geometry_msgs/msg/PointStamped": {"header": "std_msgs/Header", "point": "geometry_msgs/Point"},
    "tf2_msgs/msg/TFMessage": {"transforms": "sequence<geometry_msgs/TransformStamped>"},
    "geometry_msgs/msg/TransformStamped": {"header": "std_msgs/Header", "child_frame_id": "string"},
}


@pytest.mark.parametrize("little_endian", [True, False])
@pytest.mark.parametrize("members", [nobody_knows, AS_RCLPY.get])
@pytest.mark.parametrize(("message", "stamp_ns"), [(POINT, 7_000_000_008), (transforms((5, 6), (9, 9)), 5_000_000_006)])
def test_the_first_stamp_is_read(message, stamp_ns, members, little_endian):
    data = bytes(STORE.serialize_cdr(message, message.__msgtype__, little_endian=little_endian))
    assert reader_of(message.__msgtype__, members)(data) == stamp_ns


@pytest.mark.parametrize(
    "type_name", ["std_msgs/msg/String", "geometry_msgs/msg/Twist", "my_msgs/msg/Unknown", "Square"]
)
def test_other_types_have_none(type_name):
    assert reader_of(type_name, nobody_knows) is None


@pytest.mark.parametrize(
    "first",
    [
        "double[36]",
        "sequence<uint8, 10>",
        "string<10>",
        "sequence<double>",
        "boolean",
        "float",
        "b/B[2]",
        "uint8[]",
        "string",
    ],
)
def test_members_as_rclpy_spells_them_are_passed_over(first):
    definitions = {"a/msg/A": {"first": first, "header": "std_msgs/Header"}, "b/msg/B": {"x": "double"}}
    read = reader_of("a/msg/A", definitions.get)
    head = (5).to_bytes(4, "little") + (6).to_bytes(4, "little") + bytes(8)
    width = {"double[36]": 288, "b/B[2]": 16}.get(first, 4)  # a sequence and a string of no elements, a padded flag
    assert read(b"\0\1\0\0" + bytes(width) + head) == 5_000_000_006


EMPTY = bytes(STORE.serialize_cdr(transforms(), "tf2_msgs/msg/TFMessage"))


@pytest.mark.parametrize("data", [b"", b"\0\1\0\0", b"\0\1\0\0\1\0\0\0\0\0\0", EMPTY])
def test_what_is_cut_short_or_has_no_elements_has_none(data):
    assert not reader_of("tf2_msgs/msg/TFMessage" if data == EMPTY else POINT.__msgtype__, nobody_knows)(data)


def test_the_text_of_a_type_has_all_that_it_is_made_of():
    members = {
        "my_msgs/msg/Scan": {"header": "std_msgs/Header", "ranges": "sequence<double, 3>", "name": "string<10>"},
        "my_msgs/msg/Odd": {"left": "my_msgs/Unknown"},
    }
    text = definition_of("my_msgs/msg/Scan", members.get)
    first, second, third = text.split(f"{'=' * 80}\n")
    assert first.split() == ["std_msgs/Header", "header", "float64[]", "ranges", "string", "name"]
    assert second.splitlines()[0] == "MSG: std_msgs/Header"
    assert third.splitlines()[0] == "MSG: builtin_interfaces/Time"
    assert definition_of("my_msgs/msg/Odd", members.get) == ""


def test_what_a_graph_announces_is_refused_by_topic_once():
    class StrictNode(FakeTapNode):
        def create_tap(self, topic, type_name, receive, *, qos):
            if topic != CAMERA.topic:
                raise ValueError(f"{type_name}: no such type \x1b[2J")
            return super().create_tap(topic, type_name, receive, qos=qos)

    bench = Bench(
        "*", graph=[Publication("/camera/other", "nonsense", "bb" * 16, "/x", Qos()), CAMERA], node=StrictNode()
    )
    for _ in range(3):
        bench.look()
    assert len([note for note in bench.notes if "no such type" in note]) == 1
    assert "\x1b" not in "".join(bench.notes)
    assert set(bench.node.subscriptions) == {CAMERA.topic}


def test_topics_and_types_without_end_are_bounded_and_counted():
    topics = [Publication(f"/many{number:04}", IMAGE) for number in range(MOST_ANNOUNCED)]
    types = [Publication("/one", f"many/msg/Type{number}") for number in range(MOST_ANNOUNCED)]
    bench = Bench("/*", graph=[CAMERA, *types, *topics])
    bench.node.unknown = {publication.type_name for publication in types}
    for _ in range(3):
        bench.look()
    assert len(bench.tap._topics) == MOST_ANNOUNCED
    assert bench.tap.left_out == MOST_ANNOUNCED + 1
    assert len([note for note in bench.notes if "left out" in note]) == 1
    assert CAMERA.topic in bench.tap.topics
    bench = Bench("/*", graph=[])
    bench.node.graph, bench.node.unknown = types, {publication.type_name for publication in types}
    bench.look()
    assert len([note for note in bench.notes if "not joined" in note]) == 1


@pytest.mark.parametrize(
    "name",
    ["", "/", "//x", "/..", "/../../etc/passwd", "/x/**", "/\x1b[2J", "/a b", "/x/", "/\u202e", "/" + 10_000 * "a"],
)
def test_a_name_that_no_topic_has_is_refused(name):
    bench = Bench("*", graph=[Publication(name, IMAGE), CAMERA, Publication("/typed", name or " ")])
    assert bench.tap.topics == [CAMERA.topic]
    assert len(bench.tap.refused) == 2
    assert all(note.isprintable() for note in bench.notes)
