import socket

import numpy as np
import pytest
from trace_files import run

from dds_trace.base.errors import OptionError
from dds_trace.extensions.wire.capture import WireRecord, WireResult, open_wire
from dds_trace.extensions.wire.counts import WireCounts
from dds_trace.extensions.wire.format import MESSAGE_ROW, rows_of_text
from dds_trace.recorder.base_recording import Capture as NoCapture
from dds_trace.recorder.choices import Discovery
from dds_trace.tracefile.format.events import WIRE_TOPIC

SESSION_ID = 0xABC


class Capture:
    pid = 4711

    def __init__(self, *run_ids):
        self.rows = np.zeros(len(run_ids), MESSAGE_ROW)
        self.rows["run_id"] = run_ids
        self.begun = []
        self.killed = False

    def begin(self, run_id=None):
        self._check()
        self.begun.append(run_id)

    def take(self):
        self._check()
        self.begun.append("taken")
        return WireResult(WireCounts(messages=len(self.rows), requests=5), self.rows)

    def _check(self):
        if self.killed:
            raise OptionError("the capturing process ended by itself")


class Sink:
    def __init__(self):
        self.runs, self.texts = [], []

    def write_run(self, run):
        self.runs.append(run)

    def write_json(self, topic, value):
        assert topic == WIRE_TOPIC
        self.texts.append(value)


@pytest.fixture
def sink():
    return Sink()


def test_a_run_gets_its_counts_and_its_records_follow(sink):
    capture, finished = Capture(7), run(run_id=7, extra={"seed": 1})
    record = WireRecord(capture, print)
    record.begin(7)
    described = record.write_run(finished, sink)
    assert capture.begun == ["taken", 7, "taken"]
    assert record.processes == {"wire": 4711}
    assert sink.runs == [described]
    assert described.extra["seed"] == 1
    assert described.extra["wire"]["requests"] == 5
    (text,) = sink.texts
    assert rows_of_text(text)["run_id"].tolist() == [7]


def test_a_relay_writes_counts_that_name_their_runs_and_goes_on(sink):
    capture = Capture(7, 9)
    record = WireRecord(capture, print)
    record.begin()
    record.write_relay(20, SESSION_ID, sink, go_on=True)
    counts, *rows = sink.texts
    assert counts["session_id"] == "0000000000000abc"
    assert counts["run_ids"] == ["0000000000000007", "0000000000000009"]
    assert counts["counts"]["requests"] == 5
    assert [text["run_id"] for text in rows] == counts["run_ids"]
    assert capture.begun == [None, "taken", None]


def test_a_relay_without_new_messages_writes_nothing(sink):
    record = WireRecord(Capture(7), print)
    for relayed in (0, 5, 5):
        record.write_relay(relayed, SESSION_ID, sink)
    assert len(sink.texts) == 2


def test_a_recording_outlives_its_capture(sink, sentences):
    notes, capture, finished = [], Capture(7), run(run_id=7)
    record = WireRecord(capture, notes.append)
    capture.killed = True
    assert record.write_run(finished, sink) is finished
    record.begin(8)
    record.write_relay(3, SESSION_ID, sink)
    assert (sink.runs, sink.texts, record.processes) == ([], [], {})
    sentences(*notes)


def test_without_the_option_nothing_is_captured(sink):
    record = NoCapture()
    record.begin(7)
    assert record.write_run(run(), sink) == run()
    record.write_relay(1, 2, sink)
    assert (sink.runs, sink.texts, record.processes) == ([], [], {})


def test_a_system_without_packet_sockets_is_told_in_one_line(monkeypatch):
    monkeypatch.delattr(socket, "AF_PACKET")
    with (
        pytest.raises(OptionError, match=r"^--wire needs Linux: this system does not have"),
        open_wire(discovery=Discovery.LOCALHOST, domain_ids=[1], note=print),
    ):
        pass
