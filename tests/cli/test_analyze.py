import json
import shutil

import polars as pl
import pytest
from card_bags import MS, START_NS, write_mcap
from commands import run_main as analyze
from commands import run_trace
from trace_files import TWELVE, run, write_pair

from dds_trace.cli.outputs import DESKTOP_VARIABLES


def test_a_folder_gives_a_table_and_two_files(runs, capsys):
    assert analyze(runs) == 0
    shown = capsys.readouterr()
    assert f"Wrote {runs / 'analysis' / 'roundtrips.parquet'}" in shown.out
    assert f"Wrote {runs / 'analysis' / 'summary.parquet'}" in shown.out
    assert "Fast DDS" in shown.out
    assert shown.err == ""
    assert pl.read_parquet(runs / "analysis" / "roundtrips.parquet")["latency_ns"].to_list() == [85] * 12
    assert sorted(path.name for path in (runs / "analysis").iterdir()) == ["roundtrips.parquet", "summary.parquet"]
    shutil.rmtree(runs / "analysis")
    assert analyze(runs, "--sketch") == 0
    assert [path.name for path in (runs / "analysis").iterdir()] == ["summary.parquet"]


def test_reports_are_those_asked_for_and_written_where_asked(runs, tmp_path, capsys):
    assert analyze(runs, "--report", "html", "--report", "json", "--report", "md", "--out", tmp_path / "here") == 0
    *answer, last = capsys.readouterr().out.splitlines()
    answer, lines = answer[:-5], answer[-5:]
    assert answer[0].startswith("runs: 12 messages")
    assert answer[-1].startswith("--all shows")
    assert all(line.startswith(f"Wrote {tmp_path / 'here'}") for line in lines)
    assert last == f"file://{tmp_path}/here/report.html"
    assert not (runs / "analysis").exists()
    assert (tmp_path / "here" / "report.html").exists()
    json.loads((tmp_path / "here" / "report.json").read_text())


@pytest.mark.parametrize(("desktop", "opens"), [("", True), (":0", True), (":0", False)])
def test_open_shows_the_page_where_there_is_a_desktop(runs, capsys, monkeypatch, desktop, opens):
    for name in DESKTOP_VARIABLES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("DISPLAY", desktop)
    opened = []
    monkeypatch.setattr("webbrowser.open", lambda uri: opened.append(uri) or opens)
    assert analyze(runs, "--open") == 0
    shown = capsys.readouterr()
    page = (runs / "analysis" / "report.html").as_uri()
    assert shown.out.splitlines()[-1] == page  # the last line, and the tables of the terminal above it
    assert "Fast DDS" in shown.out
    assert opened == ([page] if desktop else [])
    assert shown.err.count("\n") == ("no desktop here" in shown.err) == (not (desktop and opens))


def test_a_second_analysis_replaces_the_first(runs):
    assert analyze(runs) == 0
    first = (runs / "analysis" / "roundtrips.parquet").read_bytes()
    assert analyze(runs) == 0
    assert (runs / "analysis" / "roundtrips.parquet").read_bytes() == first


