import itertools
import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from event_cdr import pack_event
from hypothesis import given, settings
from hypothesis import strategies as st
from record_reader import FIELDS, all_rows, rows
from trace_files import (
    COMPRESSIONS,
    EVENT,
    RELAY_ID,
    RUN_ID,
    STRING,
    WALL_ANCHOR_NS,
    Message,
    RawMessage,
    event,
    ping_events,
    ping_session,
    relay_session,
    run,
    string_cdr,
    write_messages,
    write_pair,
    write_trace,
)

from dds_trace.base.errors import TraceFormatError
from dds_trace.tracefile.format.events import (
    EVENT_DTYPE,
    HOST_TOPIC,
    MOST_STAMP_NS,
    TAP_DEFINITION,
    TAP_SCHEMA_NAME,
    WIRE_TOPIC,
    EventColumns,
    Stage,
)
from dds_trace.tracefile.reading import mcap_source, mcap_walk, reader
from dds_trace.tracefile.reading.reader import iter_event_batches, read_trace, read_trace_in_pieces
from dds_trace.tracefile.reading.storage import open_source


def padded(events):
    return {stage: list(events.get(stage, [])) for stage in Stage}


def test_a_timeline_comes_back_column_by_column(tmp_path):
    # ping's clock   0 send (T0) . 5 T1 ............................ 250 T2
    # relay's clock                       7100 T3 .. 7130 T4
    # message 1: T0 1000, T1 1004, and nothing after.
    ping, relay = write_pair(tmp_path, [Message(0, t0=0, t1=5, t3=7100, t4=7130, t2=250), Message(1, t0=1000, t1=1004)])
    events = read_trace(ping).events
    assert events[Stage.T1].run_id.tolist() == [RUN_ID, RUN_ID]
    assert events[Stage.T1].sequence.tolist() == [0, 1]
    assert events[Stage.T1].monotonic_ns.tolist() == [5, 1004]
    assert events[Stage.T1].scheduled_ns.tolist() == [0, 1000]
    assert events[Stage.T1].payload_bytes.tolist() == [33_000, 33_000]
    assert events[Stage.T1].relay_id.tolist() == [0, 0]
    assert rows(events[Stage.T2]) == [(RUN_ID, 0, 250, 0, 0, 0, 33_000, RELAY_ID)]
    assert len(events[Stage.T3]) == len(events[Stage.T4]) == 0
    events = read_trace(relay).events
    assert rows(events[Stage.T3]) == [(RUN_ID, 0, 7100, 0, 0, 0, 33_000, RELAY_ID)]
    assert rows(events[Stage.T4]) == [(RUN_ID, 0, 7130, 0, 0, 0, 33_000, RELAY_ID)]


def test_columns_have_the_dtypes_of_the_format(tmp_path):
    ping, _ = write_pair(tmp_path, [Message(0, t1=5)])
    for columns in read_trace(ping).events.values():
        for name in FIELDS:
            assert getattr(columns, name).dtype == EVENT_DTYPE[name]
            assert getattr(columns, name).flags.c_contiguous


def test_a_whole_trace_has_nothing_to_remark(tmp_path):
    ping, _ = write_pair(tmp_path, [Message(0, t1=5)])
    trace = read_trace(ping)
    assert trace.path == ping
    assert (trace.truncated, trace.notes, trace.unreadable_messages, trace.ring_events) == (None, (), 0, 0)


MATRIX = [
    dict(zip(("compression", "chunked", "indexed", "statistics", "crcs", "chunk_bytes"), values, strict=True))
    for values in itertools.product(
        COMPRESSIONS,
        [True, False],
        [True, False],
        [True, False],
        [True, False],
        [300, 1 << 20],  # a chunk every three events, or one for all
    )
]


@pytest.mark.keeps(31)
@pytest.mark.parametrize("options", MATRIX, ids=lambda options: "-".join(map(str, options.values())))
@pytest.mark.parametrize("small_bytes", [-1, 1 << 19], ids=["threads", "one thread"])
def test_every_way_of_storing_gives_the_same_events(tmp_path, options, small_bytes, monkeypatch):
    monkeypatch.setattr(mcap_source, "_SMALL_FILE_BYTES", small_bytes)
    messages = [Message(n, t0=n * 1000, t1=n * 1000 + 7, t2=n * 1000 + 500 + n) for n in range(600)]
    events = ping_events(messages)
    path = write_trace(tmp_path / "trace.mcap", ping_session(), [run()], events, host=[{"cpu": 0.5}], **options)
    trace = read_trace(path)
    assert all_rows(trace) == padded(events)
    assert trace.sessions == (ping_session(),)
    assert trace.runs == (run(),)
    assert trace.host_samples == ({"cpu": 0.5, "log_time_ns": WALL_ANCHOR_NS},)
    assert (trace.truncated, trace.notes, trace.unreadable_messages) == (None, (), 0)


