"""Options of `dds-analyze` beside the reports."""

import polars as pl
import pytest
from trace_files import Message, write_pair

from dds_trace.analyzer.exports.tables import EXPORTERS
from dds_trace.cli.analyze import ExportKind, main
from dds_trace.tracefile import read_trace

MS = 1_000_000
TIMELINE = [
    Message(
        s,
        t0=s * 100 * MS,
        t1=s * 100 * MS,
        t3=s * 100 * MS + MS,
        t4=s * 100 * MS + MS,
        t2=s * 100 * MS + 2 * MS,
    )
    for s in range(120)
]


def run_main(*arguments):
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    return ended.value.code or 0


@pytest.fixture
def runs(tmp_path):
    write_pair(tmp_path / "runs", TIMELINE)
    return tmp_path / "runs"


def test_exports_hold_the_same_rows(runs, capsys):
    assert run_main(runs, "--export", "csv", "--export", "arrow") == 0
    folder = runs / "analysis"
    assert f"Wrote {folder / 'roundtrips.csv'}" in capsys.readouterr().out
    expected = pl.read_parquet(folder / "roundtrips.parquet")["latency_ns"].to_list()
    assert pl.read_csv(folder / "roundtrips.csv")["latency_ns"].to_list() == expected == [MS] * 120
    assert pl.read_ipc(folder / "roundtrips.arrow")["latency_ns"].to_list() == expected
    assert pl.read_csv(folder / "summary.csv").height == 1
    assert {kind.value for kind in ExportKind} == set(EXPORTERS)


def test_a_derived_trace_and_its_layout(runs):
    for _ in range(2):
        assert run_main(runs, "--derived-mcap") == 0
    assert (runs / "analysis" / "latency.derived.foxglove.json").exists()
    assert read_trace(runs / "ping.mcap").event_count == 240  # a trace is never written to


def test_a_recommendation(runs, capsys):
    job = "data=binary size=33KB rate=10 deadline=50ms reliability=0.9"
    assert run_main(runs, "--recommend", job) == 0
    assert "likely" in capsys.readouterr().out  # one run shows no more


def test_topics_of_any_recording(runs, capsys):
    assert run_main(runs, "--topics") == 0
    assert "/dds_trace/t1" in capsys.readouterr().out
    assert not (runs / "analysis").exists()


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("--deadline", "soon", "20ms"),
        ("--deadline", "0ms", "20ms"),
        ("--recommend", "data=binary", "missing"),
    ],
)
def test_wrong_values_are_one_line(runs, capsys, option, value, said):
    assert run_main(runs, option, value) == 2
    shown = capsys.readouterr().err
    assert said in shown
    assert shown.count("\n") == 1
    assert not (runs / "analysis").exists()


def test_a_deadline_is_taken(runs):
    assert run_main(runs, "--deadline", "20ms") == 0
