"""What an export makes from a name is as distinct as what has the name, and an id comes back from every reader of CSV."""

import csv
import json
import re
import sqlite3
from collections import defaultdict

import polars as pl
import pyarrow.csv
import pytest
from analyses import Measured, make_analysis
from roundtrip_frames import MS, steady, with_one_way

from dds_trace.analyzer.exports.kinds import EXPORTERS
from dds_trace.extensions.exports.foxglove import write_derived
from dds_trace.extensions.exports.hdr_log import hdr_log
from dds_trace.extensions.exports.history import bencher_json, github_benchmark_files, otava_csv
from dds_trace.extensions.exports.openmetrics import openmetrics_text

ALIKE = ["lidar-2", "lidar_2", "lidar 2", "lidar+2", "/lidar/2", "_lidar_2"]


@pytest.fixture(scope="module")
def alike():
    """Results of which the names differ in signs only, in a last place of the rate, or beyond any limit of a name."""
    long = "x" * 1100
    types = [*ALIKE, *(f"{long}{end}" for end in "ab")]
    return make_analysis(
        *(Measured([5_000_000 + 1000 * n] * 300, data_type=name) for n, name in enumerate(types)),
        *(Measured([9_000_000 + 1000 * n] * 300, rate_hz=rate) for n, rate in enumerate((1000.001, 1000.002))),
    )


def test_each_result_has_a_column_a_benchmark_a_tag_and_labels_of_its_own(alike):
    medians = sorted(alike.summary["latency_p50_ns"].to_list())
    assert len(set(medians)) == 10
    head, row = csv.reader(otava_csv(alike).splitlines())
    assert len(set(head)) == len(head) == 2 + 3 * 10
    found = [float(value) for name, value in zip(head, row, strict=True) if name.endswith("p50") or "p50_" in name]
    assert sorted(found) == pytest.approx(medians, rel=1e-5)
    benchmarks = json.loads(bencher_json(alike))
    assert all(len(name) <= 1024 for name in benchmarks)
    assert sorted(each["latency_p50"]["value"] for each in benchmarks.values()) == pytest.approx(medians)
    entries = json.loads(github_benchmark_files(alike)["github-benchmark-smaller.json"])
    assert len({entry["name"] for entry in entries}) == len(entries) == 2 * 10
    tags = re.findall("^Tag=([^,]+),", hdr_log(alike), re.MULTILINE)
    assert len(tags) == len(set(tags)) == alike.distributions.select("group", "metric").n_unique()
    series = [line.rpartition(" ")[0] for line in openmetrics_text(alike).splitlines() if line[0] != "#"]
    assert len(series) == len(set(series))


@pytest.mark.parametrize(
    "devices", [["pi1", "pi2"], ["pi", "pi", "pi"], [f"host-{n}" for n in range(10)], ["pi", None, "pi", "other"]]
)
def test_the_layout_counts_runs_once_and_names_each_relay(tmp_path, devices):
    frames = [
        steady([5 * MS] * 3, run_id=run_id, relay_id=0x10 + n, relay_device=device)
        for run_id in (0xA1, 0xB2)
        for n, device in enumerate(devices)
    ]
    frames.append(steady([5 * MS], run_id=0xC3, relay_id=0x77, relay_device="pi1"))
    wall = {0xA1: 10**9, 0xB2: 2 * 10**9, 0xC3: 3 * 10**9}
    made = write_derived(with_one_way(pl.concat(frames)), tmp_path / "latency.mcap", wall)
    layout = json.loads(made.layout.read_text())
    labels = {path["value"]: path["label"] for path in layout["configById"]["Plot!latency"]["paths"]}
    assert len(set(labels.values())) == len(labels)
    runs, relays = defaultdict(set), defaultdict(list)
    for value, label in labels.items():
        run, relay = re.search(r"run_(\w+)/relay_(\w+)\.", value).groups()
        runs[int(run, 16)].add(int(re.search(r"run (\d+)", label)[1]))
        relays[int(run, 16)].append((int(relay, 16), label.partition(", relay ")[2]))
    assert runs == {run_id: {number} for number, run_id in enumerate(list(wall)[: len(runs)], 1)}
    for run_id in (0xA1, 0xB2):
        for relay_id, name in relays[run_id]:
            device = devices[relay_id - 0x10]
            assert name == (device if device and devices.count(device) == 1 else f"{relay_id:08x}")
    assert {name for _, name in relays[0xC3]} <= {""}


IDS = [0, 1, 2**53 + 1, 2**63 - 1, 2**63, 2**63 + 1, 2**64 - 1, 17_340_579_277_161_251_965]


def test_a_run_of_the_csv_is_found_by_its_id_in_every_reader(tmp_path):
    duckdb, pandas = (pytest.importorskip(name) for name in ("duckdb", "pandas"))
    rows = pl.concat(steady([5 * MS] * 2, run_id=run_id) for run_id in IDS)
    path = tmp_path / "roundtrips.csv"
    EXPORTERS["csv"](rows.lazy(), path)
    want = [f"{run_id:016x}" for run_id in IDS for _ in range(2)]
    with path.open(newline="") as file:
        reader = csv.DictReader(file)
        assert [row["run_id"] for row in reader] == want
    assert reader.fieldnames == rows.columns
    assert rows["run_id"].dtype == pl.UInt64, "other exports keep numbers"
    assert pyarrow.csv.read_csv(path)["run_id"].to_pylist() == want
    assert pl.read_csv(path)["run_id"].to_list() == want
    assert pandas.read_csv(path)["run_id"].to_list() == want
    assert [text for (text,) in duckdb.sql(f"SELECT run_id FROM read_csv('{path}')").fetchall()] == want
    base = sqlite3.connect(":memory:")
    base.execute("CREATE TABLE rows (run_id TEXT)")
    base.executemany("INSERT INTO rows VALUES (?)", [(text,) for text in want])
    assert [text for (text,) in base.execute("SELECT run_id FROM rows")] == want