@pytest.mark.parametrize("indexed", [True, False])
def test_a_trace_without_events_is_a_trace(tmp_path, indexed):
    trace = read_trace(write_trace(tmp_path / "t.mcap", ping_session(), indexed=indexed))
    assert trace.event_count == 0
    assert set(trace.events) == set(Stage)
    assert trace.sessions == (ping_session(),)


U64, U32 = st.integers(0, 2**64 - 1), st.integers(0, 2**32 - 1)
STAMP = st.integers(-MOST_STAMP_NS, MOST_STAMP_NS)  # the others: tests/analyzer/test_values_are_no_sizes.py
SCHEMAS = {stage: (TAP_SCHEMA_NAME, TAP_DEFINITION) if stage is Stage.TAP else EVENT for stage in Stage}
any_event = st.tuples(U64, U64, STAMP, STAMP, STAMP, STAMP, U32, U32)
any_text = st.just((HOST_TOPIC, string_cdr('{"cpu": 1}'), STRING))
any_foreign = st.tuples(st.sampled_from(["/camera", "/tf"]), st.binary(max_size=200), st.just(("x/msg/X", "")))
any_message = st.one_of(
    *(
        st.tuples(st.just(stage.topic), any_event.map(lambda e: pack_event(*e)), st.just(SCHEMAS[stage]))
        for stage in Stage
    ),
    any_text,
    any_foreign,
)


@settings(max_examples=60)
@given(
    messages=st.lists(any_message, max_size=80),
    repeat=st.integers(1, 40),
    options=st.fixed_dictionaries(
        {
            "compression": st.sampled_from(list(COMPRESSIONS)),
            "chunked": st.booleans(),
            "indexed": st.booleans(),
            "chunk_bytes": st.sampled_from([200, 4000, 1 << 20]),
        }
    ),
)
def test_writing_then_reading_is_identity_for_any_mix_of_messages(tmp_path_factory, messages, repeat, options):
    session = RawMessage("/dds_trace/session", string_cdr(ping_session().to_json()), kind=STRING)
    held = [RawMessage(topic, data, kind=kind) for topic, data, kind in messages] * repeat
    path = write_messages(tmp_path_factory.mktemp("any") / "t.mcap", [session, *held], **options)
    trace = read_trace(path)
    packed = {stage: [pack_event(*row) for row in found] for stage, found in all_rows(trace).items()}
    assert packed == {stage: [m.data for m in held if m.topic == stage.topic] for stage in Stage}
    assert len(trace.host_samples) == sum(m.topic == HOST_TOPIC for m in held)
    assert (trace.unreadable_messages, trace.notes, trace.truncated) == (0, (), None)


@pytest.mark.keeps(1)
@pytest.mark.parametrize("compression", list(COMPRESSIONS))
def test_nothing_of_a_block_is_lost_when_its_memory_is_used_again(tmp_path, compression):
    messages = []
    for number in range(150_000):  # a dozen megabytes: several blocks, of several chunks each
        messages.append(RawMessage((Stage.T1, Stage.T2)[number % 2].topic, pack_event(7, number, -number)))
        if number % 100 == 0:
            text = json.dumps({"at": number, "x": "y" * (number % 37)})
            messages.append(RawMessage(HOST_TOPIC, string_cdr(text), kind=STRING))
    path = write_messages(tmp_path / "t.mcap", messages, compression=compression, chunk_bytes=700_000)
    trace = read_trace(path)
    assert [sample["at"] for sample in trace.host_samples] == list(range(0, 150_000, 100))
    for first, stage in enumerate((Stage.T1, Stage.T2)):
        columns = trace.events[stage]
        assert np.array_equal(columns.sequence, np.arange(first, 150_000, 2))
        assert np.array_equal(columns.monotonic_ns, -np.arange(first, 150_000, 2))
    assert trace.notes == ()


