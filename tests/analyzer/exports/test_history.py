"""Exports for tools that keep a history, checked against what these publish about their formats."""

import csv
import io
import json
import math
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from analyses import empty_folder, hostile, make_analysis, one_message, ping_without_relay

from dds_trace.analyzer.exports.history import bencher_json, github_benchmark_files, otava_csv
from dds_trace.analyzer.exports.kinds import export
from dds_trace.analyzer.pipeline import analyze


@cache
def sample():
    return analyze(Path(__file__).parents[3] / "sample_traces" / "same_domain")


ANALYSES = (sample, make_analysis, empty_folder, one_message, ping_without_relay, hostile)


@pytest.mark.parametrize("make", ANALYSES)
def test_bencher_metric_format(make):
    """`{benchmark: {measure: {value, lower_value?, upper_value?}}}`, numbers only; names of 1,024 and 64 characters."""
    analysis = make()
    benchmarks = json.loads(bencher_json(analysis))
    assert len(benchmarks) <= len(analysis.summary)
    for name, measures in benchmarks.items():
        assert 0 < len(name) <= 1024
        assert name.isprintable()
        for measure, metric in measures.items():
            assert 0 < len(measure) <= 64
            assert "value" in metric
            assert metric.keys() <= {"value", "lower_value", "upper_value"}
            assert all(isinstance(number, (int, float)) and math.isfinite(number) for number in metric.values())
            assert metric.get("lower_value", -math.inf) <= metric["value"] <= metric.get("upper_value", math.inf)
    medians = sorted(m["latency_p50"]["value"] for m in benchmarks.values() if "latency_p50" in m)
    known = analysis.details.intervals.filter(metric="latency", percentile="p50")["estimate_ns"].drop_nulls()
    assert medians == pytest.approx(sorted(value for value in known.to_list() if math.isfinite(value)))


@pytest.mark.parametrize("make", ANALYSES)
def test_the_format_of_github_action_benchmark(make):
    """`[{name, unit, value, range?, extra?}]`, not empty; `name` joins the points of a series."""
    for file, text in github_benchmark_files(make()).items():
        entries = json.loads(text)
        assert entries
        assert len({entry["name"] for entry in entries}) == len(entries)
        for entry in entries:
            assert {"name", "unit", "value"} <= entry.keys() <= {"name", "unit", "value", "range"}
            assert isinstance(entry["value"], (int, float))
            assert entry["unit"] == {"smaller": "ns", "bigger": "%"}[re.search("smaller|bigger", file)[0]]
            assert entry.get("range", "\u00b1 1").startswith("\u00b1 ")


@pytest.mark.parametrize("make", ANALYSES)
def test_otava_reads_a_row_with_time_and_commit(make, monkeypatch):
    monkeypatch.setenv("GITHUB_SHA", "1a2b3c4")
    header, row = csv.reader(io.StringIO(otava_csv(make())))
    assert header[:2] == ["time", "commit"]
    assert len(set(header)) == len(header) == len(row)
    assert row[1] == "1a2b3c4"
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", row[0])
    assert all(re.fullmatch(r"\w+", name) for name in header)
    assert all(math.isfinite(float(value)) for value in row[2:])


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_otava_finds_a_change_of_a_fifth_in_sixty_commits(tmp_path):
    """In an environment of its own, as it pins a numpy; commits vary by 5 %."""
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "venv"], check=True)
    if subprocess.run([tmp_path / "venv/bin/pip", "install", "-q", "apache-otava==0.8.0"], check=False).returncode:
        pytest.skip("no package index")
    header, row = csv.reader(io.StringIO(otava_csv(sample())))
    column = next(index for index, name in enumerate(header) if name.endswith("latency_p50"))
    factors = np.random.default_rng(20_261_127).normal(1, 0.05, 60) * np.repeat([1, 1.2], [40, 20])
    lines = [header]
    for number, factor in enumerate(factors):
        times = [
            f"{float(row[column]) * factor:.6g}" if index == column else row[index] for index in range(2, len(row))
        ]
        lines.append([f"2026-{1 + number // 28:02}-{1 + number % 28:02}T00:00:00Z", f"c{number:02}", *times])
    (tmp_path / "latency.csv").write_text("".join(",".join(line) + "\n" for line in lines))
    (tmp_path / "otava.yaml").write_text(
        "tests: {latency: {type: csv, file: latency.csv, time_column: time, attributes: [commit], "
        f"metrics: {{p50: {{column: {header[column]}, direction: -1}}}}, csv_options: {{delimiter: ','}}}}}}\n"
    )
    otava = [tmp_path / "venv/bin/otava", "analyze", "latency", "--config-file", "otava.yaml", "--since", "2025-01-01"]
    shown = subprocess.run(otava, cwd=tmp_path, capture_output=True, text=True, check=True).stdout.splitlines()
    (change,) = [index for index, line in enumerate(shown) if "%" in line]
    assert "c40" in shown[change + 2]


def test_names_do_not_follow_the_machine_or_what_else_was_measured(tmp_path):
    written = [
        path.name for kind in ("bencher", "github-benchmark", "otava") for path in export(sample(), kind, tmp_path)
    ]
    assert written == ["bencher.json", "github-benchmark-smaller.json", "github-benchmark-bigger.json", "otava.csv"]
    names = list(json.loads((tmp_path / "bencher.json").read_text()))
    assert names
    assert all("payload_bytes=" in name and "_device=" not in name for name in names)
