import io
import json
import re
import shlex
import shutil
import sys
from pathlib import Path

import polars as pl
import pytest
from commands import run_main, run_trace
from trace_files import evenly, run, write_pair

from dds_trace.analyzer.exports.kinds import EXPORT_KINDS, write_file
from dds_trace.analyzer.model.metrics import METRICS
from dds_trace.base.errors import BackendUnavailableError
from dds_trace.cli.outputs import BROWSERS
from dds_trace.tracefile.reading.reader import read_trace

MS = 1_000_000
ROOT = Path(__file__).parents[2]
TIMELINE = evenly([MS] * 120)


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


def test_an_export_kind_is_one_row(runs, monkeypatch, capsys):
    run_main("--help")
    assert ", ".join(EXPORT_KINDS) in " ".join(capsys.readouterr().out.split())
    assert run_main(runs, "--export", "toy") == 2
    assert f"'toy' is not one of {', '.join(map(repr, EXPORT_KINDS))}" in capsys.readouterr().err
    row = lambda one, folder: [write_file(folder / "toy.ndjson", one.summary.write_ndjson)]  # noqa: E731
    monkeypatch.setitem(EXPORT_KINDS, "toy", row)
    assert run_main(runs, "--export", "toy") == 0
    assert pl.read_ndjson(runs / "analysis" / "toy.ndjson").height == 1


def test_an_export_that_is_an_option_of_its_own_is_named(runs, capsys):
    assert run_main(runs, "--export", "foxglove") == 2
    assert "--derived-mcap" in capsys.readouterr().err


def test_figures_without_a_browser_are_one_line(runs, monkeypatch, capsys):
    monkeypatch.setattr("dds_trace.cli.outputs.BROWSERS", ("no-such-browser",))
    assert run_main(runs, "--figures", "pdf") == BackendUnavailableError.exit_code
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "--figures" in line]
    assert "apt-get install chromium" in line
    assert (runs / "analysis" / "report.html").is_file(), "the page has the figures"


@pytest.mark.browser
@pytest.mark.parametrize(
    ("kind", "name", "mm"), [("pdf", "figures.pdf", 174), ("pdf-column", "figures-column.pdf", 84)]
)
def test_figures_are_printed_in_the_width_of_a_page_or_column(runs, kind, name, mm):
    if not any(map(shutil.which, BROWSERS)):
        pytest.skip("Chromium is not installed")
    assert run_main(runs, "--figures", kind) == 0
    boxes = re.findall(rb"/MediaBox \[0 0 ([0-9.]+) ", (runs / "analysis" / name).read_bytes())
    assert {round(float(width) / 72 * 25.4) for width in boxes} <= {mm - 1, mm, mm + 1}
    latex = (runs / "analysis" / name).with_suffix(".tex").read_text(encoding="utf-8")
    found = re.findall(rf"(figure.?)\}}\n.+width={mm}mm,page=(\d+)\]\{{(.+)\}}", latex)
    assert found == [("figure*" if kind == "pdf" else "figure", str(at + 1), name) for at in range(len(boxes))]
    assert latex.count("-column}") == ("column" in kind) * len(boxes), "labels of both widths in one paper"


@pytest.mark.parametrize(("is_terminal", "answer", "code"), [(False, "", 0), (True, "y\n", 0), (True, "n\n", 2)])
def test_a_folder_named_as_a_file_is_asked_about(is_terminal, answer, code, runs, monkeypatch, capsys):
    monkeypatch.setattr("os.isatty", lambda _: is_terminal)
    monkeypatch.setattr("sys.stdin", io.StringIO(answer))
    assert run_main(runs, "--out", runs / "a.txt") == code
    assert "a.txt becomes a folder" in capsys.readouterr().err
    assert (runs / "a.txt").is_dir() is (code == 0)
    if code == 0:
        assert run_main(runs, "--out", runs / "a.txt") == 0
        assert "becomes" not in capsys.readouterr().err


def test_a_derived_trace_and_its_layout(runs):
    for _ in range(2):
        assert run_main(runs, "--derived-mcap") == 0
    assert (runs / "analysis" / "latency.derived.foxglove.json").exists()
    assert read_trace(runs / "ping.mcap").event_count == 240  # a trace is never written to


JOB = ("--size", "33KB", "--rate", "10", "--deadline", "50ms", "--reliability", "0.9")


def test_a_recommendation(runs, capsys):
    assert run_trace("choose", runs, *JOB) == 0
    assert "likely" in capsys.readouterr().out  # one run shows no more
    assert run_trace("choose", runs, "--size", "145", *JOB[2:]) == 0
    shown = capsys.readouterr()
    assert "measured: binary 33KB at 10 Hz" in shown.err
    assert "not known: measure it (1 minute)" in shown.out


