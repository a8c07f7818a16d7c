from __future__ import annotations

import time
from pathlib import Path

import pytest
from trace_files import relay_session

from dds_trace.base.errors import OutputError
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.options import RecordOptions
from dds_trace.recorder.service import upkeep
from dds_trace.tracefile.reading.reader import read_trace
from dds_trace.tracefile.writing.destination import TraceDestination


@pytest.mark.parametrize("looks_meanwhile", [True, False])
@pytest.mark.parametrize(("events", "is_lost"), [(6, False), (20, True)])
def test_a_short_disk_is_an_error_once_an_event_found_no_room_in_the_ring(
    tmp_path, monkeypatch, events, is_lost, looks_meanwhile
):
    short, said = [None], []
    monkeypatch.setattr(upkeep, "find_shortage", lambda *_, **__: short[0])
    options = RecordOptions(TraceDestination(tmp_path / "relay.mcap", ring_slots=8), NodeOptions())
    with upkeep.Upkeep(options, relay_session(state="open"), time.monotonic_ns, said.append) as kept:
        kept.look(0, dict)
        short[0] = OutputError("the disk is short")
        kept.look(0, dict)
        for sequence in range(events):
            kept.sink.stamp(3, 7, sequence)
        if looks_meanwhile:
            kept.look(0, dict)
            assert kept.shortage is (short[0] if is_lost else None)
        short[0] = None
        kept.look(0, dict)
        closed = kept.close_trace()
    assert [line.partition(":")[0].partition(";")[0] for line in said] == [
        "the disk is short",
        "there is disk space again",
    ]
    (session,) = read_trace(Path(closed.path)).sessions
    assert (closed.events, closed.dropped_events) == (min(events, 8), max(0, events - 8))
    assert session.extra.get("stopped") == ("the disk is short" if is_lost else None)