def test_an_error_of_a_report_leaves_all_earlier_files(runs, monkeypatch, capsys):
    every = ("--report", "html", "--report", "md", "--export", "csv", "--derived-mcap")
    assert analyze(runs, *every) == 0
    before = {path.name: path.read_bytes() for path in (runs / "analysis").iterdir()}
    write_pair(runs / "more", TWELVE, runs=[run(run_id=0xB2)])
    monkeypatch.setattr("dds_trace.extensions.exports.foxglove.foxglove_layout", lambda _: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        analyze(runs, *every)
    assert {path.name: path.read_bytes() for path in (runs / "analysis").iterdir()} == before
    monkeypatch.undo()
    capsys.readouterr()
    assert analyze(runs, *every) == 0
    assert "earlier analysis" not in capsys.readouterr().err
    after = {path.name: path.read_bytes() for path in (runs / "analysis").iterdir()}
    assert after.keys() == before.keys()
    assert all(after[name] != before[name] for name in ("summary.parquet", "report.html", "report.md", "summary.csv"))


def test_files_of_an_earlier_analysis_of_other_traces_are_named(runs, capsys):
    assert analyze(runs, "--report", "md") == 0
    assert analyze(runs) == 0
    assert "earlier analysis" not in capsys.readouterr().err
    write_pair(runs / "more", TWELVE, runs=[run(run_id=0xB2)])
    assert analyze(runs) == 0
    assert "report.md: of an earlier analysis" in capsys.readouterr().err


def test_doubts_that_spoil_numbers_are_in_the_answer(tmp_path, capsys):
    write_pair(tmp_path, TWELVE, runs=[run(published=99)])
    assert analyze(tmp_path) == 0
    assert "✗ Missing publications: 87 of 99" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("make", "status", "text"),
    [
        (lambda folder: folder.mkdir(), 4, "empty"),
        (lambda folder: folder.exists(), 4, "no such"),
        (lambda folder: folder.write_bytes(b"no trace"), 3, "not a MCAP file"),
    ],
)
def test_errors_are_one_line_and_an_exit_code(tmp_path, capsys, make, status, text):
    make(tmp_path / "runs")
    assert analyze(tmp_path / "runs") == status
    shown = capsys.readouterr()
    assert shown.out == ""
    assert text in shown.err
    assert shown.err.count("\n") == 1