@settings(max_examples=20)
@given(events=st.lists(any_event, max_size=300), chunk_bytes=st.sampled_from([300, 5000, 1 << 20]))
def test_batches_are_the_trace_in_pieces(tmp_path_factory, events, chunk_bytes):
    path = write_trace(
        tmp_path_factory.mktemp("b") / "t.mcap",
        ping_session(),
        events={Stage.T1: events[::2], Stage.T2: events[1::2]},
        chunk_bytes=chunk_bytes,
    )
    parts = {stage: [] for stage in Stage}
    for stage, columns in iter_event_batches(path):
        parts[stage].append(columns)
    joined = {stage: rows(EventColumns.concatenate(held)) for stage, held in parts.items()}
    assert joined == all_rows(read_trace(path))


@pytest.mark.parametrize("name", ["t.mcap", "broken.mcap"])
def test_a_trace_in_pieces_is_the_whole_trace(tmp_path, monkeypatch, name):
    events = [event(n, n * n, scheduled_ns=n) for n in range(200)]
    path = write_trace(
        tmp_path / name,
        [ping_session(), ping_session(state="closed")],
        [run()],
        {Stage.T1: events[:150], Stage.T2: events[150:]},
        host=[{"cpu": 1}],
        chunk_bytes=2000,
        truncate_at=16_000 if name == "broken.mcap" else None,
        compression="none",
    )
    monkeypatch.setattr(reader, "PIECE_EVENTS", 50)
    monkeypatch.setattr(mcap_walk, "_BLOCK_CHUNKS", 1)
    whole, pieces = read_trace(path), []
    trace = read_trace_in_pieces(path, pieces.append)
    assert all(0 < sum(map(len, piece.values())) <= 50 for piece in pieces)
    assert len(pieces) >= whole.event_count / 50 > 2
    assert repr(trace) == repr(replace(whole, events={}))
    joined = {stage: rows(EventColumns.concatenate(piece[stage] for piece in pieces)) for stage in Stage}
    assert joined == all_rows(whole)


def test_a_piece_is_read_into_the_memory_of_one_that_is_gone(tmp_path, monkeypatch):
    # Not of one that somebody still has: see the test above, which keeps all.
    events = [event(n, n, scheduled_ns=n) for n in range(2000)]
    path = write_trace(tmp_path / "t.mcap", ping_session(), [run()], {Stage.T1: events}, chunk_bytes=2000)
    monkeypatch.setattr(reader, "PIECE_EVENTS", 50)
    monkeypatch.setattr(mcap_walk, "_BLOCK_CHUNKS", 1)
    places: list[int] = []

    def take(piece):
        places.append(piece[Stage.T1].monotonic_ns.ctypes.data)

    read_trace_in_pieces(path, take)
    assert len(places) >= 40
    assert len(set(places)) <= 2  # the next one's is taken before the last one's is free


def test_a_trace_without_events_is_one_empty_piece(tmp_path):
    pieces = []
    read_trace_in_pieces(write_trace(tmp_path / "t.mcap", ping_session()), pieces.append)
    assert [set(map(len, piece.values())) for piece in pieces] == [{0}]


