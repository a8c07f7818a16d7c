"""Batches that an earlier analysis made whole: the same rows, neither read nor paired again, and never those of anything else."""

from __future__ import annotations

import shutil
from contextlib import nullcontext
from pathlib import Path

import pytest
from campaigns import assert_as_without_cache, payload_sizes, write_runs
from file_damage import DAMAGES

from dds_trace.analyzer.cache import parquet_join as row_parts
from dds_trace.analyzer.engines import batches, cached_batches, cached_details, local
from dds_trace.analyzer.engines.cached_batches import encoded_batch
from dds_trace.analyzer.engines.cached_details import KnownDetails
from dds_trace.analyzer.groups import timeline
from dds_trace.analyzer.pipeline import analyze
from dds_trace.base.errors import OutputError
from dds_trace.base.threads import InlineExecutor


class NearWorkers:
    """What worker processes do, done in this process."""

    count = 1

    def __init__(self, cache, folder):
        self._cache, self._folder = cache, folder

    def work(self, batch, parts, keys):
        known = KnownDetails(self._cache, keys) if self._cache else None
        return InlineExecutor().submit(encoded_batch, batch, parts, known, self._folder)

    def map(self, function, items):
        return map(function, items)

    def telling(self):
        return nullcontext()

    def close(self):
        pass