def test_a_folder_that_cannot_be_written(runs, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert analyze(runs, "--out", tmp_path / "file" / "below") == 6
    assert "--out" in capsys.readouterr().err


def test_an_unknown_report_is_refused_before_anything_is_read(runs, capsys, sentences):
    assert analyze(runs, "--report", "pdf") == 2
    sentences(capsys.readouterr().err.splitlines()[-1])
    assert not (runs / "analysis").exists()


def test_several_paths_and_patterns_are_one_analysis(runs, tmp_path, capsys, monkeypatch):
    """Of what they have in common: its name, its analysis/ for the results; each trace counts once."""
    others = tmp_path / "others"
    write_pair(others / "deep", TWELVE, runs=[run(run_id=99, planned_messages=12, published=12)])
    monkeypatch.chdir(tmp_path)
    for given in (["runs", others / "deep"], ["runs/*.mcap", "others/**/*.mcap"], ["runs", "r*s", "others"]):
        assert analyze(*given) == 0
        shown = capsys.readouterr()
        assert shown.out.startswith(f"{tmp_path.name}: 24 messages in 2 runs")
        rows = pl.read_parquet(tmp_path / "analysis" / "roundtrips.parquet")
        assert rows["run_id"].unique().len() == 2
        assert len(rows) == 2 * len(TWELVE)
        assert shown.err == ""
    assert analyze("nothing/*.mcap", "runs") == 4
    assert "nothing/*.mcap: no file or folder matches" in capsys.readouterr().err
    assert analyze("runs", "gone") == 4
    assert "gone: no such file or folder" in capsys.readouterr().err
    assert analyze("s3://bucket/a", "runs") == 2
    assert "only one path in object storage" in capsys.readouterr().err
    assert run_trace("bag", *runs.glob("*.mcap")) == 0  # the topics of both files, ours or not
    assert "/dds_trace/t1" in capsys.readouterr().out


def test_recordings_of_others_are_shown_the_way_to_topics(tmp_path, capsys):
    for name in ("a", "b"):
        write_mcap(tmp_path / f"{name}.mcap", [("/imu", 1, 1, b"1234")])
    for given, status in ((tmp_path, 4), (tmp_path / "a.mcap", 3)):
        assert analyze(given) == status
        said = capsys.readouterr().err
        assert said.count("dds-trace bag") == said.count("\n") == 1
    assert run_trace("bag", tmp_path) == 0


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    numbers = {"/camera": set(range(100)) - {40, 70}, "/event": {3, 4, 80}}
    messages = [(name, START_NS + n * 10 * MS, 0, b"1234") for name in numbers for n in sorted(numbers[name])]
    return write_mcap(tmp_path_factory.mktemp("bag") / "x.mcap", messages)


@pytest.mark.parametrize(
    ("gate", "code"),
    [
        ("missing(/camera) > 3%", 0),
        ("missing(/camera) > 1%", 20),
        ("missing(/c*) >= 2%", 20),
        ("hole(/camera) > 9ms", 20),
        ("jitter(/*) > 90s", 0),
        ("missing(/event) > 1%", 21),  # not periodic: nothing is known
        ("missing(/none) > 1%", 2),
        ("missing(/camera) > 1ms", 2),
        ("lost(/camera) > 1%", 2),
        ("missing > 1%", 2),
    ],
)
def test_limits_on_topics(bag, capsys, gate, code):
    assert run_trace("bag", bag, "--fail-if", gate) == code
    shown = capsys.readouterr()
    assert gate in (shown.err if code == 2 else shown.out)
    assert run_trace("bag", bag) == 30
    assert analyze(bag, "--fail-if", gate) == 2  # limits of latency are those of a comparison


def test_a_file_of_limits_made_from_a_good_bag_judges_others(bag, tmp_path, capsys):
    file = tmp_path / "limits.toml"
    assert run_trace("bag", bag, "--write-limits", file) == 30
    assert run_trace("bag", bag, "--write-limits", file) == 6
    assert analyze(bag, "--write-limits", file) == 2
    written = file.read_text()
    assert '[thresholds."/camera"]\nrate = ' in written
    assert "/event" not in written  # no rhythm
    capsys.readouterr()
    for text, code in (
        (written, 0),
        (written.replace("/camera", "/c*"), 0),
        (
            written + '[thresholds."/cam*"]\nrate = "> 99.5 Hz"\n[thresholds]\nlatency_p50 = "< 1 ns"\n',
            20,
        ),  # later ones
        (written + '[thresholds."/lidar"]\nmissing = "< 1 %"\n', 20),  # what there has to be
        ('[thresholds."/camera"]\nreceived_ratio = "> 98.5 %"\n', 20),
        ('[thresholds."/event"]\nhole = "< 1 s"\n', 21),
        ('[thresholds."/camera"]\nrate = "> 5 ms"\n', 2),
        ('[thresholds."vendor=x"]\nrate = "> 5 Hz"\n', 2),
    ):
        file.write_text(text)
        assert (text, run_trace("bag", bag, "--limits", file)) == (text, code)
    assert run_trace("bag", bag, "--limits", tmp_path / "none") == 2


def test_reports_of_topics(runs, tmp_path, capsys):
    kinds = [f"--{kind}" for kind in ("report=html", "report=md", "report=json", "export=csv", "export=arrow")]
    assert run_trace("bag", runs, *kinds, "--out", tmp_path / "files") == 0
    names = {path.name for path in (tmp_path / "files").iterdir()}
    assert names == {f"topics.{ending}" for ending in ("html", "md", "json", "csv", "arrow")}
    assert all(name in capsys.readouterr().out for name in [*names][:1])
    page = (tmp_path / "files" / "topics.html").read_text()
    assert "<svg" in page
    assert page.count("<script") == 1  # the theme
    written = json.loads((tmp_path / "files" / "topics.json").read_text())
    assert [written["verdict"], *(one["certain"] for one in written["recordings"])] == ["unknown", False, False]
    named = {"name", "messages", "missing", "missing_low", "missing_high", "holes", "jitter_ns", "backward_stamps"}
    assert all(named <= topic.keys() for topic in written["topics"])
    assert "trace/t1" in (tmp_path / "files" / "topics.md").read_text()
