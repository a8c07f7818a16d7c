import json
import re
import sys

import polars as pl
import pyarrow.parquet as pq
import pytest
from one_row import ROOT, with_rows
from page_reader import unpacked
from processes import executed
from trace_files import Message, run, write_pair

from dds_trace.analyzer.statistics.percentiles import PERCENTILES

MS = 1_000_000


def analyze_with(tmp_path, file, rows, runs, *options):
    environment = with_rows(tmp_path, file, rows)
    (tmp_path / "traces").mkdir()
    for number, of_run in enumerate(runs, 1):
        messages = [
            Message(n, t0=n * MS, t1=n * MS, t3=n * MS + 100 + n, t4=n * MS + 300, t2=n * MS + 900) for n in range(40)
        ]
        (tmp_path / "traces" / str(number)).mkdir()
        write_pair(tmp_path / "traces" / str(number), messages, runs=[of_run])
    out = tmp_path / "out"
    command = "from dds_trace.cli.dds_analyze import main; main()"
    reports = [option for kind in ("html", "md", "json", "terminal") for option in ("--report", kind)]
    ran = executed(
        [sys.executable, "-c", command, str(tmp_path / "traces"), "--out", str(out), "--all", *reports, *options],
        env=environment,
    )
    assert ran.returncode == 0, ran.stderr
    (out / "terminal.txt").write_text(ran.stdout, encoding="utf-8")
    return out


METRIC = {'        Metric("response",': '        Metric("hold", "Hold in relay", (_t4 - _t3) * 2, "twice T4 - T3"),\n'}

STATISTIC = {
    '    GroupStatistic(\n        "max",': """\
    GroupStatistic(
        "mad",
        "mean deviation",
        lambda ordered_ns: float(abs(ordered_ns - ordered_ns.mean()).mean()),
        lambda sketch: float(np.average(abs(sketch.histogram.value_ns - sketch.mean), weights=sketch.histogram.count)),
        is_tabled=True,
    ),
"""
}
FINDING = {
    "    sending.schedule_not_held,": """\
    RESULTS.warning(
        "lone_spike",
        "The longest time in the relay is longer than the median",
        pl.col("intermediate_max_ns") > pl.col("intermediate_p50_ns"),
        "The longest time took {intermediate_max_ns:duration}, the median {intermediate_p50_ns:duration}.",
        "Look at the timeline.",
    ),
"""
}

FOLLOWING = {
    "tests/analyzer/findings/test_findings.py": "few_samples or fewer_samples",
    "tests/analyzer/groups/test_summary.py": "one_group",
    "tests/analyzer/saving/test_saved_analysis.py": "comes_back and small",
    "tests/reports/test_reporters.py": "small and not schema",
}
"""Tests that once repeated the tables of metrics and statistics; the schema of the report follows by `just schemas`."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "rows"),
    [
        ("analyzer/model/metrics.py", METRIC),
        ("analyzer/statistics/percentiles.py", STATISTIC),
        ("analyzer/findings/table.py", FINDING),
    ],
    ids=["metric", "statistic", "finding"],
)
def test_tests_of_outputs_follow_a_new_row(tmp_path, file, rows):
    environment = with_rows(tmp_path, file, rows)
    options = [
        "-q",
        "-n",
        "0",
        "-m",
        "not slow and not browser",
        "-k",
        " or ".join(f"({words})" for words in FOLLOWING.values()),
        "-p",
        "no:cacheprovider",
    ]
    ran = executed([sys.executable, "-m", "pytest", *options, *FOLLOWING], cwd=ROOT, env=environment)
    assert ran.returncode == 0, ran.stdout[-3000:]


def test_a_metric_is_one_row_of_the_table_of_metrics(tmp_path):
    out = analyze_with(tmp_path, "analyzer/model/metrics.py", METRIC, [run()])

    assert pl.read_parquet(out / "roundtrips.parquet")["hold_ns"].to_list() == [2 * (200 - n) for n in range(40)]
    field = pq.read_schema(out / "roundtrips.parquet").field("hold_ns")
    assert field.metadata == {b"unit": b"ns", b"meaning": b"twice T4 - T3; null where an input is missing"}
    (group,) = pl.read_parquet(out / "summary.parquet").to_dicts()
    assert (group["hold_min_ns"], group["hold_p50_ns"], group["hold_max_ns"]) == (322, 361, 400)

    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert report["groups"][0]["hold_p50_ns"] == 361
    assert [row["messages"] for row in report["intervals"] if row["metric"] == "hold"] == [40] * len(PERCENTILES)
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "Hold in relay" in unpacked(page.split('data-packed="data">')[1].partition("<")[0])
    (few,) = (finding for finding in report["findings"] if finding["code"] == "few_samples")
    assert "hold" in few["what"]


@pytest.mark.parametrize("sketch", [(), ("--sketch",)], ids=["whole", "sketch"])
def test_a_statistic_is_one_row_of_the_table_of_statistics(tmp_path, sketch):
    out = analyze_with(tmp_path, "analyzer/statistics/percentiles.py", STATISTIC, [run()], *sketch)

    (group,) = pl.read_parquet(out / "summary.parquet").to_dicts()
    assert group["intermediate_mad_ns"] == (pytest.approx(10, abs=1) if sketch else 10)
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert report["groups"][0]["intermediate_mad_ns"] == group["intermediate_mad_ns"]
    assert [row["mad_ns"] is None for row in report["one_way"]] == [False, False]
    page = (out / "report.html").read_text(encoding="utf-8")
    data = unpacked(page.split('data-packed="data">')[1].partition("<")[0])
    assert '"label":"mean deviation"' in data.replace(": ", ":")
    for text in ("report.md", "terminal.txt"):
        assert re.search(r"\bmad\b", (out / text).read_text(encoding="utf-8")), text


def test_a_finding_is_one_row_of_the_table_of_checks(tmp_path):
    out = analyze_with(tmp_path, "analyzer/findings/table.py", FINDING, [run()])

    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    (found,) = (finding for finding in report["findings"] if finding["code"] == "lone_spike")
    assert re.search(r"\d ns", found["what"])
    for text in ("report.md", "terminal.txt"):
        assert "The longest time took" in " ".join((out / text).read_text(encoding="utf-8").split()), text


def test_a_parameter_is_one_row_of_the_key_and_its_value(tmp_path):
    rows = {
        "\n    def values(self)": '    tuning: Annotated[str, ParameterSpec(KeyPart.SETTINGS, pl.String, "label tuning")]\n',
        "        connectivity=ping.connectivity,\n": '        tuning=run.labels.get("tuning", "none"),\n',
    }
    runs = [run(run_id=1, labels={"tuning": "none"}), run(run_id=2, labels={"tuning": "rmem"})]
    out = analyze_with(tmp_path, "analyzer/model/parameters.py", rows, runs)

    for kind in ("roundtrips", "summary"):  # columns are appended to the contract, never put between others
        assert pq.read_schema(out / f"{kind}.parquet").names[-1] == "tuning"
    summary = pl.read_parquet(out / "summary.parquet")
    assert summary["tuning"].to_list() == ["none", "rmem"]
    assert summary["published"].to_list() == [40, 40]
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert "mixed_labels" not in {finding["code"] for finding in report["findings"]}
    assert "tuning rmem" in (out / "report.md").read_text(encoding="utf-8")
