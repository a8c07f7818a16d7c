"""rosbag2 folders, written with the public `rosbags` package, analyze to the same trace as the file they came from."""

import base64
import itertools
import resource
import shutil
import sqlite3
import tempfile
import zlib
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import pytest
import zstandard
from event_cdr import pack_event
from record_reader import all_rows, rows
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from trace_files import EVENT, STRING, WALL_ANCHOR_NS, Message, ping_events, ping_session, run, string_cdr, write_trace

from dds_trace.base.errors import MissingEventsError, OutputError, TraceFormatError
from dds_trace.tracefile.format.events import HOST_TOPIC, RUN_TOPIC, SESSION_TOPIC, Stage
from dds_trace.tracefile.reading import storage
from dds_trace.tracefile.reading.reader import iter_event_batches, read_trace
from dds_trace.tracefile.reading.storage import find_traces, open_source, storage_files

EVENTS = ping_events([Message(n, t0=n * 1000, t1=n * 1000 + 7, t2=n * 1000 + 500) for n in range(50)])
STORAGES = [
    pytest.param(plugin, mode, id=f"{plugin.name}-{mode.name}".lower())
    for plugin, mode in itertools.product(
        StoragePlugin, [CompressionMode.NONE, CompressionMode.FILE, CompressionMode.MESSAGE]
    )
] + [pytest.param(StoragePlugin.MCAP, CompressionMode.STORAGE, id="mcap-storage")]


def write_bag(folder, events=EVENTS, plugin=StoragePlugin.SQLITE3, mode=CompressionMode.NONE, version=9):
    """A bag as a converter makes it of our trace: the same topics, messages in order of their log time."""
    texts = [(SESSION_TOPIC, ping_session().to_json()), (RUN_TOPIC, run().to_json()), (HOST_TOPIC, '{"cpu": 1}')]
    messages = [(topic, WALL_ANCHOR_NS, string_cdr(text), STRING) for topic, text in texts]
    for stage, held in events.items():
        messages += [(stage.topic, WALL_ANCHOR_NS + fields[2], pack_event(*fields), EVENT) for fields in held]
    bag = Writer(folder, version=version, storage_plugin=plugin)
    bag.set_compression(mode, CompressionFormat.ZSTD)
    with bag:
        connections = {}
        for topic, log_time, data, (name, definition) in sorted(messages, key=lambda message: message[1]):
            if topic not in connections:
                connections[topic] = bag.add_connection(
                    topic, name, msgdef=definition, rihs01=type_hash(name, definition)
                )
            bag.write(connections[topic], log_time, data)
    return folder


def type_hash(name, definition):
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition, name))
    return store.hash_rihs01(name)


@pytest.mark.parametrize(("plugin", "mode"), STORAGES)
def test_every_storage_gives_the_same_trace(tmp_path, plugin, mode):
    original = read_trace(write_trace(tmp_path / "t.mcap", ping_session(), [run()], EVENTS, host=[{"cpu": 1}]))
    trace = read_trace(write_bag(tmp_path / "bag", plugin=plugin, mode=mode))
    assert all_rows(trace) == all_rows(original)
    assert (trace.sessions, trace.runs) == (original.sessions, original.runs)
    assert trace.host_samples == original.host_samples
    assert (trace.truncated, trace.notes, trace.unreadable_messages) == (None, (), 0)


@pytest.mark.parametrize(("plugin", "mode"), STORAGES)
def test_every_storage_can_be_read_in_batches(tmp_path, plugin, mode):
    bag = write_bag(tmp_path / "bag", plugin=plugin, mode=mode)
    found, expected = dict.fromkeys(Stage, 0), Counter()
    for stage, columns in iter_event_batches(bag):
        found[stage] += len(columns)
    assert found == {Stage.T1: 50, Stage.T2: 50, Stage.T3: 0, Stage.T4: 0, Stage.TAP: 0}
    with ThreadPoolExecutor(1) as pool:
        for file in storage_files(bag):
            with open_source(file, pool) as source:
                expected.update(source.expected_events())
    assert all(expected[stage] >= count for stage, count in found.items())


