"""What a sink leaves behind, read with the public `mcap` and `rosbags` packages."""

import json
import sys
import threading
import time
from contextlib import suppress
from dataclasses import replace

import pytest
from event_cdr import unpack_event
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Message, MessageIndex, Schema
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from trace_files import WALL_ANCHOR_NS, ping_session, run
from waiting import wait_until

from dds_trace.base.errors import OutputExistsError
from dds_trace.base.version import __version__
from dds_trace.tracefile.format.descriptions import Run, Session
from dds_trace.tracefile.format.events import HOST_TOPIC, RUN_TOPIC, SESSION_TOPIC
from dds_trace.tracefile.format.ring import ring_path
from dds_trace.tracefile.writing.destination import TraceDestination
from dds_trace.tracefile.writing.sink import BUSY_SWITCH_INTERVAL_S, TraceSink
from dds_trace.tracefile.writing.writer import TraceFiles

NEVER_S = 3600.0
"""No timed chunk within a test."""

U64 = st.integers(0, 2**64 - 1)
U32 = st.integers(0, 2**32 - 1)
I64 = st.integers(-(2**63), 2**63 - 1)
TIME_NS = st.integers(0, 2**61)
EVENT = st.tuples(st.integers(1, 4), U64, U64, TIME_NS, I64, I64, I64, U32, U32)


def open_sink(path, **options):
    """A sink whose clock stands at the anchor's instant 0, so that timelines may start there."""
    destination = TraceDestination(path, **{"chunk_seconds": NEVER_S, **options})
    return TraceSink(destination, ping_session(state="open"), clock_ns=lambda: 0)


def messages(path):
    topics: dict[int, str] = {}
    with path.open("rb") as stream:
        for record in StreamReader(stream, validate_crcs=True).records:
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, Message):
                yield topics[record.channel_id], record


def events(path):
    return [
        (int(topic[-1]), *unpack_event(message.data))
        for topic, message in messages(path)
        if topic.startswith("/dds_trace/t")
    ]


def texts(path, topic):
    return [
        message.data[8 : 7 + int.from_bytes(message.data[4:8], "little")].decode()
        for found, message in messages(path)
        if found == topic
    ]


def test_a_trace_is_what_the_format_says(tmp_path):
    path = tmp_path / "ping.mcap"
    sink = open_sink(path)
    sink.write_run(run(state="started", published=0))
    sink.record(1, 7, 0, 1000, scheduled_ns=900, payload_bytes=33_000)
    sink.record(2, 7, 0, 5000, source_ns=11, received_ns=12, payload_bytes=33_000, relay_id=9)
    sink.record(1, 7, 1, 6000, scheduled_ns=5900, payload_bytes=33_000)
    sink.write_run(run(state="finished", published=2))
    sink.write_json(HOST_TOPIC, {"cpu_percent": 3.5})
    closed = sink.close(timer_ns=51)

    assert (closed.path, closed.events, closed.dropped_events, closed.error) == (path, 3, 0, None)
    assert closed.bytes == path.stat().st_size
    assert [p.name for p in tmp_path.iterdir()] == ["ping.mcap"]
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        header, summary = reader.get_header(), reader.get_summary()
    assert (header.profile, header.library) == ("ros2", f"dds-trace {__version__}")
    schemas = {schema.name: schema for schema in summary.schemas.values()}
    assert set(schemas) == {"dds_trace_msgs/msg/TraceEvent", "std_msgs/msg/String"}
    assert schemas["dds_trace_msgs/msg/TraceEvent"].data.splitlines()[0] == b"uint64 run_id"
    assert all(schema.encoding == "ros2msg" for schema in schemas.values())
    assert {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()} == {
        "/dds_trace/session": "std_msgs/msg/String",
        "/dds_trace/run": "std_msgs/msg/String",
        "/dds_trace/host": "std_msgs/msg/String",
        "/dds_trace/t1": "dds_trace_msgs/msg/TraceEvent",
        "/dds_trace/t2": "dds_trace_msgs/msg/TraceEvent",
    }
    assert all(channel.message_encoding == "cdr" for channel in summary.channels.values())
    statistics = summary.statistics
    assert (statistics.message_count, statistics.schema_count, statistics.channel_count) == (8, 2, 5)
    assert statistics.chunk_count == len(summary.chunk_indexes)
    assert (statistics.message_start_time, statistics.message_end_time) == (WALL_ANCHOR_NS, WALL_ANCHOR_NS + 6000)
    assert all(index.compression == "zstd" and index.message_index_offsets for index in summary.chunk_indexes)

    assert events(path) == [
        (1, 7, 0, 1000, 900, 0, 0, 33_000, 0),
        (2, 7, 0, 5000, 0, 11, 12, 33_000, 9),
        (1, 7, 1, 6000, 5900, 0, 0, 33_000, 0),
    ]
    of_events = [(t, m) for t, m in messages(path) if t.startswith("/dds_trace/t")]
    assert [(t[-2:], m.sequence, m.log_time - WALL_ANCHOR_NS) for t, m in of_events] == [
        ("t1", 0, 1000),
        ("t2", 0, 5000),
        ("t1", 1, 6000),
    ]
    assert all(message.publish_time == message.log_time for _, message in messages(path))
    first, last = (Session.from_json(text, path) for text in texts(path, SESSION_TOPIC))
    assert (first.state, last.state, last.dropped_events) == ("open", "closed", 0)
    assert last.extra == {"timer_ns": 51}
    assert [Run.from_json(text, path).published for text in texts(path, RUN_TOPIC)] == [0, 2]
    assert json.loads(texts(path, HOST_TOPIC)[0]) == {"cpu_percent": 3.5}


