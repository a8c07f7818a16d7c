import errno
import os
from collections import defaultdict
from contextlib import closing

import pytest
from mcap.reader import make_reader
from trace_files import Message, event, relay_events, relay_session, write_trace

from dds_trace.base.errors import OutputError, TraceFormatError
from dds_trace.extensions.campaigns.run.split import CellPart, split_relay_trace
from dds_trace.tracefile.format.events import HOST_TOPIC, WIRE_TOPIC, Stage
from dds_trace.tracefile.reading.reader import read_trace
from dds_trace.tracefile.writing.destination import TraceDestination
from dds_trace.tracefile.writing.sink import TraceSink
from dds_trace.tracefile.writing.writer import MAX_CHUNK_EVENTS

SECOND_NS = 1_000_000_000
FIRST_RUN, SECOND_RUN = 0x11, 0x22


def messages(start_ns):
    return [Message(n, t3=start_ns + n * 1000, t4=start_ns + n * 1000 + 400) for n in range(5)]


@pytest.fixture
def segment(tmp_path):
    first, second = (
        relay_events(messages(0), run_id=FIRST_RUN),
        relay_events(messages(10 * SECOND_NS), run_id=SECOND_RUN),
    )
    events = {stage: first[stage] + second[stage] for stage in (Stage.T3, Stage.T4)}
    events[Stage.T3][7] = event(
        2, 10 * SECOND_NS + 2000, run_id=SECOND_RUN, source_ns=5, received_ns=6, relay_id=0xBEEF
    )
    return write_trace(
        tmp_path / "segment.mcap",
        relay_session(dropped_events=3, extra={"unknown": "kept"}),
        (),
        events,
        host=[{"second": n} for n in range(14)],
    )


@pytest.mark.parametrize(("rights", "of_parts"), [(0o600, 0o600), (0o640, 0o640), (0o666, 0o640)])
def test_a_part_has_the_rights_of_the_whole_and_none_for_others(segment, tmp_path, rights, of_parts):
    segment.chmod(rights)
    before = os.umask(0)
    try:
        split_relay_trace(segment, [CellPart(FIRST_RUN, tmp_path / "part.mcap")])
    finally:
        os.umask(before)
    assert (tmp_path / "part.mcap").stat().st_mode & 0o777 == of_parts


def test_each_part_has_its_run_whole_and_nothing_of_the_other(segment, tmp_path):
    paths = {run_id: tmp_path / f"{run_id}.mcap" for run_id in (FIRST_RUN, SECOND_RUN)}
    counts = split_relay_trace(segment, [CellPart(run_id, path) for run_id, path in paths.items()])
    assert counts == {FIRST_RUN: 10, SECOND_RUN: 10}
    whole = read_trace(segment)
    for run_id, path in paths.items():
        part = read_trace(path)
        for stage in (Stage.T3, Stage.T4):
            expected = whole.events[stage].take(whole.events[stage].run_id == run_id)
            for name in expected.__slots__:
                assert getattr(part.events[stage], name).tolist() == getattr(expected, name).tolist()
        assert part.sessions == whole.sessions
        assert part.truncated is None


def test_host_samples_are_those_of_the_runs_time_and_those_that_are_added(segment, tmp_path):
    path = tmp_path / "part.mcap"
    link = {"monotonic_ns": 11 * SECOND_NS, "link": {"delay_ms": 1}}
    split_relay_trace(segment, [CellPart(SECOND_RUN, path, link)])
    samples = read_trace(path).host_samples
    assert [sample["second"] for sample in samples if "second" in sample] == [10, 11]
    assert [sample["link"] for sample in samples if "link" in sample] == [{"delay_ms": 1}]


def test_a_part_has_the_records_of_its_run_and_counts_that_are_of_no_other(tmp_path):
    first, second, both = (
        {"run_id": f"{FIRST_RUN:016x}", "rows": ""},
        {"run_ids": [f"{FIRST_RUN:016x}"], "counts": {"requests": 1}},
        {"run_ids": [f"{FIRST_RUN:016x}", f"{SECOND_RUN:016x}"], "counts": {"requests": 2}},
    )
    segment = tmp_path / "segment.mcap"
    with closing(TraceSink(TraceDestination(segment), relay_session())) as sink:
        for number in (3, 4):
            sink.record(number, FIRST_RUN, 0, 1000 + number, relay_id=0xBEEF)
        for text in (first, second, both, {"run_id": f"{SECOND_RUN:016x}", "rows": ""}):
            sink.write_json(WIRE_TOPIC, text)
    path = tmp_path / "part.mcap"
    split_relay_trace(segment, [CellPart(FIRST_RUN, path)])
    assert read_trace(path).wire == (first, second)


def test_part_is_a_file_for_every_mcap_tool(segment, tmp_path):
    path = tmp_path / "part.mcap"
    split_relay_trace(segment, [CellPart(FIRST_RUN, path)])
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        counts = {
            summary.channels[channel].topic: count
            for channel, count in summary.statistics.channel_message_counts.items()
        }
        assert counts == {"/dds_trace/session": 1, "/dds_trace/t3": 5, "/dds_trace/t4": 5, HOST_TOPIC: 2}
        times = [message.log_time for _, _, message in reader.iter_messages()]
        assert times == sorted(times)


def test_sequence_counts_the_messages_of_each_channel(segment, tmp_path):
    path = tmp_path / "part.mcap"
    split_relay_trace(segment, [CellPart(SECOND_RUN, path)])
    with path.open("rb") as stream:
        sequences = defaultdict(list)
        for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            sequences[channel.topic].append(message.sequence)
    assert sequences == {
        "/dds_trace/session": [0],
        "/dds_trace/t3": [0, 1, 2, 3, 4],
        "/dds_trace/t4": [0, 1, 2, 3, 4],
        HOST_TOPIC: [0, 1],
    }


def test_a_run_longer_than_a_chunk_is_written_whole(tmp_path):
    count = MAX_CHUNK_EVENTS // 2 + 10  # T3 and T4 of each: a chunk and a little more
    timeline = [Message(n, t3=n * 1000, t4=n * 1000 + 400) for n in range(count)]
    segment = write_trace(tmp_path / "a.mcap", relay_session(), (), relay_events(timeline, run_id=FIRST_RUN))
    path = tmp_path / "part.mcap"
    assert split_relay_trace(segment, [CellPart(FIRST_RUN, path)]) == {FIRST_RUN: 2 * count}
    part = read_trace(path)
    for stage in (Stage.T3, Stage.T4):
        assert part.events[stage].sequence.tolist() == list(range(count))


def test_part_that_cannot_be_written_leaves_what_was_there(segment, tmp_path, monkeypatch):
    path = tmp_path / "part.mcap"
    path.write_bytes(b"before")

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "pwritev", full)
    with pytest.raises(OutputError, match="the disk is full"):
        split_relay_trace(segment, [CellPart(FIRST_RUN, path)])
    assert path.read_bytes() == b"before"
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["part.mcap", "segment.mcap"]


def test_run_that_the_relay_never_saw_gets_no_file(segment, tmp_path):
    path = tmp_path / "part.mcap"
    assert split_relay_trace(segment, [CellPart(0x33, path)]) == {0x33: 0}
    assert not path.exists()


def test_trace_without_a_session_has_no_clock(tmp_path):
    path = write_trace(tmp_path / "a.mcap", (), (), relay_events(messages(0)))
    with pytest.raises(TraceFormatError, match="names no session"):
        split_relay_trace(path, [CellPart(1, tmp_path / "b.mcap")])