class TestDescriptions:
    def test_the_latest_description_of_each_wins_in_order_of_first_appearance(self, tmp_path):
        sessions = [ping_session(state="open"), relay_session(), ping_session(state="closed", dropped_events=3)]
        runs = [run(run_id=7, state="started"), run(run_id=5), run(run_id=7, state="finished", published=4)]
        trace = read_trace(write_trace(tmp_path / "t.mcap", sessions, runs))
        assert trace.sessions == (sessions[2], sessions[1])
        assert trace.runs == (runs[2], runs[1])

    def test_the_statistics_tell_how_many_events_to_expect(self, tmp_path):
        events = ping_events([Message(0, t1=1, t2=2), Message(1, t1=3)])
        path = write_trace(tmp_path / "t.mcap", ping_session(), events=events)
        with ThreadPoolExecutor(1) as pool, open_source(path, pool) as source:
            assert source.expected_events() == {Stage.T1: 2, Stage.T2: 1}

    @pytest.mark.parametrize("missing", ["session_id", "device", "wall_anchor_ns"])
    def test_a_missing_field_is_an_error_that_names_file_place_and_field(self, tmp_path, missing):
        fields = json.loads(ping_session().to_json())
        del fields[missing]
        text = RawMessage("/dds_trace/session", string_cdr(json.dumps(fields)), kind=STRING)
        path = write_messages(tmp_path / "t.mcap", [text])
        with pytest.raises(TraceFormatError, match=f"t.mcap at byte .*'{missing}'") as caught:
            read_trace(path)
        assert caught.value.offset is not None

    def test_a_big_endian_string_is_read_too(self, tmp_path):
        text = ping_session().to_json().encode() + b"\0"
        data = b"\x00\x00\x00\x00" + len(text).to_bytes(4, "big") + text
        path = write_messages(tmp_path / "t.mcap", [RawMessage("/dds_trace/session", data, kind=STRING)])
        assert read_trace(path).sessions == (ping_session(),)

    @pytest.mark.parametrize(
        "data", [b"", b"\x00\x01\x00\x00", string_cdr("{}")[:-1], b"\x00\x01\x00\x00\x00\x00\x00\x00"]
    )
    def test_a_session_that_is_no_string_is_an_error(self, tmp_path, data):
        path = write_messages(tmp_path / "t.mcap", [RawMessage("/dds_trace/session", data, kind=STRING)])
        with pytest.raises(TraceFormatError, match="no serialized std_msgs/msg/String"):
            read_trace(path)

    @pytest.mark.parametrize("chunked", [True, False])
    def test_a_text_as_long_as_an_event_is_still_a_text(self, tmp_path, chunked):
        texts = [json.dumps({"cpu": n, "x": "y" * (29 + n)}) for n in range(10)]
        messages = [RawMessage(HOST_TOPIC, string_cdr(text), kind=STRING) for text in texts]
        lengths = [len(message.data) for message in messages]
        assert 60 in lengths
        assert lengths[0] < 60 < lengths[-1]
        messages.insert(5, RawMessage(Stage.T1.topic, pack_event(1, 2, 3)))
        trace = read_trace(write_messages(tmp_path / "t.mcap", messages, chunked=chunked))
        assert [sample["cpu"] for sample in trace.host_samples] == list(range(10))
        assert rows(trace.events[Stage.T1]) == [(1, 2, 3, 0, 0, 0, 0, 0)]
        assert trace.notes == ()

    def test_host_samples_that_are_no_objects_are_noted(self, tmp_path, sentences):
        texts = ["[1]", "nonsense", "[" * 100_000, '{"cpu": 2}']
        messages = [RawMessage(HOST_TOPIC, string_cdr(text), kind=STRING) for text in texts]
        trace = read_trace(write_messages(tmp_path / "t.mcap", messages))
        assert trace.host_samples == ({"cpu": 2, "log_time_ns": WALL_ANCHOR_NS},)
        sentences(*trace.notes)

    def test_texts_about_the_wire_are_kept_and_those_that_are_no_objects_noted(self, tmp_path, sentences):
        texts = ['{"run_id": "0000000000000011", "rows": ""}', "[1]"]
        messages = [RawMessage(WIRE_TOPIC, string_cdr(text), kind=STRING) for text in texts]
        trace = read_trace(write_messages(tmp_path / "t.mcap", messages))
        assert trace.wire == ({"run_id": "0000000000000011", "rows": ""},)
        sentences(*trace.notes)