@settings(deadline=None)  # two shared cores
@given(written=st.lists(EVENT, max_size=40), ring_slots=st.integers(1, 50))
def test_what_is_recorded_is_read(tmp_path_factory, written, ring_slots):
    path = tmp_path_factory.mktemp("identity") / "trace.mcap"
    sink = open_sink(path, ring_slots=ring_slots)
    for event in written:
        before = sink.dropped_events
        sink.record(*event)
        while sink.dropped_events > before:  # a small ring is full now and then
            before = sink.dropped_events
            sink.write_json(HOST_TOPIC, {})  # drains it
            sink.record(*event)
    closed = sink.close()
    assert events(path) == written
    assert closed.events == len(written)
    times = [message.log_time for _, message in messages(path)]
    assert times == sorted(times)


@settings(deadline=None)  # two shared cores
@given(written=st.lists(EVENT, min_size=1, max_size=60))
def test_index_and_summary_lead_to_every_message(tmp_path_factory, written):
    folder = tmp_path_factory.mktemp("index") / "bag"
    path = folder / "bag_0.mcap"
    sink = open_sink(folder)
    for event in written:
        sink.record(*event)
    sink.close()
    with path.open("rb") as stream:
        by_index = list(make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False))
    assert sorted(bytes(message.data) for _, _, message in by_index) == sorted(m.data for _, m in messages(path))
    with Reader(folder) as bag:
        assert bag.message_count == len(written) + 2
        assert sum(1 for _ in bag.messages()) == len(written) + 2


def test_log_time_repeats_where_it_would_run_backwards(tmp_path):
    sink = open_sink(tmp_path / "a.mcap")
    for sequence, monotonic_ns in enumerate([100, 90, 110]):
        sink.record(1, 1, sequence, monotonic_ns)
    sink.write_json(HOST_TOPIC, {})  # closes a chunk; its own time would be 0
    sink.record(1, 1, 3, 105)
    sink.close()
    of_events = [(t, m) for t, m in messages(tmp_path / "a.mcap") if t.startswith("/dds_trace/t")]
    assert [m.log_time - WALL_ANCHOR_NS for _, m in of_events] == [100, 100, 110, 110]
    assert [event[3] for event in events(tmp_path / "a.mcap")] == [100, 90, 110, 105]


def test_a_description_is_in_the_file_when_the_call_returns(tmp_path):
    path = tmp_path / "a.mcap"
    sink = open_sink(path)
    sink.record(1, 1, 0, 10)
    sink.write_run(run(state="started"))
    cut_off = tmp_path / "killed.mcap"
    cut_off.write_bytes(path.read_bytes())
    found = []
    with suppress(EndOfFile):  # there is no footer yet
        for topic, _ in messages(cut_off):
            found.append(topic)  # what came before the end is what counts
    assert found == [SESSION_TOPIC, "/dds_trace/t1", RUN_TOPIC]
    sink.close()


def test_chunks_are_closed_in_time(tmp_path):
    path = tmp_path / "a.mcap"
    sink = open_sink(path, chunk_seconds=0.01)
    before = path.stat().st_size
    sink.record(1, 1, 0, 10)
    wait_until(lambda: path.stat().st_size > before)
    sink.close()
    assert len(events(path)) == 1


