import json
import os
from types import SimpleNamespace

import duckdb
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from trace_files import (
    TWELVE,
    WALL_ANCHOR_NS,
    Message,
    event,
    ping_events,
    ping_session,
    relay_session,
    run,
    write_pair,
    write_trace,
)

from dds_trace.analyzer.model.columns import ROUNDTRIP_COLUMNS, SUMMARY_COLUMNS
from dds_trace.analyzer.pairing import roundtrips
from dds_trace.analyzer.pairing.parquet import provenance, roundtrips_writer, write_summary
from dds_trace.analyzer.pipeline import analyze
from dds_trace.base.errors import OutputError
from dds_trace.base.version import __version__
from dds_trace.tracefile.format.events import Stage

# By hand: the page of columns is made from the code.
TYPES = {
    "run_id": pa.uint64(),
    "relay_id": pa.uint32(),
    "sequence": pa.uint64(),
    "vendor": pa.string(),
    "relay_vendor": pa.string(),
    "ping_domain_id": pa.int32(),
    "relay_domain_id": pa.int32(),
    "domain_mode": pa.string(),
    "payload_bytes": pa.uint32(),
    "rate_hz": pa.float64(),
    "depth": pa.int32(),
    "scheduled_ns": pa.int64(),
    "relay_out_ns": pa.int64(),
    "latency_ns": pa.int64(),
    "outcome": pa.string(),
    "duplicates": pa.uint16(),
    "reordered": pa.bool_(),
    "publish_utc": pa.timestamp("ns", tz="UTC"),
    "relay_in_utc": pa.timestamp("ns", tz="UTC"),
}


def test_files_tell_types_units_and_meanings(tmp_path):
    write_pair(tmp_path, TWELVE)
    outputs = analyze(tmp_path, out=tmp_path / "out").outputs
    schema = pq.read_schema(outputs["roundtrips"])
    assert schema.names == [column.name for column in ROUNDTRIP_COLUMNS]
    assert {name: schema.field(name).type for name in TYPES} == TYPES
    assert schema.field("latency_ns").metadata[b"unit"] == b"ns"
    assert schema.field("payload_bytes").metadata[b"unit"] == b"B"
    assert b"T4 - T3" in schema.field("intermediate_ns").metadata[b"meaning"]
    summary = pq.read_schema(outputs["summary"])
    assert summary.names == [column.name for column in SUMMARY_COLUMNS]
    assert summary.field("latency_p99_9_ns").type == pa.float64()
    assert b"its tail is no one-way tail" in schema.field("latency_ns").metadata[b"meaning"]
    for statistic in ("p90", "p99", "p99_9", "max"):
        meaning = summary.field(f"latency_{statistic}_ns").metadata[b"meaning"]
        assert b"this tail is below the tail of one way" in meaning
    assert b"tail" not in summary.field("latency_p50_ns").metadata[b"meaning"]
    assert b"tail" not in summary.field("response_p99_ns").metadata[b"meaning"]
    assert summary.field("transfer_rate_bytes_per_s").metadata[b"unit"] == b"B/s"


def test_times_and_sequence_numbers_are_stored_as_deltas(tmp_path):
    write_pair(tmp_path, TWELVE)
    outputs = analyze(tmp_path, out=tmp_path / "out").outputs
    group = pq.read_metadata(outputs["roundtrips"]).row_group(0)
    columns = [group.column(number) for number in range(group.num_columns)]
    assert {column.compression for column in columns} == {"ZSTD"}
    units = {column.name: column.unit for column in ROUNDTRIP_COLUMNS}
    by_delta = {column.path_in_schema for column in columns if "DELTA_BINARY_PACKED" in column.encodings}
    assert by_delta == {name for name, unit in units.items() if unit in {"ns", "UTC"}} | {"sequence"}
    by_dictionary = {column.path_in_schema for column in columns if column.has_dictionary_page}
    assert by_dictionary == set(units) - by_delta - {"reordered"}  # a bit each needs none


def test_folders_above_are_made_and_may_be_there(tmp_path):
    write_pair(tmp_path, TWELVE)
    analysis = analyze(tmp_path)
    folder = tmp_path / "runs" / "today"
    for _ in range(2):
        with roundtrips_writer(folder / "rows" / "a.parquet"):
            pass
        write_summary(analysis.summary, folder / "summaries" / "b.parquet", {})
    assert pq.read_metadata(folder / "rows" / "a.parquet").num_rows == 0
    assert pq.read_metadata(folder / "summaries" / "b.parquet").num_rows == 1


def test_files_tell_who_wrote_them_by_which_contract_of_what_and_when(tmp_path):
    clock = {"begin": {"frequency_ppb": 0, "tick_us": 10000, "status": 0x2041}}
    write_pair(tmp_path, TWELVE, ping=ping_session(extra={"clock": clock}))
    outputs = analyze(tmp_path, out=tmp_path / "out").outputs
    for path in outputs.values():
        told = {key.decode(): value.decode() for key, value in pq.read_metadata(path).metadata.items()}
        assert told["dds_trace.version"] == __version__
        assert told["dds_trace.contract"] == "docs/trace-format.md, format 1"
        assert json.loads(told["dds_trace.sources"]) == {
            "folder": tmp_path.name,
            "count": 2,
            "names": ["ping.mcap", "relay.mcap"],
        }
        assert json.loads(told["dds_trace.recorded"]) == {
            "first": "2023-11-14T22:13:20.000000005Z",
            "last": "2023-11-14T22:13:20.000011005Z",
        }
        clocks = json.loads(told["dds_trace.clocks"])
        assert clocks["count"] == 2
        assert {each["role"]: each["synchronized"] for each in clocks["sessions"]} == {"ping": False, "relay": None}


