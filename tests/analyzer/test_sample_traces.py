"""Real recordings are replayed: the analyzer against numbers from struct and loops."""

import json

import polars as pl
import pytest
from plain_analysis import METRICS, analyze_plain
from trace_files import SAMPLE_NAMES, SAMPLES

from dds_trace.analyzer.pipeline import analyze

NAMES = sorted(path.name.removesuffix(".expected.json") for path in SAMPLES.glob("*.expected.json"))
STATISTICS = ("mean", "min", "max", "p50", "p90", "p95", "p99", "p99_9")


def expected(name):
    return json.loads((SAMPLES / f"{name}.expected.json").read_text())


def test_the_samples_are_there_and_small():
    assert NAMES == SAMPLE_NAMES
    paths = [path for name in NAMES for path in (SAMPLES / name).iterdir() if path.is_file()]
    assert {path.suffix for path in paths} == {".mcap"}
    assert sum(path.stat().st_size for path in paths) < 2_000_000


@pytest.mark.parametrize("name", NAMES)
def test_the_plain_computation_gives_what_is_kept(name):
    assert analyze_plain(SAMPLES / name) == expected(name)


@pytest.mark.parametrize("name", NAMES)
def test_the_analyzer_gives_the_plain_numbers(name, tmp_path):
    analysis = analyze(SAMPLES / name, out=tmp_path)
    runs = expected(name)["runs"]
    assert len(analysis.summary) == len(runs)  # every run of a sample is a group of its own
    for run_id, run in runs.items():
        rows = analysis.load_roundtrips().filter(pl.col("run_id") == int(run_id, 16))
        assert len(rows) == run["published"]
        assert {key: (rows["outcome"] == key).sum() for key in run["outcomes"]} == run["outcomes"]
        (group,) = analysis.summary.filter(
            *(pl.col(key) == run[key] for key in ("data_type", "payload_bytes", "rate_hz", "bridge"))
        ).to_dicts()
        assert group["vendor"] == run["vendor"] == "fastdds"
        assert group["ping_domain_id"] == run["ping_domain_id"]
        assert group["domain_mode"] == ("same" if name != "different_domains" else "different")
        assert group["published"] == run["published"]
        assert group["received"] == run["outcomes"]["completed"]
        for metric in METRICS:
            assert rows[f"{metric}_ns"].drop_nulls().len() == run[metric]["count"]
            for statistic in STATISTICS:
                found = group[f"{metric}_{statistic}_ns"]
                wanted = run[metric].get(statistic)
                assert found == (None if wanted is None else pytest.approx(wanted, rel=1e-12)), (metric, statistic)


def test_the_sample_with_losses_has_losses():
    (run,) = expected("losses")["runs"].values()
    assert 0 < run["outcomes"]["completed"] < run["published"]
