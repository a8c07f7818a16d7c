"""Parts of a large group that an earlier analysis paired: the same numbers, of new runs alone, and never those of anything else."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from campaigns import assert_as_without_cache, write_runs
from file_damage import DAMAGES
from polars.testing import assert_frame_equal

from dds_trace.analyzer.engines import batches, cached_details, large_batches, local
from dds_trace.analyzer.engines.cached_parts import KnownPart
from dds_trace.analyzer.groups import timeline
from dds_trace.analyzer.pairing import parquet
from dds_trace.analyzer.pipeline import analyze
from dds_trace.base.errors import OutputError
from dds_trace.tracefile.format.events import Stage

BOTH = (Stage.T2, Stage.T3)


@pytest.fixture(autouse=True)
def large_groups(monkeypatch):
    """Each group is a batch that is too large, each run, of 150 events, a part of it, and its rows are two tables."""
    for module in (batches, local):
        monkeypatch.setattr(module, "BATCH_EVENTS", 151)
    monkeypatch.setattr(parquet, "_ROWS_PER_GROUP", 32)


@pytest.fixture
def runs(tmp_path):
    """A folder of four runs of one group; the middleware stamped all arrivals."""
    write_runs(tmp_path / "runs", range(4), received=BOTH)
    return tmp_path / "runs"


@pytest.fixture
def paired(monkeypatch):
    """The numbers of the runs that an analysis with a cache paired."""
    numbers = []

    def pair_at(batch, parts, pool):
        numbers.extend(exchange.run.run_id - 7 for exchange in batch.exchanges)
        return real(batch, parts, pool)

    real = large_batches.pair_at
    monkeypatch.setattr(large_batches, "pair_at", pair_at)
    return numbers


@pytest.fixture
def loaded(monkeypatch):
    """The numbers of the runs whose known rows were read whole."""
    numbers = []

    def load(part, batch):
        numbers.extend(exchange.run.run_id - 7 for exchange in batch.exchanges)
        return real(part, batch)

    real = KnownPart.load
    monkeypatch.setattr(KnownPart, "load", load)
    return numbers


@pytest.fixture
def analyze_again(runs, paired, tmp_path):
    """Analyze with the cache, as without one in every number and in every byte of the rows; return the runs that were paired."""

    def again(**asked):
        paired.clear()
        assert_as_without_cache(runs, analyze(runs, cache=True, out=tmp_path / "found", **asked), **asked)
        found = paired.copy()
        analyze(runs, out=tmp_path / "expected", **asked)
        for name in ("roundtrips.parquet", "summary.parquet"):
            other = (tmp_path / "expected" / name).read_bytes()
            assert (tmp_path / "found" / name).read_bytes() == other, name
        return found

    return again


def test_a_second_analysis_pairs_nothing(analyze_again, loaded):
    assert analyze_again() == [0, 1, 2, 3]
    assert analyze_again() == []
    assert loaded == []


def test_a_new_run_is_paired_alone(runs, analyze_again, loaded):
    analyze_again()
    write_runs(runs, [4], received=BOTH)
    assert analyze_again() == [4]
    assert loaded == []


def test_a_run_that_is_gone_pairs_nothing(runs, analyze_again):
    analyze_again()
    for path in (runs / "ping2.mcap", runs / "relay2.mcap"):
        path.unlink()
    assert analyze_again() == []


@pytest.mark.parametrize("later", [(), (Stage.T2,), (Stage.T3,), BOTH], ids=["none", "T2", "T3", "both"])
@pytest.mark.parametrize("earlier", [(), (Stage.T2,), BOTH], ids=["none", "T2", "both"])
def test_stamps_of_the_middleware_judge_as_ever(runs, analyze_again, earlier, later):
    """Where the rows of one part have some, and those of another others."""
    write_runs(runs, range(4), received=earlier)
    analyze_again()
    write_runs(runs, [4], received=later)
    assert analyze_again() == [4]


def test_deliveries_are_shown_of_what_was_stamped(runs, analyze_again):
    analyze_again()
    write_runs(runs, [4], received=BOTH)
    parts = analyze(runs, cache=True).details.breakdown["part"]
    assert {"relay_delivery_ns", "ping_delivery_ns"} <= set(parts)


def test_runs_that_started_in_another_order_than_they_are_numbered_in(runs, analyze_again, monkeypatch):
    """Freshness and outages are by run_id, rows by start."""
    monkeypatch.setattr(
        "campaigns.run",
        lambda run_id, real=write_runs.__globals__["run"], **of: real(run_id=57 - run_id, **of),
    )
    shutil.rmtree(runs)
    write_runs(runs, range(4))
    analyze_again()
    write_runs(runs, [4])
    assert len(analyze_again()) == 1
    assert analyze(runs, cache=True).details.freshness["run_id"].to_list() == [46, 47, 48, 49, 50]


def test_groups_beside_are_numbered_anew(runs, analyze_again):
    analyze_again()
    write_runs(runs, [8, 9], groups=2)
    shutil.copytree(runs, runs.with_name("all"))
    write_runs(runs, [5, 7], groups=3)  # of 1002 and 1001 bytes
    analyze_again()
    assert analyze_again() == []


def test_a_group_of_which_no_batch_is_whole(runs, analyze_again, monkeypatch):
    monkeypatch.setattr(batches, "WHOLE_GROUP_EVENTS", 300)
    for module in (batches, local):
        monkeypatch.setattr(module, "BATCH_EVENTS", 140)
    analyze_again()
    write_runs(runs, [4], received=BOTH)
    assert analyze_again() == [4]


def test_another_deadline_is_another_analysis(analyze_again):
    analyze_again()
    assert analyze_again(deadline_ns=500) == [0, 1, 2, 3]
    assert analyze_again(deadline_ns=500) == []


@pytest.mark.parametrize("asked", [{"details": False}, {"sketch": True}])
def test_what_is_not_wanted_is_not_kept(runs, cached, asked):
    assert_as = analyze(runs, cache=True, **asked)
    assert cached("table") == []
    assert assert_as.summary.equals(analyze(runs, **asked).summary)


def test_what_is_drawn_changes_where_the_number_of_runs_passes_a_power_of_two(
    runs, analyze_again, loaded, monkeypatch
):
    monkeypatch.setattr(timeline, "_ALL_POINTS", 64)
    monkeypatch.setattr(timeline, "_POINTS_OF_EXCHANGE", (4, 100))
    analyze_again()
    write_runs(runs, [4], received=BOTH)
    assert analyze_again() == [4]
    assert loaded == [0, 1, 2, 3]
    write_runs(runs, [5], received=BOTH)
    assert analyze_again() == [5]
    assert loaded == [0, 1, 2, 3]


def test_events_that_two_traces_hold_are_compared_each_time(runs, analyze_again):
    """Which of two traces is the copy follows from their names, and rows that are known would not say."""
    shutil.copy(runs / "ping2.mcap", runs / "copy.mcap")
    analyze_again()
    assert analyze_again() == [2]


def test_other_code_pairs_anew(analyze_again, monkeypatch):
    analyze_again()
    monkeypatch.setattr(cached_details, "code_of_analysis", lambda: ("another",))
    assert analyze_again() == [0, 1, 2, 3]


@pytest.mark.parametrize("ending", ["table", "rows", "details"])
@pytest.mark.parametrize("damage", [*DAMAGES, Path.unlink])
def test_damaged_and_foreign_files_are_made_anew(analyze_again, cached, damage, ending):
    analyze_again()
    assert cached(ending)
    for path in cached(ending):
        damage(path)
    assert analyze_again() == ([] if ending == "details" else [0, 1, 2, 3])
    assert analyze_again() == []


@pytest.mark.parametrize("number", range(4))
def test_one_damaged_table_pairs_its_run_alone(analyze_again, cached, number):
    analyze_again()
    path = cached("table")[number]
    path.write_bytes(path.read_bytes()[:-1])
    assert len(analyze_again()) == 1


@pytest.mark.parametrize("missing", ["counts", "clock_knots", "tables"])
def test_sealed_parts_without_a_frame_are_paired_anew(analyze_again, take_out_of_cached, missing):
    analyze_again()
    take_out_of_cached("rows", missing)
    assert analyze_again() == [0, 1, 2, 3]


def test_sealed_frames_of_runs_without_one_are_made_anew(analyze_again, take_out_of_cached, loaded):
    analyze_again()
    take_out_of_cached("details", "freshness")
    assert analyze_again() == []
    assert loaded == [0, 1, 2, 3]


def test_a_table_of_another_part_is_not_taken(analyze_again, cached):
    analyze_again()
    first, *others = cached("table")
    for path in others:
        path.write_bytes(first.read_bytes())
    assert len(analyze_again()) >= 3


def test_rows_that_are_too_large_are_not_kept(analyze_again, cached, monkeypatch):
    monkeypatch.setattr(cached_details, "MOST_BYTES", 100)
    analyze_again()
    assert cached("table") == []
    assert analyze_again() == [0, 1, 2, 3]


@pytest.mark.parametrize("method", ["store", "write"])
def test_a_full_disk_costs_the_cache_alone(analyze_again, full_disk, method):
    full_disk(method)
    assert analyze_again() == [0, 1, 2, 3]
    assert analyze_again() == [0, 1, 2, 3]


def test_rows_that_are_removed_while_they_are_needed_are_one_line(runs, cached, monkeypatch, analyze_again):
    analyze_again()
    write_runs(runs, [4], received=BOTH)
    found = KnownPart.find.__func__

    def find_and_remove(cls, *arguments):
        part = found(cls, *arguments)
        for path in cached("table"):
            path.unlink()
        return part

    monkeypatch.setattr(KnownPart, "find", classmethod(find_and_remove))
    with pytest.raises(OutputError, match=r"\.table was removed while it was needed; analyze again$"):
        analyze(runs, cache=True, out=runs / "out")


def test_known_rows_are_joined_from_where_the_cache_keeps_them(runs, cached, analyze_again, joined):
    analyze_again()
    joined.clear()
    analyze(runs, cache=True, out=runs / "out")
    of_rows = {path for path in joined if isinstance(path, Path)}
    assert len(of_rows) == 8
    assert of_rows < set(cached("table"))


def test_a_part_that_is_read_whole_is_what_was_paired(runs, monkeypatch):
    """All that frames of runs look at; but for the columns that only rows need that are written."""
    kept = {}

    def keep_rows(key, known, roundtrips, pool):
        kept[key] = roundtrips
        return real(key, known, roundtrips, pool)

    real = large_batches.keep_rows
    monkeypatch.setattr(large_batches, "keep_rows", keep_rows)
    analyze(runs, cache=True)
    seen = []

    def load(part, batch):
        found = real_load(part, batch)
        (same,) = [one for one in kept.values() if one.described.equals(found.described)]
        assert_frame_equal(found.measured, same.measured.select(found.measured.columns), check_exact=True)
        assert set(same.measured.columns) - set(found.measured.columns) == {"publish_utc", "relay_in_utc"}
        assert found.outcome.tolist() == same.outcome.tolist()
        assert found.outcome.dtype == same.outcome.dtype
        assert found.bounds.tolist() == same.bounds.tolist()
        assert found.counts.equals(same.counts)
        assert found.clock_knots.equals(same.clock_knots)
        assert {s.name: s.to_list() for s in found.stamps} == {s.name: s.to_list() for s in same.stamps}
        seen.append(found)
        return found

    real_load = KnownPart.load
    monkeypatch.setattr(KnownPart, "load", load)
    monkeypatch.setattr(cached_details.KnownDetails, "find", lambda *_: None)
    write_runs(runs, [4], received=BOTH)
    analyze(runs, cache=True)
    assert len(seen) == 4