def test_of_many_traces_and_sessions_the_first_thousand_are_named(tmp_path):
    numbers = range(1001)
    campaign = SimpleNamespace(
        folder=tmp_path,
        sources=[SimpleNamespace(path=f"{number:04}.mcap", status="used") for number in reversed(numbers)],
        sessions={number: ping_session(session_id=number, wall_anchor_ns=1001 - number) for number in numbers},
    )
    exchanges = SimpleNamespace(placed=[SimpleNamespace(start_ns=5, end_ns=7), SimpleNamespace(start_ns=3, end_ns=9)])
    told = provenance(campaign, exchanges)
    sources, clocks = json.loads(told["dds_trace.sources"]), json.loads(told["dds_trace.clocks"])
    assert sources == {"folder": tmp_path.name, "count": 1001, "names": [f"{number:04}.mcap" for number in range(1000)]}
    assert clocks["count"] == 1001
    assert [int(each["session_id"], 16) for each in clocks["sessions"]] == list(range(1000, 0, -1))
    assert json.loads(told["dds_trace.recorded"]) == {
        "first": "1970-01-01T00:00:00.000000003Z",
        "last": "1970-01-01T00:00:00.000000009Z",
    }


def test_utc_is_told_of_each_clock_by_its_own_anchor_and_only_after_it(tmp_path):
    timeline = [
        Message(0, t0=0, t1=5, t3=900, t4=930, t2=2050),
        Message(1, t0=1000, t1=1005, t3=None, t4=None, t2=None),
    ]
    ping = ping_session(wall_anchor_ns=WALL_ANCHOR_NS + 100, monotonic_anchor_ns=100)
    relay = relay_session(wall_anchor_ns=5_000, monotonic_anchor_ns=200)
    write_pair(tmp_path, timeline, ping=ping, relay=relay)
    rows = analyze(tmp_path).load_roundtrips()
    utc_ns = rows.select(pl.col("publish_utc", "relay_in_utc").dt.epoch("ns")).rows()
    # T1 at 5 lies before the anchor at 100: that session cannot have recorded it.
    assert utc_ns == [(None, 5_700), (WALL_ANCHOR_NS + 1005, None)]


def test_what_is_read_back_is_what_was_analyzed(tmp_path, monkeypatch):
    """Also over several row groups, with relays and texts that some rows lack."""
    monkeypatch.setattr(roundtrips, "ROWS_PER_FRAME", 7)
    write_pair(tmp_path, TWELVE)
    write_trace(
        tmp_path / "other.mcap",
        ping_session(session_id=5, rmw=None, vendor="zenoh", backend="zenoh"),
        [run(run_id=5, extra={}, relay_domain_id=None, bridge="zenoh")],
        {Stage.T1: [event(s, 10**7 + s, run_id=5) for s in range(6)]},
    )
    analysis = analyze(tmp_path, out=tmp_path / "out")
    assert analysis.load_roundtrips().height == 18
    assert pq.ParquetFile(analysis.outputs["roundtrips"]).num_row_groups == 3
    third = f"SELECT sequence, outcome FROM '{analysis.outputs['roundtrips']}' OFFSET 5 LIMIT 9"
    assert duckdb.sql(third).fetchall() == analysis.load_roundtrips()[5:14].select("sequence", "outcome").rows()
    for kind, frame in (("roundtrips", analysis.load_roundtrips()), ("summary", analysis.summary)):
        read = pl.read_parquet(analysis.outputs[kind])
        assert read.schema == frame.schema
        assert read.equals(frame)
        assert pl.from_arrow(pq.read_table(analysis.outputs[kind])).equals(frame)


def test_a_file_without_rows_has_its_columns(tmp_path):
    write_pair(tmp_path, TWELVE, runs=[run(warmup_messages=100)])
    analysis = analyze(tmp_path, out=tmp_path / "out")
    read = pl.read_parquet(analysis.outputs["roundtrips"])
    assert read.height == 0
    assert read.schema == analysis.load_roundtrips().schema


def test_absurd_numbers_survive(tmp_path):
    messages = [event(s, 10 + i, run_id=2**64 - 1) for i, s in enumerate((0, 2**63, 2**64 - 1))]
    write_trace(
        tmp_path / "ping.mcap", ping_session(), [run(run_id=2**64 - 1, payload_bytes=2**32 - 1)], {Stage.T1: messages}
    )
    analysis = analyze(tmp_path, out=tmp_path / "out")
    read = pl.read_parquet(analysis.outputs["roundtrips"])
    assert read.select("run_id", "sequence", "payload_bytes").rows() == [
        (2**64 - 1, s, 2**32 - 1) for s in (0, 2**63, 2**64 - 1)
    ]


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    write_pair(tmp_path, TWELVE)
    out = tmp_path / "out"
    analyze(tmp_path, out=out)
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    write_trace(tmp_path / "relay.mcap", relay_session(), (), {})

    def full(*_arguments, **_options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pq.ParquetWriter, "write_table", full)
    with pytest.raises(OutputError, match=r"roundtrips\.parquet cannot be written \(No space left on device\).*--out"):
        analyze(tmp_path, out=out)
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_may_not_be_written_is_an_error(tmp_path):
    write_pair(tmp_path, TWELVE)
    (tmp_path / "out").mkdir(mode=0o500)
    with pytest.raises(OutputError):
        analyze(tmp_path, out=tmp_path / "out")


def test_equal_input_gives_equal_bytes(tmp_path):
    write_trace(tmp_path / "ping.mcap", ping_session(), [run()], ping_events(TWELVE))
    first = analyze(tmp_path, out=tmp_path / "first").outputs
    second = analyze(tmp_path, out=tmp_path / "second").outputs
    for kind, path in first.items():
        assert path.read_bytes() == second[kind].read_bytes()
