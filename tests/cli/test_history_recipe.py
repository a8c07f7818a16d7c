"""The last step of docs/examples/github-history.yml, run on days of which plans, results and knowledge change."""

import csv
import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
import yaml
from analyses import Measured, make_analysis
from otava import otava_alone
from processes import executed

from dds_trace.extensions.exports.history import bencher_json, github_benchmark_files, otava_csv, otava_yaml

ROOT = Path(__file__).parents[2]
STEPS = yaml.safe_load((ROOT / "docs/examples/github-history.yml").read_text())["jobs"]["history"]["steps"]
RECIPE = STEPS[-1]["run"].replace("/srv/history", "history")


def keep_day(folder, text, said="No regressions found in latency.", config="tests: {}\n"):
    """Run the step with an Otava that says something and ends with 0."""
    for name in ("analysis", "history", "bin"):
        (folder / name).mkdir(exist_ok=True)
    (folder / "analysis/otava.csv").write_text(text)
    (folder / "analysis/otava.yaml").write_text(config)
    (folder / "bin/otava").write_text(f"#!/bin/sh\nls latency.csv otava.yaml && echo '{said}'\n")
    (folder / "bin/otava").chmod(0o755)
    words = ["bash", "--noprofile", "--norc", "-e", "-c", RECIPE]
    return executed(words, {"PATH": f"{folder / 'bin'}:{os.environ['PATH']}"}, cwd=folder)


def rows_of(path):
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert all(None not in row and None not in row.values() for row in rows), "as wide as the header"
    return rows


@pytest.mark.parametrize("seed", range(4))
def test_every_value_stays_under_its_name_whatever_a_day_has(tmp_path, seed):
    draw = np.random.default_rng(seed)
    names, days = [f"result_{n}_latency_p50" for n in range(6)], {}
    for day in range(6):
        measured = sorted(draw.choice(names[: 4 + 2 * (day > 3)], int(draw.integers(1, 5)), replace=False))
        values = {name: f"{draw.integers(1, 10**9)}" if draw.random() < 0.7 else "" for name in measured}
        days[f"c{day}"] = values
        text = f"time,commit,{','.join(values)}\n2026-01-0{day + 1}T00:00:00Z,c{day},{','.join(values.values())}\n"
        done = keep_day(tmp_path, text)
        assert done.returncode == 0, done.stderr
        filled = rows_of(tmp_path / "history/filled/latency.csv")
        assert all(value for row in filled for value in row.values()), "Otava reads no empty field"
        for row, stored in zip(filled, rows_of(tmp_path / "history/latency.csv"), strict=True):
            assert {**row, **{name: value for name, value in stored.items() if value}} == row
        for old in (tmp_path / "history").glob("latency-until-*.csv"):
            old.rename(old.with_name(f"old{day}-{old.name}"))  # several files of one second
    read = {}
    for path in (tmp_path / "history").glob("*latency*.csv"):
        for row in rows_of(path):
            commit = row.pop("commit")
            read[commit] = {name: value for name, value in row.items() if value and name != "time"}
    assert read == {day: {name: value for name, value in values.items() if value} for day, values in days.items()}


def test_a_day_without_a_new_result_stays_in_the_file_and_one_with_a_new_result_starts_another(tmp_path):
    first = "time,commit,a,b\n2026-01-01T00:00:00Z,c1,1,\n"
    second = "time,commit,b\n2026-01-02T00:00:00Z,c2,5\n"
    third = "time,commit,a,ab,b\n2026-01-03T00:00:00Z,c3,7,8,9\n"
    for text in (first, second):
        keep_day(tmp_path, text)
    assert (tmp_path / "history/latency.csv").read_text() == first + "2026-01-02T00:00:00Z,c2,,5\n"
    assert (tmp_path / "history/filled/latency.csv").read_text().splitlines()[1:] == [
        "2026-01-01T00:00:00Z,c1,1,5",
        "2026-01-02T00:00:00Z,c2,1,5",
    ]
    keep_day(tmp_path, third)
    assert (tmp_path / "history/latency.csv").read_text() == third
    (old,) = (tmp_path / "history").glob("latency-until-*.csv")
    assert len(rows_of(old)) == 2


@pytest.mark.parametrize(
    ("said", "status"), [("Regressions in latency:", 0), ("ERROR: Number of values in the row does not match", 1)]
)
def test_an_otava_that_analyzed_nothing_fails_the_step(tmp_path, said, status):
    done = keep_day(tmp_path, "time,commit,a\n2026-01-01T00:00:00Z,c1,1\n", said)
    assert done.returncode == status, done.stderr
    assert said in done.stdout


LOST = ["lost_outbound"] * 20


def test_an_export_has_every_column_of_its_plan_and_leaves_out_what_is_not_known():
    sizes = (100, 33_000, 145_000)
    whole, lossy = (
        make_analysis(*(Measured(messages, payload_bytes=size) for messages, size in zip(groups, sizes, strict=True)))
        for groups in ([[5_000_000] * 2000] * 3, [[5_000_000] * 20, LOST, [5_000_000] * 2000])
    )
    heads = []
    for analysis in (whole, lossy):
        head, row = csv.reader(otava_csv(analysis).splitlines())
        heads.append(head)
        assert len(head) == len(row) == 2 + 3 * 3
        metrics = yaml.safe_load(otava_yaml(analysis))["tests"]["latency"]["metrics"]
        assert list(metrics) == [metric["column"] for metric in metrics.values()] == head[2:]
        assert all(metric["direction"] == (1 if "received" in name else -1) for name, metric in metrics.items())
    assert heads[0] == heads[1]
    values = dict(zip(head, row, strict=True))
    (lost,) = {name.partition("_latency")[0] for name in head if "_33000_" in name and "_latency" in name}
    assert [values[f"{lost}_{name}"] for name in ("latency_p50", "latency_p99", "received_ratio")] == ["", "", "0"]
    (benchmark,) = [measures for name, measures in json.loads(bencher_json(lossy)).items() if "=33000 " in name]
    assert benchmark == {"received_ratio": {"value": 0.0}}
    smaller = json.loads(github_benchmark_files(lossy)["github-benchmark-smaller.json"])
    assert not [entry for entry in smaller if "=33000 " in entry["name"]]


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_otava_sees_a_third_more_where_a_value_is_missing(tmp_path):
    """Commits vary by 3 %."""
    otava = otava_alone(tmp_path)
    analysis = make_analysis(*(Measured([5_000_000] * 2000, payload_bytes=size) for size in (100, 33_000)))
    head, row = csv.reader(otava_csv(analysis).splitlines())
    slower = next(at for at, name in enumerate(head) if "_33000_" in name and name.endswith("p50"))
    draw = np.random.default_rng(20_261_128)
    for day in range(40):
        values = [f"{float(value) * draw.normal(1, 0.03):.6g}" for value in row[2:]]
        values[slower - 2] = f"{5e6 * draw.normal(1, 0.03) * (1.3 if day >= 25 else 1):.6g}"
        values[day % len(values)] = ""
        text = f"{','.join(head)}\n2026-{9 + day // 28:02}-{1 + day % 28:02}T00:00:00Z,c{day},{','.join(values)}\n"
        keep_day(tmp_path, text, config=otava_yaml(analysis))
    done = subprocess.run(
        [otava, "analyze", "latency", "--config-file", "otava.yaml", "--since", "2026-01-01",
         "--output", "regressions_only"],
        cwd=tmp_path / "history/filled", capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "ERROR" not in done.stderr
    assert head[slower] in done.stdout
