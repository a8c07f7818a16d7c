import itertools
import resource
import struct
import subprocess
import sys

import pytest
from mcap.opcode import Opcode
from record_reader import rows
from trace_files import (
    STRING,
    Message,
    RawMessage,
    ping_events,
    ping_session,
    run,
    string_cdr,
    write_messages,
    write_trace,
)

from dds_trace.base.errors import TraceFormatError
from dds_trace.tracefile.format.encoding import MAGIC
from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.mcapfile.file import RecordFile
from dds_trace.tracefile.reading import mcap_source
from dds_trace.tracefile.reading.reader import read_trace

MESSAGES = [Message(n, t0=n * 1000, t1=n * 1000 + 7, t2=n * 1000 + 500) for n in range(12)]
EVENTS = ping_events(MESSAGES)
SHAPES = [
    {"compression": compression, "chunked": chunked, "indexed": indexed}
    for compression, chunked, indexed in itertools.product(["zstd", "lz4", "none"], [True, False], [True, False])
    if chunked or compression == "none"
]
shapes = pytest.mark.parametrize("options", SHAPES, ids=lambda options: "-".join(map(str, options.values())))


@pytest.fixture(autouse=True)
def in_threads(monkeypatch):
    """Small as these files are, they are read as large ones: by several threads."""
    monkeypatch.setattr(mcap_source, "_SMALL_FILE_BYTES", -1)


def small_trace(folder, **options):
    return write_trace(
        folder / "t.mcap", ping_session(), [run()], EVENTS, host=[{"cpu": 1}], chunk_bytes=400, **options
    )


def record_ends(path):
    ends, at = [], len(MAGIC)
    with RecordFile(path) as file:
        while not ends or ends[-1][0] != Opcode.FOOTER:
            header = file.header_at(at)
            at = header.end
            ends.append((header.opcode, at))
    return ends


def chunk_starts(path):
    pairs = itertools.pairwise(record_ends(path))
    return [start for (_, start), (opcode, _) in pairs if opcode == Opcode.CHUNK]


def write_number(path, offset, number):
    data = bytearray(path.read_bytes())
    struct.pack_into("<Q", data, offset, number)
    path.write_bytes(data)


def assert_no_wrong_event(trace):
    for stage in Stage:
        assert set(rows(trace.events[stage])) <= set(EVENTS.get(stage, []))


class TestTruncated:
    @shapes
    def test_anywhere_all_that_was_complete_before_is_used(self, tmp_path, options):
        whole = small_trace(tmp_path, **options).read_bytes()
        carriers = [end for opcode, end in record_ends(tmp_path / "t.mcap") if opcode in {Opcode.CHUNK, Opcode.MESSAGE}]
        cut = tmp_path / "cut.mcap"
        before = -1
        # Every record's end, and between those steps that meet each part of a record.
        every = range(0, len(whole), 3 if options == SHAPES[0] else 13)
        for size in sorted({*every, *carriers}):
            cut.write_bytes(whole[:size])
            trace = read_trace(cut)
            assert trace.truncated
            assert trace.notes == ()
            for stage in Stage:
                held = rows(trace.events[stage])
                assert held == EVENTS.get(stage, [])[: len(held)]
            assert trace.event_count >= before
            if size in carriers:  # a chunk or a message more than before, and all that is in it
                complete = carriers.index(size) + 1
                assert trace.event_count >= complete - 4  # session, run, host sample, and none for this record
            before = trace.event_count
        assert before == sum(map(len, EVENTS.values()))

    def test_the_reason_names_the_record_and_the_byte(self, tmp_path, sentences):
        path = small_trace(tmp_path)
        (_, start), (_, end) = record_ends(path)[:2]
        path.write_bytes(path.read_bytes()[: end - 3])
        sentences(read_trace(path).truncated.replace(f"byte {start}:", "byte START:"))

    def test_an_empty_file_is_a_trace_that_ended_before_it_began(self, tmp_path):
        path = tmp_path / "t.mcap"
        path.write_bytes(b"")
        trace = read_trace(path)
        assert (trace.event_count, trace.sessions) == (0, ())
        assert trace.truncated

    def test_zeros_behind_a_power_failure_are_no_records(self, tmp_path):
        path = small_trace(tmp_path, truncate_at=-300)
        events = read_trace(path).event_count
        with path.open("ab") as stream:
            stream.write(bytes(5000))
        trace = read_trace(path)
        assert trace.event_count == events
        assert trace.truncated

    def test_a_file_whose_closing_magic_is_gone_has_all_its_records(self, tmp_path):
        trace = read_trace(small_trace(tmp_path, truncate_at=-1))
        assert trace.event_count == 24
        assert "closing magic" in trace.truncated

    def test_bytes_behind_the_end_are_noted(self, tmp_path, sentences):
        path = small_trace(tmp_path)
        size = path.stat().st_size
        path.write_bytes(path.read_bytes() * 2)
        trace = read_trace(path)
        assert trace.event_count == 24
        sentences(*(note.replace(f" {size} ", " SIZE ") for note in trace.notes))