def test_a_quarter_of_the_ring_wakes_the_draining_thread(tmp_path):
    path = tmp_path / "a.mcap"
    sink = open_sink(path, ring_slots=64)
    before = path.stat().st_size
    for sequence in range(17):
        sink.record(1, 1, sequence, sequence)
    wait_until(lambda: path.stat().st_size > before)
    assert sink.close().events == 17


@pytest.mark.parametrize(("waiting", "is_shorter"), [(15, False), (16, True)])
def test_a_quarter_of_the_ring_is_moved_with_short_turns_of_the_interpreter(tmp_path, monkeypatch, waiting, is_shorter):
    sink = open_sink(tmp_path / "a.mcap", ring_slots=64)
    turns, move = [], TraceFiles.move_chunk

    def note(files, head):
        turns.append(sys.getswitchinterval())
        return move(files, head)

    monkeypatch.setattr(TraceFiles, "move_chunk", note)
    usual = sys.getswitchinterval()
    for sequence in range(waiting):
        sink.record(1, 1, sequence, sequence)
    sink.write_json(HOST_TOPIC, {})
    assert turns == [pytest.approx(BUSY_SWITCH_INTERVAL_S if is_shorter else usual)]
    assert sys.getswitchinterval() == usual
    assert sink.close().events == waiting


def test_a_full_ring_drops_and_counts(tmp_path):
    path = tmp_path / "a.mcap"
    sink = open_sink(path, ring_slots=8)
    with sink._write_lock:  # the disk is slow
        for sequence in range(11):
            sink.record(1, 1, sequence, sequence)
        assert sink.dropped_events == 3
    sink.write_json(HOST_TOPIC, {})
    with sink._write_lock:
        for sequence in range(11, 20):
            sink.record(1, 1, sequence, sequence)
        assert sink.dropped_events == 4
    closed = sink.close()
    assert (closed.events, closed.dropped_events) == (16, 4)
    assert [event[2] for event in events(path)] == [*range(8), *range(11, 19)]
    assert Session.from_json(texts(path, SESSION_TOPIC)[-1], path).dropped_events == 4


@pytest.mark.parametrize(
    "event",
    [
        (1, -1, 0, 0),
        (1, 2**64, 0, 0),
        (1, 1, 0, 2**63),
        (1, 1, 0, 0, 0, 0, 0, 2**32),
        (1, 1, 0, 0.5),
        (6, 1, 0, 0),
        (1, 1, None, 0),
    ],
)
def test_an_event_that_does_not_fit_is_dropped_and_counted(tmp_path, event):
    sink = open_sink(tmp_path / "a.mcap")
    sink.record(1, 1, 0, 1)
    sink.record(*event)
    sink.record(1, 1, 1, 2)
    closed = sink.close()
    assert (closed.events, closed.dropped_events) == (2, 1)
    assert [e[2] for e in events(tmp_path / "a.mcap")] == [0, 1]


