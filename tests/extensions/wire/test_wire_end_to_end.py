import json
import random
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator
from lossy_link import lossy_link, running_session
from namespaces import needs_namespaces
from processes import executed
from record_reader import records_of
from report_schemas import REPORT
from waiting import read_past
from wording import report_as

from dds_trace.analyzer.pipeline import analyze
from dds_trace.base.errors import OptionError
from dds_trace.extensions.wire.figures import sent_again_plan, wire_cost_plan
from dds_trace.extensions.wire.format import rows_of_text
from dds_trace.reports.book.book import Book
from dds_trace.reports.figures.own_times import first_message_plan
from dds_trace.tracefile.reading.reader import read_trace

pytestmark = [
    pytest.mark.middleware,
    needs_namespaces("tc", "iproute2"),
    pytest.mark.skipif(not Path("/dev/net/tun").exists(), reason="no TAP devices here"),
]
PROGRAM = Path(sys.executable).with_name("dds-record")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    pytest.importorskip("cyclonedds")
    folder = tmp_path_factory.mktemp("wire")
    both = ("--backend", "cyclonedds", "--domain", 31, "--wire", "--discovery", "subnet")
    with lossy_link(folder, 0.01) as link:
        relay = (PROGRAM, "--role", "relay", *both, "--out", folder / "relay.mcap")
        with running_session(link, 1, *relay) as session:
            read_past(session.stderr, "serves domain")
            ping = link.start(
                0, PROGRAM, "--role", "ping", *both, "--out", folder / "ping.mcap", "--size", "10KB",
                "--messages", 190, "--warmup", 10, "--rate", 40, "--wait", 60, "--seed", 5,
            )  # fmt: skip
            said = ping.communicate(timeout=120)
            assert ping.returncode == 0, said
        link.stop()
    return folder


@pytest.fixture(scope="module")
def analysis(recorded):
    return analyze(recorded)


def test_the_run_has_counts_and_both_traces_have_records(recorded):
    ping, relay = read_trace(recorded / "ping.mcap"), read_trace(recorded / "relay.mcap")
    (run,) = ping.runs
    counts = run.extra["wire"]
    assert counts["complete"] is True
    assert counts["interfaces"] == ["link0", "lo"]
    assert counts["match_ns"] > 0
    of_relay = [text["counts"] for text in relay.wire if "counts" in text]
    assert all(each["complete"] for each in of_relay)
    assert next(text["run_ids"] for text in relay.wire if "counts" in text) == [f"{run.run_id:016x}"]
    for trace in (ping, relay):
        rows = [row for text in trace.wire for row in rows_of_text(text)]
        assert {int(row["run_id"]) for row in rows} == {run.run_id}
        assert any(row["repeats"] for row in rows)


def test_the_wire_is_written_behind_the_last_event(recorded):
    for name in ("ping", "relay"):
        topics = [topic for topic, _ in records_of(recorded / f"{name}.mcap")]
        events = [at for at, topic in enumerate(topics) if topic[-3:] in ("/t1", "/t2", "/t3", "/t4")]
        assert max(events) < topics.index("/dds_trace/wire")


def test_no_payload_is_in_the_traces(recorded):
    """A message's random bytes are known by its seed; no eight of them in a row are in any record."""
    payload = random.Random(5).randbytes(10_000)
    pieces = {payload[at : at + 8] for at in range(len(payload) - 8)}
    for name in ("ping", "relay"):
        for topic, data in records_of(recorded / f"{name}.mcap"):
            held = data
            if topic == "/dds_trace/wire":
                text = json.loads(data[8:].rstrip(b"\0"))
                held = rows_of_text(text).tobytes()
            assert not any(held[at : at + 8] in pieces for at in range(len(held) - 8))


def test_the_analysis_says_what_was_sent_again(analysis):
    (row,) = analysis.details.wire.to_dicts()
    assert row["complete"]
    assert row["messages"] == 190
    assert row["again_messages"] > 10
    assert 0 < row["again_bytes_share"] < 1
    assert row["bytes_per_payload_byte"] > 1.0
    repeats = analysis.details.wire_repeats
    assert repeats["messages"].sum() == 190
    # Few enough are lost that most messages wait for no other one: reliable delivery keeps the order.
    once, again = repeats.filter(repeats=0), repeats.filter(repeats=1)
    assert again["rtt_p50_ns"][0] > once["rtt_p50_ns"][0]


def test_the_figures_have_data_and_the_report_follows_its_schema(analysis):
    book = Book(analysis)
    assert {part.name for part in wire_cost_plan(book)["parts"][0]} >= {"data", "again", "control"}
    assert [one.repeats for one in sent_again_plan(book)["groups"][0]][:2] == [0, 1]
    assert first_message_plan(book)["values_ns"][0] > 0
    page = report_as("html", analysis)
    assert "What a message costs" in page
    Draft202012Validator(REPORT).validate(json.loads(report_as("json", analysis)))


@pytest.mark.thorough
def test_a_sweep_captures_each_cell_in_its_namespaces(tmp_path):
    pytest.importorskip("cyclonedds")
    plan = tmp_path / "plan.toml"
    plan.write_text(
        "[run]\nmessages = 40\nwire = true\n[network]\nnamespaces = true\n"
        '[axes]\nbackend = "cyclonedds"\nsize = "10KB"\nrate = [40, 50]\n'
    )
    sweep = [PROGRAM.with_name("dds-trace"), "sweep", plan, "--out", tmp_path / "out"]
    done = subprocess.run(sweep, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    rows = analyze(tmp_path / "out").details.wire.to_dicts()
    assert [(row["messages"], row["complete"]) for row in rows] == [(40, True), (40, True)]
    assert all(1.0 < row["bytes_per_payload_byte"] < 1.5 for row in rows)
    relays = sorted((tmp_path / "out").rglob("*.relay.mcap"))
    assert len(relays) == 2
    for path in relays:
        runs = {text["run_id"] for text in read_trace(path).wire if "rows" in text}
        assert len(runs) == 1


@pytest.mark.skipif(shutil.which("setpriv") is None, reason="setpriv (util-linux) is not installed")
@pytest.mark.parametrize("role", ["ping", "relay"])
def test_without_the_capability_the_recording_ends_with_one_line(tmp_path, role):
    done = executed(
        ["setpriv", "--bounding-set", "-net_raw", PROGRAM, "--role", role, "--out", tmp_path / "t.mcap",
         "--backend", "socket", "--discovery", "localhost", "--wire"])  # fmt: skip
    assert done.returncode == OptionError.exit_code
    (line,) = done.stderr.splitlines()
    assert "--wire needs the capability CAP_NET_RAW" in line
    assert not (tmp_path / "t.mcap").exists()