class TestDamaged:
    @pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
    def test_a_chunk_with_a_flipped_bit_is_named_and_left_out(self, tmp_path, compression):
        path = small_trace(tmp_path, compression=compression)
        with RecordFile(path) as file:
            headers, at = [], len(MAGIC)
            while not headers or headers[-1].opcode != Opcode.DATA_END:
                headers.append(file.header_at(at))
                at = headers[-1].end
        chunks = [header for header in headers if header.opcode == Opcode.CHUNK]
        data = bytearray(path.read_bytes())
        data[chunks[4].end - 20] ^= 0x10
        path.write_bytes(data)
        trace = read_trace(path)
        assert f"the chunk at byte {chunks[4].offset} is damaged and left out" in trace.notes[0]
        assert 0 < trace.event_count < 24
        lost = 24 - trace.event_count
        claimed = [note for note in trace.notes if "the statistics claim" in note]
        assert claimed
        assert lost <= 5
        assert_no_wrong_event(trace)

    @pytest.mark.parametrize("indexed", [True, False])
    def test_behind_a_damaged_record_reading_goes_on_at_the_next_chunk(self, tmp_path, indexed):
        path = small_trace(tmp_path, indexed=indexed)
        start = chunk_starts(path)[-2]
        write_number(path, start + 1, 1 << 60)  # the chunk's length: its fields have it, too
        assert read_trace(path).event_count == 24
        data = bytearray(path.read_bytes())
        data[start] = 0
        path.write_bytes(data)
        trace = read_trace(path)
        assert trace.notes[0].startswith(f"at byte {start}: ")
        assert 24 - 5 <= trace.event_count < 24

    @pytest.mark.parametrize("compression", ["zstd", "none"])
    def test_no_flipped_byte_anywhere_makes_a_wrong_event(self, tmp_path, compression):
        whole = small_trace(tmp_path, compression=compression).read_bytes()
        damaged = tmp_path / "damaged.mcap"
        unnamed = []
        for position in range(0, len(whole), 3 if compression == "zstd" else 7):
            data = bytearray(whole)
            data[position] ^= 0xFF
            damaged.write_bytes(data)
            try:
                trace = read_trace(damaged)
            except TraceFormatError as err:
                named = str(damaged) in str(err)
                unnamed += [] if named else [position]
                continue
            for stage in Stage:
                assert set(rows(trace.events[stage])) <= set(EVENTS.get(stage, [])), position
            if trace.event_count < 24 and not (trace.notes or trace.truncated):
                unnamed.append(position)
        assert unnamed == []

    def test_a_cut_off_chunk_inside_is_no_reason_to_take_the_next_one_for_its_rest(self, tmp_path):
        # Without CRCs: a chunk whose content is one byte short must not borrow that byte from the chunk behind it.
        path = small_trace(tmp_path, compression="none", crcs=False)
        ends = record_ends(path)
        start = next(start for (_, start), (opcode, _) in itertools.pairwise(ends[4:]) if opcode == Opcode.CHUNK)
        data = bytearray(path.read_bytes())
        size_at = start + 9 + 16
        (size,) = struct.unpack_from("<Q", data, size_at)
        struct.pack_into("<Q", data, size_at, size - 1)
        struct.pack_into("<Q", data, size_at + 8 + 4 + 4, size - 1)
        path.write_bytes(data)
        trace = read_trace(path)
        assert "is cut off" in trace.notes[0]
        assert_no_wrong_event(trace)

    def test_a_channel_that_changes_its_topic_is_an_error(self, tmp_path):
        whole = small_trace(tmp_path, compression="none", crcs=False).read_bytes()
        path = tmp_path / "t2.mcap"
        at = whole.index(b"/dds_trace/t1")
        path.write_bytes(whole[:at] + b"/dds_trace/t3" + whole[at + 13 :])
        with pytest.raises(TraceFormatError, match=r"t2\.mcap at byte \d+: channel \d is '/dds_trace/t1' and here"):
            read_trace(path)

    def test_messages_of_an_undeclared_channel_are_noted(self, tmp_path):
        path = small_trace(tmp_path, compression="none", crcs=False, indexed=False)
        data = path.read_bytes()
        at = data.index(b"/dds_trace/t1") - 8 - 9  # the channel record's opcode
        path.write_bytes(data[:at] + b"\x85" + data[at + 1 :])  # a kind of record that is passed over
        trace = read_trace(path)
        assert len(trace.events[Stage.T1]) == 0
        assert len(trace.events[Stage.T2]) == 12
        assert trace.notes[0].startswith("12 messages belong to channel 4")