class TestMessagesThatAreNoEvents:
    GOOD = pack_event(1, 2, 3)
    BAD = (
        b"\x00\x00" + pack_event(1, 2, 3)[2:],  # big-endian CDR
        pack_event(1, 2, 3)[:-1],
        pack_event(1, 2, 3) + b"\0",
        b"",
    )

    @pytest.mark.parametrize("chunked", [True, False])
    @pytest.mark.parametrize("bad", BAD)
    def test_they_are_counted_and_never_used_as_numbers(self, tmp_path, bad, chunked):
        messages = [RawMessage(Stage.T1.topic, data) for data in (self.GOOD, bad, self.GOOD, self.GOOD, bad)]
        trace = read_trace(write_messages(tmp_path / "t.mcap", messages, chunked=chunked))
        assert rows(trace.events[Stage.T1]) == [(1, 2, 3, 0, 0, 0, 0, 0)] * 3
        assert trace.unreadable_messages == 2

    def test_another_schema_on_an_event_topic_is_named(self, tmp_path, sentences):
        kind = ("other_msgs/msg/TraceEvent", "uint64 x\n")
        trace = read_trace(write_messages(tmp_path / "t.mcap", [RawMessage(Stage.T3.topic, self.GOOD, kind=kind)] * 4))
        assert (trace.event_count, trace.unreadable_messages) == (0, 4)
        sentences(*trace.notes)

    def test_another_encoding_on_an_event_topic_is_named(self, tmp_path):
        trace = read_trace(
            write_messages(tmp_path / "t.mcap", [RawMessage(Stage.T3.topic, self.GOOD, encoding="json")])
        )
        assert (trace.event_count, trace.unreadable_messages) == (0, 1)
        assert "encoded as 'json'" in trace.notes[0]

    def test_a_long_run_of_events_is_cut_exactly_where_it_ends(self, tmp_path):
        good = [RawMessage(Stage.T1.topic, pack_event(1, n, n)) for n in range(3000)]
        for cut in (0, 1, 15, 16, 17, 271, 272, 273, 1296, 2999):
            messages = [*good[:cut], RawMessage(Stage.T1.topic, b"\0" * 60), *good[cut:]]
            trace = read_trace(write_messages(tmp_path / f"{cut}.mcap", messages))
            assert trace.events[Stage.T1].sequence.tolist() == list(range(3000))
            assert trace.unreadable_messages == 1


class TestNoTrace:
    def test_a_file_of_another_kind(self, tmp_path):
        path = tmp_path / "t.mcap"
        path.write_bytes(b"SQLite format 3\0" * 10)
        with pytest.raises(TraceFormatError, match="not a MCAP file") as caught:
            read_trace(path)
        assert (caught.value.path, caught.value.offset) == (str(path), 0)

    def test_a_bag_of_other_topics(self, tmp_path):
        path = write_messages(tmp_path / "t.mcap", [RawMessage("/camera", b"123", kind=("x/msg/X", ""))])
        with pytest.raises(TraceFormatError, match=r"no topic /dds_trace/.*its topics: /camera"):
            read_trace(path)
        with pytest.raises(TraceFormatError, match="no topic /dds_trace/"):
            list(iter_event_batches(path))

    def test_a_bag_of_other_topics_is_not_unpacked_where_its_summary_says_so(self, tmp_path, monkeypatch):
        path = write_messages(tmp_path / "t.mcap", [RawMessage("/camera", b"123", kind=("x/msg/X", ""))])
        monkeypatch.setattr("dds_trace.tracefile.mcapfile.chunks.PackedChunk.unpack", None)
        with pytest.raises(TraceFormatError, match="its topics: /camera"):
            read_trace(path)

    def test_a_closed_file_without_any_topic(self, tmp_path):
        with pytest.raises(TraceFormatError, match="no topic"):
            read_trace(write_messages(tmp_path / "t.mcap", []))

    def test_nothing_there(self, tmp_path):
        with pytest.raises(TraceFormatError, match=r"No such file"):
            read_trace(tmp_path / "t.mcap")

    def test_a_folder_without_storage(self, tmp_path):
        (tmp_path / "metadata.yaml").write_text("")
        with pytest.raises(TraceFormatError, match=r"no \.mcap or .db3 file"):
            read_trace(tmp_path)


def test_many_channels_in_one_chunk_are_told_apart(tmp_path):
    stages = [stage for stage in Stage if stage is not Stage.TAP]  # of one schema
    topics = [f"/other/{n}" for n in range(20)] + [stage.topic for stage in stages]
    picks = np.random.default_rng(1).integers(0, len(topics), 2000)
    messages = [RawMessage(topics[pick], pack_event(1, n, n)) for n, pick in enumerate(picks)]
    trace = read_trace(write_messages(tmp_path / "t.mcap", messages))
    for number, stage in enumerate(stages, start=20):
        assert trace.events[stage].sequence.tolist() == np.flatnonzero(picks == number).tolist()


def test_one_event_helper_matches_the_format(tmp_path):
    path = write_trace(tmp_path / "t.mcap", relay_session(), events={Stage.T4: [event(4, 44, relay_id=9, source_ns=5)]})
    assert rows(read_trace(path).events[Stage.T4]) == [(RUN_ID, 4, 44, 0, 5, 0, 33_000, 9)]
