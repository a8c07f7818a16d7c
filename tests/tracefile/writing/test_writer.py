import numpy as np
import pytest
from mcap.reader import make_reader
from trace_files import ping_session

from dds_trace.tracefile.format.events import EVENT_DTYPE, HOST_TOPIC, EventColumns, Stage
from dds_trace.tracefile.reading.reader import read_trace
from dds_trace.tracefile.writing.event_chunks import slots_in_time
from dds_trace.tracefile.writing.writer import MAX_CHUNK_EVENTS, TraceWriter


def events(count, first_ns, step_ns):
    records = np.zeros(count, EVENT_DTYPE)
    records["sequence"] = np.arange(count)
    records["monotonic_ns"] = first_ns + step_ns * np.arange(count)
    return EventColumns.from_records(records)


def test_sequences_count_per_channel_over_chunks_and_texts(tmp_path):
    path = tmp_path / "t.mcap"
    count = MAX_CHUNK_EVENTS  # two stages of it make two chunks
    slots = slots_in_time({Stage.T1: events(count, 0, 1000), Stage.T4: events(count, 500, 1000)})
    with TraceWriter(path, ping_session()) as writer:
        writer.write_text(HOST_TOPIC, "{}", 0)
        writer.write_events(slots[: count + 7])
        writer.write_text(HOST_TOPIC, "{}", 0)
        writer.write_events(slots[count + 7 :])
        writer.finish()
    with path.open("rb") as stream:
        messages = [
            (channel.topic, message.sequence)
            for _, channel, message in make_reader(stream).iter_messages(log_time_order=False)
        ]
    for topic, held in ((Stage.T1.topic, count), (Stage.T4.topic, count), (HOST_TOPIC, 2)):
        assert [sequence for name, sequence in messages if name == topic] == [*range(held)]
    assert writer.events == 2 * count
    assert read_trace(path).events[Stage.T4].monotonic_ns.tolist() == [500 + 1000 * n for n in range(count)]


def test_no_events_are_no_chunk(tmp_path):
    with TraceWriter(tmp_path / "t.mcap", ping_session()) as writer:
        before = writer.bytes_written
        writer.write_events(slots_in_time({}))
        assert writer.bytes_written == before


def test_an_error_in_the_block_leaves_a_readable_file_without_summary(tmp_path):
    path = tmp_path / "t.mcap"

    def fail():
        with TraceWriter(path, ping_session()) as writer:
            writer.write_events(slots_in_time({Stage.T1: events(3, 0, 1)}))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    trace = read_trace(path)
    assert len(trace.events[Stage.T1]) == 3
    assert trace.truncated is not None