@pytest.fixture(autouse=True)
def near_workers(tmp_path, monkeypatch):
    """Each group is a batch of its own, which workers work at."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(batches, "BATCH_EVENTS", 1_000)
    monkeypatch.setattr(batches, "_ends_batch", lambda *_: True)
    monkeypatch.setattr(local, "COST_FOR_PROCESSES", 1)
    monkeypatch.setattr(
        local.LocalEngine, "_start_workers", lambda engine: NearWorkers(engine._cache, folder)
    )
    return folder


@pytest.fixture
def worked(monkeypatch):
    """The payload sizes of the batches that an analysis with a cache paired, in bytes."""
    sizes = []

    def work(batch, parts, known):
        if known is not None:
            sizes.extend(payload_sizes(batch))
        return real(batch, parts, known)

    real = cached_batches.work_at
    monkeypatch.setattr(cached_batches, "work_at", work)
    return sizes


@pytest.fixture
def kept(cached):
    """Paths of the rows in the cache."""
    return lambda: cached("rows")


def test_a_second_analysis_pairs_nothing_and_says_the_same(runs, worked, tmp_path, near_workers):
    analyze(runs, cache=True, out=tmp_path / "first")
    assert worked == [1000, 1001, 1002]
    worked.clear()
    found = analyze(runs, cache=True, out=tmp_path / "again")
    assert worked == []
    assert list(near_workers.iterdir()) == []
    assert_as_without_cache(runs, found)
    for name in ("roundtrips.parquet", "summary.parquet"):
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / "first" / name).read_bytes(), name


def test_rows_are_joined_from_where_the_cache_keeps_them(
    runs, kept, tmp_path, near_workers, joined, monkeypatch
):
    """Written once by whoever encodes them, and still there behind it; not where they could not be kept."""
    for name in ("first", "again"):
        analyze(runs, cache=True, out=tmp_path / name)
        assert sorted(path for path in joined if isinstance(path, Path)) == kept() != []
        joined.clear()
    monkeypatch.setattr(cached_details, "MOST_BYTES", 100)
    analyze(runs, cache=True, deadline_ns=1, out=tmp_path / "other")
    assert {path.parent for path in joined if isinstance(path, Path)} == {near_workers}
    for name in ("again", "other"):
        whole = (tmp_path / name / "roundtrips.parquet").read_bytes()
        assert whole == (tmp_path / "first/roundtrips.parquet").read_bytes(), name


def test_rows_that_are_removed_before_they_are_joined_are_one_line(runs, kept, monkeypatch):
    real = row_parts.JoinedParts.add

    def add(self, part):
        for path in kept():
            path.unlink()
        real(self, part)

    monkeypatch.setattr(row_parts.JoinedParts, "add", add)
    with pytest.raises(OutputError, match=r"\.rows was removed while it was needed; analyze again$"):
        analyze(runs, cache=True, out=runs / "out")


def test_a_new_run_is_paired_with_its_group_alone(runs, worked):
    analyze(runs, cache=True)
    worked.clear()
    write_runs(runs, [7], groups=3)
    found = analyze(runs, cache=True)
    assert worked == [1001]
    assert_as_without_cache(runs, found)


def test_a_new_group_before_the_others_numbers_them_anew(tmp_path, worked):
    runs = tmp_path / "runs"
    write_runs(runs, [1, 2, 4, 5], groups=3)  # 1001 and 1002 bytes
    analyze(runs, cache=True)
    worked.clear()
    write_runs(runs, [3], groups=3)  # 1000 bytes: the first group now; the fifth run of at most eight
    found = analyze(runs, cache=True)
    assert 1000 in worked
    assert found.timeline["group"].unique().sort().to_list() == [0, 1, 2]
    assert_as_without_cache(runs, found)
    worked.clear()
    write_runs(runs, [7], groups=3)
    assert_as_without_cache(runs, analyze(runs, cache=True))
    assert worked == [1001]


def test_what_is_drawn_changes_where_the_number_of_runs_passes_a_power_of_two(runs, worked, monkeypatch):
    monkeypatch.setattr(timeline, "_ALL_POINTS", 96)
    monkeypatch.setattr(timeline, "_POINTS_OF_EXCHANGE", (4, 100))
    analyze(runs, cache=True)
    worked.clear()
    write_runs(runs, [6, 9], groups=3)  # both 1000 bytes; eight runs
    assert_as_without_cache(runs, analyze(runs, cache=True))
    assert worked == [1000]
    worked.clear()
    write_runs(runs, [12], groups=3)
    assert_as_without_cache(runs, analyze(runs, cache=True))
    assert worked == [1000, 1001, 1002]


@pytest.mark.parametrize(
    ("exchanges", "points"), [(0, 8), (1, 8), (2, 8), (3, 4), (4, 4), (5, 2), (8, 2), (9, 2)]
)
def test_the_share_of_points_changes_at_powers_of_two(exchanges, points, monkeypatch):
    monkeypatch.setattr(timeline, "_ALL_POINTS", 16)
    monkeypatch.setattr(timeline, "_POINTS_OF_EXCHANGE", (2, 8))
    assert timeline.points_of_exchange(exchanges) == points


def test_events_that_two_traces_hold_are_compared_each_time(runs, worked, kept):
    """Which of two traces is the copy follows from their names, and rows that are known would not say."""
    shutil.copy(runs / "ping2.mcap", runs / "copy.mcap")
    assert_as_without_cache(runs, analyze(runs, cache=True))
    assert len(kept()) == 2
    worked.clear()
    found = analyze(runs, cache=True)
    assert worked == [1002]
    assert_as_without_cache(runs, found)


@pytest.mark.parametrize("asked", [{"deadline_ns": 500}, {"details": False}])
def test_what_was_asked_for_is_part_of_what_is_known(runs, worked, asked):
    analyze(runs, cache=True)
    worked.clear()
    assert_as_without_cache(runs, analyze(runs, cache=True, **asked), **asked)
    assert worked == [1000, 1001, 1002]


def test_other_code_pairs_anew(runs, worked, monkeypatch):
    analyze(runs, cache=True)
    worked.clear()
    monkeypatch.setattr(cached_details, "code_of_analysis", lambda: ("another",))
    analyze(runs, cache=True)
    assert len(worked) == 3


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_and_foreign_rows_are_paired_anew(runs, worked, kept, damage):
    analyze(runs, cache=True)
    worked.clear()
    assert len(kept()) == 3
    for path in kept():
        damage(path)
    assert_as_without_cache(runs, analyze(runs, cache=True))
    assert worked == [1000, 1001, 1002]


def test_rows_without_their_details_are_paired_anew(runs, worked, cached):
    analyze(runs, cache=True)
    worked.clear()
    for path in cached("details"):
        path.unlink()
    assert_as_without_cache(runs, analyze(runs, cache=True))
    assert worked == [1000, 1001, 1002]


@pytest.mark.parametrize("missing", ["rows", "number", "counts", "timeline"])
def test_sealed_rows_without_a_part_are_paired_anew(runs, worked, take_out_of_cached, missing):
    analyze(runs, cache=True)
    worked.clear()
    take_out_of_cached("rows", missing)
    assert_as_without_cache(runs, analyze(runs, cache=True))
    assert worked == [1000, 1001, 1002]


def test_rows_that_are_too_large_are_not_kept(runs, kept, monkeypatch):
    monkeypatch.setattr(cached_details, "MOST_BYTES", 100)
    assert_as_without_cache(runs, analyze(runs, cache=True))
    assert kept() == []


def test_a_full_disk_costs_the_cache_alone(runs, kept, full_disk):
    full_disk("write")
    assert_as_without_cache(runs, analyze(runs, cache=True))
    assert kept() == []


def test_no_rows_are_kept_where_none_are_wanted(runs, kept):
    analyze(runs, cache=True, sketch=True)
    assert kept() == []
