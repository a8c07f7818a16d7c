"""Real recordings are replayed: the analyzer against the numbers that `bare.py` found when they were recorded."""

import json

import bare
import polars as pl
import pytest
from trace_files import SAMPLE_NAMES, SAMPLES

from dds_trace.analyzer.pipeline import analyze

EXPECTED = {name: json.loads((SAMPLES / f"{name}.expected.json").read_text()) for name in SAMPLE_NAMES}


def test_the_samples_are_there_and_small():
    assert sorted(path.name for path in SAMPLES.iterdir() if path.is_dir()) == SAMPLE_NAMES
    paths = [path for name in SAMPLE_NAMES for path in (SAMPLES / name).iterdir() if path.is_file()]
    assert {path.suffix for path in paths} == {".mcap"}
    assert sum(path.stat().st_size for path in paths) < 2_000_000


@pytest.mark.parametrize("name", SAMPLE_NAMES)
def test_the_analyzer_gives_the_kept_numbers(name):
    summary = analyze(SAMPLES / name).summary
    assert len(summary) == len(EXPECTED[name])  # every run of a sample is a group of its own
    for expected in EXPECTED[name]:
        (group,) = summary.filter(*(pl.col(key) == expected[key] for key in bare.SETTINGS)).to_dicts()
        for column, value in expected.items():
            assert group[column] == (pytest.approx(value, rel=1e-12) if isinstance(value, float) else value), column
        is_bridged = name == "different_domains"
        assert (group["ping_domain_id"], group["domain_mode"]) == ((5, "different") if is_bridged else (10, "same"))


def test_the_sample_with_losses_has_losses():
    (run,) = EXPECTED["losses"]
    assert 0 < run["received"] < run["published"]