def test_what_rosbags_reads_of_a_bag_is_what_we_read(tmp_path):
    bag = write_bag(tmp_path / "bag")
    with Reader(bag) as reader:
        theirs = [
            (connection.topic, bytes(data))
            for connection, _, data in reader.messages()
            if connection.topic.startswith("/dds_trace/t")
        ]
    ours = read_trace(bag).events
    for stage in (Stage.T1, Stage.T2):
        packed = [pack_event(*row) for row in rows(ours[stage])]
        assert packed == [data for topic, data in theirs if topic == stage.topic]


@pytest.mark.parametrize("plugin", StoragePlugin)
def test_a_split_bag_is_one_trace_in_the_order_of_its_numbers(tmp_path, plugin):
    suffix = {StoragePlugin.SQLITE3: ".db3", StoragePlugin.MCAP: ".mcap"}[plugin]
    bag = tmp_path / "bag"
    bag.mkdir()
    for number in range(12):  # bag_10 comes after bag_9, not after bag_1
        part = {stage: held[number * 4 : number * 4 + 4] for stage, held in EVENTS.items()}
        written = write_bag(tmp_path / f"part{number}", part, plugin)
        shutil.move(written / f"part{number}{suffix}", bag / f"bag_{number}{suffix}")
        shutil.move(written / "metadata.yaml", bag / "metadata.yaml")
    trace = read_trace(bag)
    assert all_rows(trace) == {stage: EVENTS.get(stage, [])[:48] for stage in Stage}
    assert len(trace.sessions) == len(trace.runs) == 1
    assert len(trace.host_samples) == 12


def test_the_part_that_ends_early_is_named(tmp_path):
    bag = write_bag(tmp_path / "bag", plugin=StoragePlugin.MCAP)
    (part,) = bag.glob("*.mcap")
    shutil.copy(part, bag / "bag_1.mcap")
    part.rename(bag / "bag_0.mcap")
    whole = (bag / "bag_1.mcap").read_bytes()
    (bag / "bag_1.mcap").write_bytes(whole[:-100])
    assert read_trace(bag).truncated.startswith("bag_1.mcap: ends early, byte ")


def test_a_file_that_a_player_unpacked_beside_the_packed_one_counts_once(tmp_path):
    bag = write_bag(tmp_path / "bag", mode=CompressionMode.FILE)
    (packed,) = bag.glob("*.zstd")
    with packed.open("rb") as stream, packed.with_suffix("").open("wb") as copy:
        zstandard.ZstdDecompressor().copy_stream(stream, copy)
    assert read_trace(bag).event_count == 100


def test_bags_are_found_as_one_entry(tmp_path):
    write_bag(tmp_path / "a")
    write_bag(tmp_path / "b", plugin=StoragePlugin.MCAP)
    write_bag(tmp_path / "c", mode=CompressionMode.FILE)
    assert find_traces(tmp_path) == [tmp_path / "a", tmp_path / "b", tmp_path / "c"]


class TestDatabases:
    def database(self, tmp_path):
        (path,) = write_bag(tmp_path / "bag").glob("*.db3")
        return path

    def change(self, path, *statements):
        connection = sqlite3.connect(path)
        with connection:
            for statement in statements:
                connection.execute(statement)
        connection.close()

    @pytest.mark.parametrize(
        ("statement", "note"),
        [
            ("UPDATE topics SET serialization_format = 'json' WHERE name = '/dds_trace/t1'", "encoded as 'json'"),
            ("UPDATE topics SET type = 'x/msg/X' WHERE name = '/dds_trace/t1'", "its schema is 'x/msg/X'"),
        ],
    )
    def test_event_topics_of_another_kind_are_named_and_not_used(self, tmp_path, statement, note):
        path = self.database(tmp_path)
        self.change(path, statement)
        trace = read_trace(path.parent)
        assert len(trace.events[Stage.T1]) in {0, 50}  # the page of the former table is still there
        assert len(trace.events[Stage.T2]) == 50
        assert trace.unreadable_messages == 50
        assert note in trace.notes[0]

    def test_rows_that_rosbag2_never_writes_are_unreadable(self, tmp_path):
        path = self.database(tmp_path)
        t1 = "(SELECT id FROM topics WHERE name = '/dds_trace/t1')"
        self.change(
            path,
            f"INSERT INTO messages (topic_id, timestamp, data) VALUES ({t1}, 'now', x'00')",
            f"INSERT INTO messages (topic_id, timestamp, data) VALUES ({t1}, 5, 'text')",
            f"INSERT INTO messages (topic_id, timestamp, data) VALUES ({t1}, 5, zeroblob(100000000))",
        )
        trace = read_trace(path.parent)
        assert (trace.event_count, trace.unreadable_messages) == (100, 3)

    @pytest.mark.parametrize("topic_id", ["NULL", "'x'", "1.5", "x'00'"])
    def test_topics_without_a_number_are_passed_over(self, tmp_path, topic_id):  # a find of fuzzing
        path = self.database(tmp_path)
        self.change(
            path,
            "CREATE TABLE kept AS SELECT * FROM topics",
            "DROP TABLE topics",
            "CREATE TABLE topics (id, name, type, serialization_format)",
            "INSERT INTO topics SELECT id, name, type, serialization_format FROM kept",
            f"UPDATE topics SET id = {topic_id} WHERE name = '/dds_trace/t1'",
        )
        trace = read_trace(path.parent)
        assert len(trace.events[Stage.T1]) in {0, 50}  # the page of the former table is still there
        assert len(trace.events[Stage.T2]) == 50

    def test_a_bag_of_other_topics_is_no_trace(self, tmp_path):
        path = self.database(tmp_path)
        self.change(path, "UPDATE topics SET name = '/x' || name")
        with pytest.raises(TraceFormatError, match="no topic /dds_trace"):
            read_trace(path.parent)

    def test_a_file_that_is_no_database(self, tmp_path):
        path = self.database(tmp_path)
        path.write_bytes(b"nonsense" * 1000)
        with pytest.raises(TraceFormatError, match="not a rosbag2 database") as caught:
            read_trace(path.parent)
        assert caught.value.path == str(path)


