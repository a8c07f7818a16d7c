import subprocess
import sys

import pytest
import trace_files

from dds_trace.analyzer.pipeline import analyze
from dds_trace.tracefile.format.events import MOST_STAMP_NS, Stage

PERIOD = 100_000_000
MESSAGES = 300

BASE_BYTES, BYTES_PER_BYTE = 300 << 20, 200
"""Bound of a command: that of Python and its libraries, and so much for each byte that is read."""

NO_TIME = -(2**63)


def sound(period=PERIOD):
    return [
        trace_files.Message(
            n, t0=n * period, t1=n * period + 50, t3=n * period + 100, t4=n * period + 200, t2=n * period + 400
        )
        for n in range(MESSAGES)
    ]


def write_campaign(folder, messages, ping=(), relay=(), **session):
    described = trace_files.run(planned_messages=len(messages), published=len(messages))
    trace_files.write_trace(
        folder / "ping.mcap",
        trace_files.ping_session(extra=session),
        [described],
        trace_files.merged_events([trace_files.ping_events(messages), dict(ping)]),
    )
    trace_files.write_trace(
        folder / "relay.mcap",
        trace_files.relay_session(),
        (),
        trace_files.merged_events([trace_files.relay_events(messages), dict(relay)]),
    )
    return folder


def foreign_relays(count):
    return {Stage.T2: [trace_files.event(n % MESSAGES, 10**12 + n, relay_id=1000 + n) for n in range(count)]}


HOSTILE = {
    "no_time": lambda folder: write_campaign(folder, sound(), {Stage.T1: [trace_files.event(MESSAGES, NO_TIME)]}),
    "long_clock": lambda folder: write_campaign(folder, sound(2**62 // MESSAGES - 1000)),
    "parts": lambda folder: write_campaign(folder, sound(), part=2_000_000_000),
    "relays": lambda folder: write_campaign(folder, sound(), foreign_relays(3000)),
}


@pytest.mark.parametrize("values", HOSTILE)
def test_the_memory_of_a_command_is_bounded_by_the_bytes_that_it_reads(tmp_path, values):
    folder = HOSTILE[values](tmp_path / "traces")
    read = sum(file.stat().st_size for file in folder.iterdir())
    command = [sys.executable, "-c", _MEASURED, str(folder), "--out", str(tmp_path / "out")]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    peak = int(result.stdout.split()[-1])
    assert peak < BASE_BYTES + BYTES_PER_BYTE * read, f"{peak >> 20} MiB for {read} bytes"


_MEASURED = """
import re, sys
from pathlib import Path
from dds_trace.cli.dds_analyze import main
try:
    main(sys.argv[1:])
except SystemExit as end:
    code = end.code
else:
    code = 0
# Not `ru_maxrss`, which begins with that of the process that started this one.
peak = re.search('VmHWM: *([0-9]+) kB', Path('/proc/self/status').read_text().replace('\\t', ' '))
print(1024 * int(peak[1]))
sys.exit(code)
"""


@pytest.mark.parametrize("instant", [NO_TIME, -MOST_STAMP_NS - 1, MOST_STAMP_NS + 1, 2**63 - 1])
@pytest.mark.parametrize(
    ("stage", "field"), [*((stage, "monotonic_ns") for stage in Stage), (Stage.T1, "scheduled_ns")]
)
def test_an_event_without_a_possible_instant_is_not_used(tmp_path, stage, instant, field):
    wild = trace_files.event(
        5, **{"monotonic_ns": 5, field: instant}, relay_id=0 if stage is Stage.T1 else trace_files.RELAY_ID
    )
    side = "ping" if stage in (Stage.T1, Stage.T2) else "relay"
    whole = analyze(write_campaign(tmp_path / "whole", sound()))
    analysis = analyze(write_campaign(tmp_path / "wild", sound(), **{side: {stage: [wild]}}))
    # An event of a tap in the trace of a relay lacks its publisher, too.
    more = {f.code for f in analysis.findings} - {f.code for f in whole.findings}
    assert more - ({"reader_note"} if stage is Stage.TAP else set()) == {"unreadable_messages"}
    assert analysis.load_roundtrips().equals(whole.load_roundtrips())


def test_an_impossible_stamp_of_the_middleware_is_unknown(tmp_path):
    wild = trace_files.event(MESSAGES, 50 + MESSAGES * PERIOD, source_ns=NO_TIME, received_ns=2**63 - 1)
    analysis = analyze(write_campaign(tmp_path, sound(), {Stage.T1: [wild]}))
    assert analysis.load_roundtrips().height == MESSAGES + 1


def test_missing_parts_are_named_as_ranges(tmp_path):
    analysis = analyze(write_campaign(tmp_path, sound(), part=2_000_000_000))
    (finding,) = [finding for finding in analysis.findings if finding.code == "missing_files"]
    assert "1 to 1999999999" in finding.what


def test_made_up_relays_do_not_make_rows_without_bound(tmp_path):
    analysis = analyze(write_campaign(tmp_path, sound(), foreign_relays(2000)))
    assert analysis.load_roundtrips().height <= 4 * (2000 + 3 * MESSAGES)
    assert trace_files.RELAY_ID in analysis.load_roundtrips()["relay_id"].to_list()
    assert "too_many_relays" in {finding.code for finding in analysis.findings}


def test_a_run_may_have_many_relays_that_answer(tmp_path):
    replies = {
        Stage.T2: [
            trace_files.event(n, n * PERIOD + 500, relay_id=1000 + k) for k in range(20) for n in range(MESSAGES)
        ]
    }
    analysis = analyze(write_campaign(tmp_path, sound(), replies, settings={"relays": "21"}))
    assert analysis.load_roundtrips().height == 21 * MESSAGES
    assert not [finding for finding in analysis.findings if finding.code == "too_many_relays"]
