import random
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext

import pytest

from dds_trace.analyzer.pipeline import analyze
from dds_trace.base.version import __version__
from dds_trace.recorder.backends import BACKEND_MODULES, installed_middlewares
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.choices import Discovery
from dds_trace.recorder.errors import NoEchoError, StoppedError
from dds_trace.recorder.host.clock import read_adjtimex
from dds_trace.recorder.host.fingerprint import read_boot_id
from dds_trace.recorder.host.process import StopEvent
from dds_trace.recorder.options import PingOptions, RecordOptions
from dds_trace.recorder.payloads import PAYLOADS
from dds_trace.recorder.payloads.base import DataType, Form, Message, Payload, Source
from dds_trace.recorder.payloads.cdr import CdrWriter
from dds_trace.recorder.payloads.header import payload_bytes_of
from dds_trace.recorder.payloads.stamp import HEADER_STAMP, RAW_HEADER_STAMP, stamp_text
from dds_trace.recorder.recording import record
from dds_trace.reports.book.book import Book
from dds_trace.tracefile.reading.reader import read_trace
from dds_trace.tracefile.writing.destination import TraceDestination

MESSAGES, WARMUP = 8, 2


class Notes:
    def __init__(self):
        self.serves = threading.Event()

    def note(self, text):
        if "serves domain" in text:
            self.serves.set()

    def progress(self, progress):
        pass


@pytest.fixture
def toy_backend(monkeypatch):
    monkeypatch.setitem(BACKEND_MODULES, "toy", "toy_backend")
    monkeypatch.setenv("TOY_SETTING", "on")
    return NodeOptions(domain_id=3, discovery=Discovery.LOCALHOST)


def crossing(node, folder, data="imu", *, own_cost=True):
    """The trace of a ping on the toy backend; that of its relay lies beside it, both closed."""
    folder.mkdir(exist_ok=True)
    stop, notes = threading.Event(), Notes()
    relay = RecordOptions(TraceDestination(folder / "relay.mcap"), node, backend="toy", relay_id=7, own_cost=own_cost)
    ping = RecordOptions(
        TraceDestination(folder / "ping.mcap"),
        node,
        PingOptions(data, rate_hz=200.0, messages=MESSAGES, warmup=WARMUP, wait_s=60.0),
        backend="toy",
        own_cost=own_cost,
    )
    with ThreadPoolExecutor(1) as pool:
        serving = pool.submit(record, relay, stop, notes)
        try:
            while not notes.serves.wait(0.05):
                assert not serving.done(), serving.result()
            pinged = record(ping, threading.Event(), Notes())
        finally:
            stop.set()
        relayed = serving.result()
    assert (pinged.trace.error, relayed.trace.error) == (None, None)
    return read_trace(pinged.trace.path)


def test_a_toy_backend_carries_a_ping_and_a_relay_to_a_closed_trace_that_analyzes(toy_backend, tmp_path):
    session = crossing(toy_backend, tmp_path).sessions[-1]
    assert (session.backend, session.vendor, session.state) == ("toy", "toy", "closed")
    assert session.host["versions"] == {"toy": "1.0"}
    assert session.host["settings"]["TOY_SETTING"] == "on"
    assert session.extra["client_library_floor"]["median_ns"] > 0
    assert session.extra["client_library_floor"]["messages"] == 50
    assert session.extra["recorder_version"] == __version__
    assert session.extra["boot_id"] == read_boot_id()
    clock = session.extra["clock"]
    assert 0 < clock.pop("resolution_ns") < 1_000_000
    assert clock == {"begin": read_adjtimex(), "end": read_adjtimex()}
    analysis = analyze(tmp_path)
    (group,) = analysis.summary.to_dicts()
    assert (group["backend"], group["relay_backend"]) == ("toy", "toy")
    assert (group["published"], group["received"]) == (MESSAGES, MESSAGES)
    assert Book(analysis).groups.labels == ("Toy Bus",)


def test_own_cost_is_left_out_where_it_is_not_asked_for(toy_backend, tmp_path):
    kept = crossing(toy_backend, tmp_path / "kept").sessions[-1].extra
    left_out = crossing(toy_backend, tmp_path / "left out", own_cost=False).sessions[-1].extra
    assert set(kept) - set(left_out) == {"client_library_floor", "recorder_cost"}
    assert left_out["settings"] == kept["settings"]  # it splits no group


def test_a_toy_backend_is_offered_and_explains_itself(toy_backend, tmp_path):
    assert ("toy", None) in installed_middlewares()
    lonely = RecordOptions(
        TraceDestination(tmp_path / "ping.mcap"), toy_backend, PingOptions("imu", wait_s=0.05), backend="toy"
    )
    with pytest.raises(NoEchoError, match=r"--backend toy .*check that both run in one process"):
        record(lonely, threading.Event(), Notes())


def make_toy(size_bytes, seed, _stop=None, /):
    writer = CdrWriter()
    writer.header(stamp_text(0, 0))
    writer.octets(random.Random(seed).randbytes(size_bytes or 92))
    message = writer.message()
    return Payload(TOY, (Message(message, payload_bytes_of(message)),), payload_bytes_of(message))


TOY = DataType(
    name="toy",
    topic="toy_data",
    type_name="toy_msgs/msg/Toy",
    raw=Form(RAW_HEADER_STAMP, payload_bytes_of),
    objects=None,
    object_stamp=HEADER_STAMP,
    make=make_toy,
)


@pytest.mark.parametrize("data", ["toy", "again:3"])
def test_a_toy_payload_is_sent_relayed_and_analyzed(toy_backend, tmp_path, monkeypatch, data):
    monkeypatch.setitem(PAYLOADS, "toy", TOY)
    again = Source("again", "again:SEED", lambda seed, _: nullcontext(make_toy(None, int(seed))))
    monkeypatch.setitem(PAYLOADS, "again", again)
    (run,) = crossing(toy_backend, tmp_path, data).runs
    assert (run.data_type, run.payload_bytes, run.published) == ("toy", 96, MESSAGES + WARMUP)
    (group,) = analyze(tmp_path).summary.to_dicts()
    assert (group["data_type"], group["payload_bytes"], group["received"]) == ("toy", 96, MESSAGES)


def test_a_recording_that_a_spinning_thread_ended_is_no_success(toy_backend, tmp_path):
    stop = StopEvent()
    stop.is_spinning = True
    stop.set()
    relay = RecordOptions(TraceDestination(tmp_path / "relay.mcap"), toy_backend, backend="toy", own_cost=False)
    recorded = record(relay, stop, Notes())
    assert recorded.error.exit_code == StoppedError.exit_code
    assert "-o realtime" in str(recorded.error)
    assert read_trace(recorded.trace.path).sessions[0].state == "closed"