def test_what_was_chosen_from_is_kept_in_one_folder_and_goes_with_it(runs, capsys, monkeypatch, own_base_folders):
    monkeypatch.setitem(sys.modules, "sklearn", None)
    folder = own_base_folders / "state" / "dds-trace" / "learned"
    for _ in range(2):  # the same runs are kept once
        assert run_trace("choose", runs, "--size", "40KB", *JOB[2:]) == 0
    shown = capsys.readouterr()
    assert str(folder) in shown.err
    assert shown.err.count("dds-trace[learn]") == 2
    (path,) = folder.iterdir()
    assert folder.stat().st_mode & 0o77 == 0
    path.write_text("{")
    assert run_trace("choose", runs, *JOB) == 0  # what was measured needs none of it
    shown = capsys.readouterr()
    assert "dds-trace[learn]" not in shown.err
    assert [str(path) in line for line in shown.err.splitlines() if "left out" in line] == [True]
    shutil.rmtree(folder)
    assert run_trace("choose", runs, *JOB) == 0


def test_topics_of_any_recording(runs, capsys):
    assert run_trace("bag", runs) == 0
    shown = capsys.readouterr().out
    assert "/dds_trace/t1" in shown
    assert "Missing: " in shown
    assert max(len(line) for line in shown.splitlines() if ".mcap" not in line) <= 80
    assert not (runs / "analysis").exists()


@pytest.mark.parametrize(
    ("option", "said"),
    [
        ("--deadline=soon", "20ms"),
        ("--deadline=0ms", "20ms"),
        ("--deadline=", "20ms"),
        ("--deadline=20", "20ms"),
        ("--deadline=-20ms", "20ms"),
        ("--deadline=metric=rtt", "20ms"),
        ("--deadline=20ms latency", "metric="),
        ("--deadline=20ms metric=rtt metric=latency", "metric="),
        ("--deadline=20ms metric=", "no metric ''"),
        ("--deadline=20ms metric=latnecy", f"{', '.join(METRICS)}, outbound, return"),
    ],
)
def test_wrong_values_are_one_line(runs, capsys, option, said):
    assert run_main(runs, option) == 2
    shown = capsys.readouterr().err
    assert said in shown
    assert shown.count("\n") == 1
    assert not (runs / "analysis").exists()


def test_a_deadline_is_taken(runs):
    assert run_main(runs, "--deadline", "20ms") == 0


def freshness(folder, capsys, *arguments):
    """Deadline, messages that surely met it, surely missed it, and of which it cannot be told, of the only run."""
    assert run_main(folder, *arguments, "--report", "json") == 0
    capsys.readouterr()
    report = json.loads((folder / "analysis" / "report.json").read_text())
    (row,) = report["freshness"]
    judged = row["deadline_ns"], row["judged"] - row["missed"], row["missed"], row["unsure"]
    return judged, report["answer"]["remarks"][0]


@pytest.mark.parametrize(
    ("deadline", "expected", "said"),
    [
        ("20ms", (20 * MS, 120, 0, 0), "20 ms for the response (planned send to reply): 0 of 120 messages missed it."),
        # A response takes 2 ms, a latency half of it.
        ("1.5ms", (1_500_000, 0, 120, 0), "120 of 120 messages missed it (100 %)."),
        ("1.5ms metric=response", (1_500_000, 0, 120, 0), "for the response"),
        (" 1500us  metric=rtt ", (1_500_000, 0, 120, 0), "for the round trip: 120 of 120"),
        ("1.5ms metric=latency", (1_500_000, 120, 0, 0), "for the latency: 0 of 120"),
        # 1 ms out, wrong by at most 1 ms: none can be told.
        ("1.5ms metric=outbound", (1_500_000, 0, 0, 120), "for the way out: 0 of 0 messages missed it. 120 more"),
        ("3ms metric=return", (3 * MS, 120, 0, 0), "for the way back: 0 of 120"),
    ],
)
def test_a_deadline_is_for_the_response_or_for_the_metric_that_is_named(runs, capsys, deadline, expected, said):
    judged, remark = freshness(runs, capsys, "--deadline", deadline)
    assert judged == expected
    assert remark.startswith("Deadline of ")
    assert said in remark


def test_the_line_of_the_readme_ranks_what_was_measured(tmp_path, capsys):
    (line,) = [word for word in (ROOT / "README.md").read_text().split("`") if "dds-trace choose" in word]
    *command, folder, options = *shlex.split(line)[:3], shlex.split(line)[3:]
    assert (command, folder, options[0]) == (["dds-trace", "choose"], "runs/", "--size")
    measured = run(payload_bytes=145_000, rate_hz=20.0, planned_messages=120, published=120)
    write_pair(tmp_path / "runs", TIMELINE, runs=[measured])
    assert run_trace("choose", tmp_path / "runs", *options) == 0
    shown = capsys.readouterr().out
    assert "deadline of 50 ms" in shown
    assert "99 % of the messages" in " ".join(shown.split())  # the reliability that the line leaves to its default


def test_a_recommendation_is_printed_once_in_80_columns(runs, capsys):
    for kinds in ([], ["--report", "md"], ["--report", "terminal", "--report", "html"]):
        assert run_trace("choose", runs, *JOB, *kinds) == 0
        shown = capsys.readouterr().out.splitlines()
        assert sum("Job:" in line for line in shown) == 1
        assert [line for line in shown if len(line) > 80 and not line.startswith(("Wrote", "file:"))] == []