LIMIT_BYTES = 2 << 30
READ = "import sys; from pathlib import Path; from tracefile.reading.reader import read_trace; t = read_trace(Path(sys.argv[1])); "


def read_in_little_memory(path, expression):
    """What a process that may map 2 GiB in all says about the trace."""
    return subprocess.run(
        [sys.executable, "-c", READ + f"print({expression})", str(path)],
        check=True,
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (LIMIT_BYTES, LIMIT_BYTES)),
    ).stdout.strip()


class TestClaims:
    @pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
    @pytest.mark.parametrize("claim", [1 << 40, (64 << 20) + 1, (1 << 64) - 1])
    def test_a_chunk_that_claims_a_terabyte(self, tmp_path, compression, claim):
        path = small_trace(tmp_path, compression=compression)
        start = chunk_starts(path)[4]
        write_number(path, start + 9 + 16, claim)
        said = read_in_little_memory(path, "t.event_count, t.notes[0]")
        assert f"the chunk at byte {start} " in said
        assert f" it claims {claim:,} bytes" in said

    @pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
    @pytest.mark.parametrize("claim", [0, 1, 63 << 20])
    def test_a_chunk_that_claims_a_little_more_or_less(self, tmp_path, compression, claim):
        path = small_trace(tmp_path, compression=compression, crcs=False)
        start = chunk_starts(path)[4]
        write_number(path, start + 9 + 16, claim)
        trace = read_trace(path)
        assert trace.notes
        assert_no_wrong_event(trace)

    def test_statistics_that_claim_more_events_than_there_is_memory(self, tmp_path):
        path = small_trace(tmp_path, crcs=False)
        at = path.read_bytes().rindex(struct.pack("<HQ", 4, 12))  # channel 4 is T1: 12 messages
        write_number(path, at + 2, 1 << 62)
        said = read_in_little_memory(path, "t.event_count, t.notes")
        assert said.startswith("24 (")
        assert f"claim {1 << 62:,} messages of /dds_trace/t1, 12 were" in said

    def test_statistics_that_claim_fewer_events_than_there_are(self, tmp_path, sentences):
        path = small_trace(tmp_path, crcs=False)
        write_number(path, path.read_bytes().rindex(struct.pack("<HQ", 4, 12)) + 2, 1)
        trace = read_trace(path)
        assert {stage: rows(trace.events[stage]) for stage in EVENTS} == EVENTS
        sentences(*trace.notes)

    @pytest.mark.parametrize(("size", "noted"), [(3_000_000, False), (40_000_000, True)])
    def test_a_frame_that_grows_beyond_belief_is_left_out(self, tmp_path, size, noted):
        path = write_trace(tmp_path / "t.mcap", ping_session(), host=[{"x": "x" * size}])
        assert [note for note in read_trace(path).notes if ", packed into " not in note] == []
        assert bool(read_trace(path).notes) is noted

    def test_only_the_first_notes_are_kept(self, tmp_path):
        path = write_trace(tmp_path / "t.mcap", ping_session(), events=ping_events(MESSAGES * 10), chunk_bytes=100)
        data = bytearray(path.read_bytes())
        starts = [start for (_, start), (opcode, _) in itertools.pairwise(record_ends(path)) if opcode == Opcode.CHUNK]
        for start in starts[5:]:
            data[start + 9 + 24] ^= 1  # the CRC
        path.write_bytes(data)
        trace = read_trace(path)
        assert len(trace.notes) == 21
        assert trace.notes[-1].endswith("more like these")

    def test_a_session_nested_without_end(self, tmp_path):
        text = ping_session().to_json()[:-1] + ', "x": ' + "[" * 100_000 + "]" * 100_000 + "}"
        path = write_messages(tmp_path / "t.mcap", [RawMessage("/dds_trace/session", string_cdr(text), kind=STRING)])
        with pytest.raises(TraceFormatError, match="nested deeper"):
            read_trace(path)

    def test_a_record_of_any_length(self, tmp_path):
        path = small_trace(tmp_path, indexed=False)
        whole = path.read_bytes()
        for _, end in record_ends(path)[:-1]:
            data = bytearray(whole)
            struct.pack_into("<Q", data, end + 1, (1 << 63) + 5)
            path.write_bytes(data)
            try:
                trace = read_trace(path)
            except TraceFormatError as err:
                assert "no topic" in err.what  # noqa: PT017 - most of these are traces, and one or the other is right
            else:
                assert trace.truncated or trace.notes

    def test_descriptions_do_not_depend_on_damaged_events(self, tmp_path):
        path = small_trace(tmp_path)
        ends = record_ends(path)
        chunks = [end for opcode, end in ends if opcode == Opcode.CHUNK]
        data = bytearray(path.read_bytes())
        data[chunks[-1] - 20] ^= 1
        path.write_bytes(data)
        assert read_trace(path).sessions == (ping_session(),)