class TestPackedFiles:
    @pytest.mark.parametrize("plugin", StoragePlugin)
    def test_a_packed_file_that_is_cut_off_gives_what_could_be_unpacked_or_an_error(self, tmp_path, plugin):
        bag = write_bag(tmp_path / "bag", plugin=plugin, mode=CompressionMode.FILE)
        (path,) = bag.glob("*.zstd")
        whole = path.read_bytes()
        for size in range(0, len(whole), 101):
            path.write_bytes(whole[:size])
            try:
                trace = read_trace(bag)
            except TraceFormatError as err:
                assert str(path) in str(err)  # noqa: PT017 - one or the other is right
            else:
                assert trace.truncated

    def test_a_frame_that_grows_without_end_does_not_fill_the_disk(self, tmp_path):
        bag = write_bag(tmp_path / "bag", plugin=StoragePlugin.MCAP, mode=CompressionMode.FILE)
        (path,) = bag.glob("*.zstd")
        path.write_bytes(zstandard.compress(bytes(200_000_000)))
        with pytest.raises(TraceFormatError, match="unpacks to more than 1000 times its size"):
            read_trace(bag)

    @pytest.mark.parametrize("plugin", StoragePlugin)
    @pytest.mark.parametrize("is_known", [True, False], ids=["size known", "size unknown"])
    def test_room_is_asked_before_a_file_is_unpacked(self, tmp_path, plugin, is_known, monkeypatch):
        bag = write_bag(tmp_path / "bag", plugin=plugin, mode=CompressionMode.FILE)
        (path,) = bag.glob("*.zstd")
        plain = zstandard.ZstdDecompressor().decompress(path.read_bytes(), 1 << 24)
        path.write_bytes(zstandard.ZstdCompressor(write_content_size=is_known).compress(plain))
        if is_known:
            monkeypatch.setattr(storage.shutil, "disk_usage", lambda _: SimpleNamespace(free=len(plain) - 1))
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
        monkeypatch.setattr(tempfile, "tempdir", None)
        (tmp_path / "temporary").mkdir()
        resource.setrlimit(resource.RLIMIT_FSIZE, (before[0] if is_known else len(plain) // 2, before[1]))
        try:
            with pytest.raises(OutputError, match="TMPDIR") as caught:
                read_trace(bag)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        assert str(tmp_path / "temporary") in str(caught.value)
        assert caught.value.exit_code == 6
        assert not list((tmp_path / "temporary").iterdir())


def test_files_and_bags_are_found_below_and_sorted(tmp_path):
    for name in ("b.mcap", "a/z.mcap", "bag/bag_0.mcap", "bag/metadata.yaml", "a/old/old_0.db3", "a/old/metadata.yaml"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("")
    (tmp_path / "notes.txt").write_text("")
    (tmp_path / "b.mcap.ring").write_text("")
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / "metadata.yaml").write_text("")
    found = [str(path.relative_to(tmp_path)) for path in find_traces(tmp_path)]
    assert found == ["a/old", "a/z.mcap", "b.mcap", "bag"]


def test_skipped_folders_and_files_are_left_out(tmp_path):
    for name in ("keep.mcap", "drop.mcap", "analysis/own.mcap"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("")
    (tmp_path / "again.mcap").symlink_to(tmp_path / "drop.mcap")
    (tmp_path / "by_a_link").symlink_to(tmp_path, target_is_directory=True)
    skip = [tmp_path / "analysis", tmp_path / "x" / ".." / "drop.mcap"]
    assert find_traces(tmp_path / "by_a_link", skip=skip) == [tmp_path / "by_a_link" / "keep.mcap"]
    assert find_traces(tmp_path, skip=skip) == [tmp_path / "keep.mcap"]
    (tmp_path / "loop.mcap").symlink_to("loop.mcap")
    loops = [tmp_path / "loop.mcap" / "analysis", tmp_path / "loop.mcap"]
    assert find_traces(tmp_path, skip=[*skip, *loops]) == [tmp_path / "keep.mcap"]
    with pytest.raises(MissingEventsError, match="no such file or folder"):
        find_traces(tmp_path / "loop.mcap", skip=loops)


def test_a_trace_is_found_in_itself_and_nothing_nowhere(tmp_path):
    (tmp_path / "x.mcap").write_text("")
    assert find_traces(tmp_path / "x.mcap") == [tmp_path / "x.mcap"]
    (tmp_path / "metadata.yaml").write_text("")
    assert find_traces(tmp_path) == [tmp_path]
    with pytest.raises(MissingEventsError, match="nowhere"):
        find_traces(tmp_path / "nowhere")


DATABASES = {
    # SQLite meets an absurd size in the schema and Python's sqlite3 says MemoryError.
    "memory": (
        "c-rmN&5qJg6bJBg`bmNEX)>7w@$M8e5yyD}fi#ne_=Rj{MGCE?nJEz3Ow=7u;UgHIK_9_KF)rP>&|41G%T3G;i7rMxq4(c5?"
        "eF&X()RhYL6nB<#bOovDLVlT5a9u10HE{5f}f@F#Spd;)TP7SDZ1Iocn9zeZ?0`!X!b#?h3j_ePcFkaOcH+<Cg1*K<(=sLq1"
        "PRGY}D-yJeKcex1)faJsx?d-jF>Vo;~Ug&)Gxo{D`HCWi%Z}0bh&w(WxIVk67TRKI;vh^x8AD4-OCWk!%i5sMU5lqJ6*aX70"
        "x!@8Z>xw@J8){LARIpGJ%MnEp=fY~m3=0{{K5YhL%!gj=W0P7oyHbmdROPH_BVeH<sVq{ExeDBJX|!g)FkR_5lx|B{_<;a6J"
        "uhim)7wEzB*nw9KZVY{2r-UR%BFYyFE!#fE0W?p^U0teTImED>AYhp>Ms=h^tDI%tnO2j0@5D`O4C1Mbwi-<0z6443KL`0KP"
        "RXvR(&U$AwxW`v}V<0yQyT-mn^WOq|k5_mPKEYd<@XhT=D>PD9?7@{%dAnRf$|6#hQi+raDTzo)N+nVvq$naqDV0c(5JyBDD"
        "V2yrNI^sjQYw)GA-0Ivu-_ZZ-8{z=n*ZbN{QuVK-=NEEikI1xQi(JPX^2QeN+r@Dq%I<LDV0c_keZ0pq*Nj`LaHKCl~RdR38"
        "{!kMM_nD2RK^ZNd"
    )
}


@pytest.mark.parametrize("packed", DATABASES.values(), ids=list(DATABASES))
def test_a_damaged_database_is_a_trace_or_an_error_that_names_it(tmp_path, packed):
    (tmp_path / "metadata.yaml").write_text("")
    path = tmp_path / "bag_0.db3"
    path.write_bytes(zlib.decompress(base64.b85decode(packed)))
    try:
        trace = read_trace(tmp_path)
    except TraceFormatError as err:
        assert str(tmp_path) in str(err)  # noqa: PT017 - one or the other is right
    else:
        assert trace.event_count <= 20
