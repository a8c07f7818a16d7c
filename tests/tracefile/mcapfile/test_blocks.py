from collections import deque

import pytest
from trace_files import Message, ping_events, ping_session, run, write_trace

from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.mcapfile import blocks
from dds_trace.tracefile.mcapfile.chunks import UnpackMemory
from dds_trace.tracefile.reading.reader import read_trace

MESSAGES = 3_000


@pytest.fixture
def made(monkeypatch):
    memories = []

    class Counted(UnpackMemory):
        def __init__(self):
            super().__init__()
            memories.append(self)

    monkeypatch.setattr(blocks, "UnpackMemory", Counted)
    monkeypatch.setattr(blocks, "_FREE", deque(maxlen=8))
    return memories


def trace_of(path, first_ns):
    messages = [Message(n, t1=first_ns + n * 1_000_000, t2=first_ns + n * 1_000_000 + 300_000) for n in range(MESSAGES)]
    return write_trace(path, ping_session(), [run()], ping_events(messages))


def test_a_second_file_is_unpacked_into_the_memory_of_the_first(made, tmp_path):
    first, second = trace_of(tmp_path / "a.mcap", 0), trace_of(tmp_path / "b.mcap", 5_000_000_000)
    of_first = read_trace(first)
    sent_ns = of_first.events[Stage.T1].monotonic_ns.copy()
    count = len(made)
    assert count > 0
    of_second = read_trace(second)
    assert len(made) == count
    assert of_first.events[Stage.T1].monotonic_ns.tolist() == sent_ns.tolist()  # nothing of it lies there
    assert (of_second.events[Stage.T1].monotonic_ns - sent_ns == 5_000_000_000).all()


def test_memory_that_grew_for_one_large_chunk_is_not_kept(made, tmp_path, monkeypatch):
    monkeypatch.setattr(blocks, "_MOST_REUSED_BYTES", 1000)
    read_trace(trace_of(tmp_path / "a.mcap", 0))
    assert made
    assert not blocks._FREE