def test_events_of_several_threads_are_all_there(tmp_path):
    path = tmp_path / "a.mcap"
    sink = open_sink(path, chunk_seconds=0.002, ring_slots=1 << 15)
    each = 4000

    def stamp(thread):
        for sequence in range(each):
            sink.record(thread + 1, thread, sequence, time.monotonic_ns())

    threads = [threading.Thread(target=stamp, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    closed = sink.close()
    assert closed.events + closed.dropped_events == 4 * each
    assert closed.dropped_events == 0
    found = events(path)
    for number in range(4):
        assert [e[2] for e in found if e[0] == number + 1] == list(range(each))
        assert all(e[1] == number for e in found if e[0] == number + 1)


def test_many_chunks_keep_counting_the_channel(tmp_path):
    path = tmp_path / "a.mcap"
    sink = open_sink(path)
    for sequence in range(40_000):
        sink.record(1 + sequence % 2, 1, sequence, sequence)
    sink.close()
    numbers = {"/dds_trace/t1": 0, "/dds_trace/t2": 0}
    for topic, message in messages(path):
        if topic in numbers:
            assert message.sequence == numbers[topic]
            numbers[topic] += 1
    assert set(numbers.values()) == {20_000}


def test_a_closed_sink_counts_what_still_comes(tmp_path):
    sink = open_sink(tmp_path / "a.mcap")
    closed = sink.close()
    sink.record(1, 1, 0, 0)
    sink.write_run(run())
    assert sink.dropped_events == 1
    assert sink.close() is closed


def test_what_is_there_is_not_overwritten(tmp_path):
    path = tmp_path / "a.mcap"
    path.write_text("a trace of yesterday")
    with pytest.raises(OutputExistsError, match="--force"):
        open_sink(path)
    assert path.read_text() == "a trace of yesterday"
    open_sink(path, force=True).close()
    assert events(path) == []


def test_the_ring_of_a_killed_recorder_is_not_overwritten(tmp_path):
    ring_path(tmp_path / "a.mcap").write_text("events of yesterday")
    with pytest.raises(OutputExistsError, match="ring"):
        open_sink(tmp_path / "a.mcap")
    open_sink(tmp_path / "a.mcap", force=True).close()
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]


def test_links_are_refused_without_force_and_never_written_through(tmp_path):
    path, target = tmp_path / "a.mcap", tmp_path / "target"
    path.symlink_to(target)
    with pytest.raises(OutputExistsError, match="--force"):
        open_sink(path)
    assert path.is_symlink()
    target.write_text("mine")
    open_sink(path, force=True).close()
    assert target.read_text() == "mine"
    assert not path.is_symlink()


def test_a_folder_is_a_rosbag2_bag(tmp_path):
    folder = tmp_path / 'bag "of" today'
    sink = open_sink(folder)
    sink.write_run(run())
    for sequence in range(5):
        sink.record(3, 1, sequence, 1000 * sequence)
        sink.record(4, 1, sequence, 1000 * sequence + 1)
    closed = sink.close()
    assert closed.path == folder
    assert {p.name for p in folder.iterdir()} == {"metadata.yaml", f"{folder.name}_0.mcap"}
    with Reader(folder) as bag:
        assert (bag.message_count, bag.start_time) == (13, WALL_ANCHOR_NS)
        assert bag.duration == 4002
        assert {c.topic: c.msgcount for c in bag.connections} == {
            "/dds_trace/session": 2,
            "/dds_trace/run": 1,
            "/dds_trace/t3": 5,
            "/dds_trace/t4": 5,
        }
        assert len(list(bag.messages())) == 13
    with AnyReader([folder]) as bag:
        of_relay = [c for c in bag.connections if c.topic == "/dds_trace/t4"]
        read = [bag.deserialize(raw, c.msgtype) for c, _, raw in bag.messages(of_relay)]
    assert [(event.sequence, event.monotonic_ns) for event in read] == [(i, 1000 * i + 1) for i in range(5)]


def test_a_bag_without_events_opens(tmp_path):
    open_sink(tmp_path / "bag").close()
    with Reader(tmp_path / "bag") as bag:
        assert bag.message_count == 2


def test_force_takes_only_our_own_files_out_of_a_bag(tmp_path):
    folder = tmp_path / "bag"
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(OutputExistsError):
        open_sink(folder)
    open_sink(folder, force=True).close()
    assert (folder / "notes.txt").read_text() == "mine"
    with Reader(folder) as bag:
        assert bag.message_count == 2


def test_folders_above_are_made(tmp_path):
    open_sink(tmp_path / "runs" / "today" / "a.mcap").close()
    assert events(tmp_path / "runs" / "today" / "a.mcap") == []


def test_a_log_time_comes_from_the_anchor(tmp_path):
    session = replace(ping_session(state="open"), wall_anchor_ns=5_000_000, monotonic_anchor_ns=1_000_000)
    sink = TraceSink(TraceDestination(tmp_path / "a.mcap"), session, clock_ns=lambda: 1_000_000)
    sink.record(1, 1, 0, 1_000_250)
    sink.close()
    assert [m.log_time for t, m in messages(tmp_path / "a.mcap") if t == "/dds_trace/t1"] == [5_000_250]


def test_fsync_asks_the_disk_for_each_chunk(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr("os.fsync", asked.append)
    sink = open_sink(tmp_path / "a.mcap", fsync=True)
    before = len(asked)
    sink.write_run(run())
    assert len(asked) == before + 1
    sink.close()


def test_records_lie_as_other_tools_expect(tmp_path):
    sink = open_sink(tmp_path / "a.mcap")
    sink.record(1, 1, 0, 0)
    sink.close()
    with (tmp_path / "a.mcap").open("rb") as stream:
        kinds = [type(r) for r in StreamReader(stream, emit_chunks=True).records]
    chunks = [number for number, kind in enumerate(kinds) if kind is Chunk]
    assert all(kinds[number + 1] is MessageIndex for number in chunks)
    with (tmp_path / "a.mcap").open("rb") as stream:
        inside = [type(r) for r in StreamReader(stream).records if isinstance(r, Schema | Channel | Message)]
    assert inside[:9] == [Schema, Channel, Message] * 3
