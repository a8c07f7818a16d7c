"""Exports for tools that keep a history, checked against what these publish about their formats; Otava itself finds a made change."""

from __future__ import annotations

import csv
import io
import json
import math
import re
import shutil
import subprocess
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


def test_names_do_not_follow_the_machine_or_what_else_was_measured(tmp_path):
    written = [
        path.name for kind in ("bencher", "github-benchmark", "otava") for path in export(sample(), kind, tmp_path)
    ]
    assert written == ["bencher.json", "github-benchmark-smaller.json", "github-benchmark-bigger.json", "otava.csv"]
    names = list(json.loads((tmp_path / "bencher.json").read_text()))
    assert names
    assert all("payload_bytes=" in name and "_device=" not in name for name in names)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_otava_finds_a_change_of_a_fifth_in_sixty_commits(tmp_path):
    """In an environment of its own: it pins a numpy that is not ours. Seeded; the spread of commits is 5 %."""
    if shutil.which("uv") is None:
        pytest.skip("uv is not installed")
    subprocess.run(["uv", "venv", "-q", "--python", "3.11", tmp_path / "venv"], check=True)
    install = ["uv", "pip", "install", "-q", "--python", tmp_path / "venv/bin/python", "apache-otava==0.8.0"]
    subprocess.run(install, check=True)
    rows = list(csv.reader(io.StringIO(otava_csv(sample()))))
    column = next(index for index, name in enumerate(rows[0]) if name.endswith("latency_p50"))
    factors = np.random.default_rng(20_261_127).normal(1, 0.05, 60) * np.where(np.arange(60) < 40, 1, 1.2)
    lines = [[f"2026-{1 + day // 28:02}-{1 + day % 28:02}T00:00:00Z", f"c{day:02}", *rows[1][2:]] for day in range(60)]
    for line, factor in zip(lines, factors, strict=True):
        line[column] = f"{float(rows[1][column]) * factor:.6g}"
    with (tmp_path / "history.csv").open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([rows[0], *lines])
    (tmp_path / "otava.yaml").write_text(
        f"tests:\n  latency:\n    type: csv\n    file: {tmp_path}/history.csv\n    time_column: time\n    attributes: [commit]\n"
        f"    metrics:\n      p50: {{column: {rows[0][column]}, direction: -1}}\n    csv_options: {{delimiter: ','}}\n"
    )
    otava = [tmp_path / "venv/bin/otava", "--config-file", "otava.yaml", "analyze", "latency", "--since", "2025-01-01"]
    done = subprocess.run(otava, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = re.findall(r"\+(\d+\.\d)%", done.stdout)
    assert len(found) == 1, done.stdout
    assert 12 < float(found[0]) < 28
