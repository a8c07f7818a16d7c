"""Results of earlier analyses: the same numbers, computed for new runs only, and never used for anything else."""

from __future__ import annotations

import shutil
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import NamedTuple

import polars as pl
import pytest
from campaigns import assert_as_without_cache, write_runs
from file_damage import DAMAGES

from dds_trace.analyzer.cache.store import TraceCache
from dds_trace.analyzer.engines import batches, local, process, result_cache
from dds_trace.analyzer.engines.processes import Worker
from dds_trace.analyzer.engines.result_cache import ResultCache, pack_frames, unpack_frames
from dds_trace.analyzer.groups import timeline
from dds_trace.analyzer.pairing import roundtrips
from dds_trace.analyzer.pipeline import analyze
from dds_trace.base.errors import OutputError
from dds_trace.base.threads import InlineExecutor
from dds_trace.tracefile.format.events import Stage

BOTH = (Stage.T2, Stage.T3)
ALL = [0, 1, 2, 3, 4, 5]
SIZES = [1000, 1001, 1002]


class NearWorkers:
    """What worker processes do, done in this process."""

    count = 1

    def __init__(self, cache, folder):
        self._worker = Worker(folder, cache)

    def process(self, batch, parts, keys):
        return InlineExecutor().submit(self._worker.process, batch, parts, keys)

    def map(self, function, items):
        return map(function, items)

    def explaining_kills(self):
        return nullcontext()

    def close(self):
        pass


@pytest.fixture
def small_parts(monkeypatch):
    """Each group is a large batch and each run, of 150 events, a part of it, in two tables."""
    monkeypatch.setattr(batches, "BATCH_EVENTS", 151)
    monkeypatch.setattr(roundtrips, "ROWS_PER_FRAME", 32)


@pytest.fixture(params=["batches", "parts", "workers"])
def mode(request, tmp_path, monkeypatch):
    """Each group is a batch that threads or workers process, or a large batch."""
    if request.param == "parts":
        request.getfixturevalue("small_parts")
    else:
        monkeypatch.setattr(batches, "BATCH_EVENTS", 1_000)
        monkeypatch.setattr(batches, "_ends_batch", lambda *_: True)
    if request.param == "workers":
        (tmp_path / "temporary").mkdir()
        start = lambda engine: NearWorkers(engine._cache, tmp_path / "temporary")  # noqa: E731
        monkeypatch.setattr(local, "COST_FOR_PROCESSES", 1)
        monkeypatch.setattr(local.LocalEngine, "_start_workers", start)
    yield request.param
    assert list(tmp_path.glob("temporary/*")) == []


@pytest.fixture
def runs(tmp_path):
    """A folder of six runs of three groups, of 1000, 1001 and 1002 bytes in turn; the middleware stamped all arrivals."""
    write_runs(tmp_path / "runs", ALL, groups=3, received=BOTH)
    return tmp_path / "runs"


class Work(NamedTuple):
    """What an analysis did itself: runs that were paired, payload sizes that were measured, runs whose frames were made."""

    paired: list[int]
    measured: list[int]
    made: list[int]


NOTHING, EVERYTHING = Work([], [], []), Work(ALL, SIZES, ALL)


@pytest.fixture
def again(runs, tmp_path, monkeypatch):
    """Analyze with the cache, as without one in every number and in every byte of the rows; return the work."""
    work = Work([], [], [])

    def run_numbers(batch):
        return [exchange.run.run_id - 7 for exchange in batch.exchanges]

    def pair_events(batch, *arguments):
        work.paired.extend(run_numbers(batch))
        return pair(batch, *arguments)

    def measure_batch(rows, groups):
        work.measured.extend(rows.described["payload_bytes"].unique())
        return measure(rows, groups)

    def begin_frames(makers, batch, *arguments):
        if "run_times" in makers:
            work.made.extend(run_numbers(batch))
        return begin(makers, batch, *arguments)

    pair, measure, begin = process._pair_events, process.measure_batch, process.begin_frames
    for function in (measure_batch, begin_frames):
        monkeypatch.setattr(process, function.__name__, function)
    monkeypatch.setattr(process, "_pair_events", pair_events)

    def analyze_again(**options):
        for numbers in work:
            numbers.clear()
        analysis = analyze(runs, cache=True, out=tmp_path / "cached", **options)
        done = Work(*map(sorted, work))
        assert_as_without_cache(runs, analysis, **options)
        expected = analyze(runs, out=tmp_path / "expected", **options)
        for kind, path in expected.outputs.items():
            assert analysis.outputs[kind].read_bytes() == path.read_bytes(), kind
        return done

    return analyze_again


@pytest.mark.usefixtures("mode")
def test_a_second_analysis_computes_nothing(again):
    assert again() == EVERYTHING
    assert again() == NOTHING


def test_a_new_run_is_processed_with_its_group(mode, runs, again):
    again()
    write_runs(runs, [7], groups=3, received=BOTH)
    new = [7] if mode == "parts" else [1, 4, 7]
    assert again() == (new, [1001], new)


def test_a_run_that_is_gone_changes_its_group(mode, runs, again):
    again()
    for path in (runs / "ping2.mcap", runs / "relay2.mcap"):
        path.unlink()
    left = [] if mode == "parts" else [5]
    assert again() == (left, [1002], left)


@pytest.mark.usefixtures("mode")
def test_a_new_group_before_the_others_renumbers_them(runs, again):
    for number in (0, 3):
        for role in ("ping", "relay"):
            (runs / f"{role}{number}.mcap").unlink()
    assert again() == ([1, 2, 4, 5], [1001, 1002], [1, 2, 4, 5])
    write_runs(runs, [3], groups=3, received=BOTH)  # 1000 bytes: the first group now; five runs of at most eight
    assert again() == ([3], [1000], [3])


@pytest.mark.parametrize(("exchanges", "points"), [(0, 8), (1, 8), (2, 8), (3, 4), (4, 4), (5, 2), (8, 2), (9, 2)])
def test_the_share_of_points_changes_at_powers_of_two(exchanges, points, monkeypatch):
    monkeypatch.setattr(timeline, "_ALL_POINTS", 16)
    monkeypatch.setattr(timeline, "_POINTS_OF_EXCHANGE", (2, 8))
    assert timeline.points_of_exchange(exchanges) == points


def test_traces_that_moved_are_cached_and_other_traces_under_their_names_are_not(mode, runs, again):
    again()
    for path in list(runs.iterdir()):
        path.rename(path.with_name(f"moved_{path.name}"))
    assert again() == NOTHING
    write_runs(runs, [10], latency_ns=999, groups=3, received=BOTH)
    for role in ("ping", "relay"):
        (runs / f"{role}10.mcap").replace(runs / f"moved_{role}4.mcap")
    new = [10] if mode == "parts" else [1, 10]
    assert again() == (new, [1001], new)


def test_events_that_two_traces_have_are_compared_each_time(mode, runs, again):
    """Which of two traces has the copy follows from their names, and cached rows do not say it."""
    again()
    shutil.copy(runs / "ping2.mcap", runs / "copy.mcap")
    affected = [2] if mode == "parts" else [2, 5]
    assert again() == (affected, [1002], affected)
    assert again() == (affected, [], affected)


@pytest.mark.parametrize("options", [{"deadline_ns": 500}, {"deadline_ns": 500, "deadline_metric": "rtt"}])
@pytest.mark.usefixtures("mode")
def test_options_are_part_of_the_key(again, options):
    again()
    assert again(**options) == EVERYTHING
    assert again(**options) == NOTHING


@pytest.mark.usefixtures("mode")
def test_without_details_nothing_is_cached(again, cached):
    for _ in range(2):
        assert again(details=False) == EVERYTHING
    assert cached("details") + cached("rows") == []


@pytest.mark.usefixtures("mode")
def test_a_sketch_caches_no_rows(again, cached):
    assert again(sketch=True) == EVERYTHING
    assert cached("rows") == []
    assert again(sketch=True) == (ALL, [], [])


@pytest.mark.usefixtures("mode")
def test_other_code_computes_again(again, monkeypatch):
    again()
    monkeypatch.setattr(result_cache, "code_of_analysis", lambda: ("another",))
    assert again() == EVERYTHING


def test_every_file_that_can_change_a_number_is_part_of_the_code():
    names = {entry[0] for entry in result_cache.code_of_analysis() if isinstance(entry, tuple)}
    assert {"intervals.py", "one_way.py", "freshness.py", "events.py", "result_cache.py", "reader.py"} <= names


@pytest.mark.parametrize("ending", ["rows", "details"])
@pytest.mark.parametrize("damage", [*DAMAGES, Path.unlink])
@pytest.mark.usefixtures("mode")
def test_damaged_and_foreign_files_are_replaced(again, cached, damage, ending):
    again()
    assert cached(ending)
    for path in cached(ending):
        damage(path)
    assert again() == ((ALL, [], []) if ending == "rows" else ([], SIZES, ALL))
    assert again() == NOTHING


@pytest.mark.usefixtures("small_parts")
@pytest.mark.parametrize("number", range(6))
def test_one_damaged_part_pairs_only_its_run(again, cached, number):
    again()
    path = cached("rows")[number]
    path.write_bytes(path.read_bytes()[:-1])
    assert len(again().paired) == 1


@pytest.mark.parametrize("ending", ["rows", "details"])
@pytest.mark.usefixtures("mode")
def test_files_of_other_batches_are_not_used(again, cached, ending):
    again()
    others = [path.read_bytes() for path in cached(ending)]
    for number, path in enumerate(cached(ending)):
        path.write_bytes(others[number - 1])
    assert again() == ((ALL, [], []) if ending == "rows" else ([], SIZES, ALL))


@pytest.mark.parametrize("content", [b"", b"[]", b"[]\n", b'[["intervals", 9]]\nnot arrow', b"3\n", b"\xff\n"])
@pytest.mark.usefixtures("mode")
def test_sealed_nonsense_is_replaced(again, cached, content):
    again()
    cache = TraceCache.open()
    for path in cached("rows") + cached("details"):
        with cache.writing(path.stem, path.suffix[1:]) as stream:
            stream.write(content)
    cache.close()
    assert again() == EVERYTHING
    assert again() == NOTHING


@pytest.mark.parametrize(
    ("missing", "work"), [("statistics", ([], SIZES, [])), ("intervals", ([], SIZES, [])), ("sending", ([], [], ALL))]
)
@pytest.mark.usefixtures("mode")
def test_sealed_frames_without_one_are_replaced(again, cached, missing, work):
    again()
    cache = TraceCache.open()
    for path in cached("details"):
        frames = unpack_frames(cache.read(path.stem, "details"))
        frames.pop(missing, None)
        with cache.writing(path.stem, "details") as stream:
            stream.write(pack_frames(frames))
    cache.close()
    assert again() == work


@pytest.mark.usefixtures("mode")
def test_frames_that_are_too_large_are_not_cached(again, cached, monkeypatch):
    monkeypatch.setattr(result_cache, "MOST_BYTES", 100)
    again()
    assert cached("details") == []
    assert again() == ([], SIZES, ALL)


@pytest.mark.usefixtures("mode")
def test_a_full_disk_costs_only_the_cache(again, cached, monkeypatch):
    def full(*_arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(TraceCache, "writing", full)
    for _ in range(2):
        assert again() == EVERYTHING
    assert cached("details") + cached("rows") == []


@pytest.mark.usefixtures("mode")
def test_rows_that_are_removed_while_they_are_needed_are_one_line(runs, cached, monkeypatch, again):
    again()
    read_rows = ResultCache.read_rows

    def read_and_remove(*arguments):
        rows = read_rows(*arguments)
        for path in cached("rows") if rows else ():  # a batch that is not cached may come first
            path.unlink(missing_ok=True)  # several threads read
        return rows

    write_runs(runs, [7], groups=3, received=BOTH)
    monkeypatch.setattr(ResultCache, "read_rows", read_and_remove)
    with pytest.raises(OutputError, match=r"\.rows was removed.* analyze again$"):
        analyze(runs, cache=True, out=runs / "out")


def test_fewer_points_are_drawn_of_each_run_of_a_grown_campaign(runs, monkeypatch):
    monkeypatch.setattr(timeline, "_ALL_POINTS", 96)
    monkeypatch.setattr(timeline, "_POINTS_OF_EXCHANGE", (4, 100))
    points = analyze(runs, cache=True).timeline.height
    write_runs(runs, [7, 8, 9], groups=3)
    assert analyze(runs, cache=True).timeline.height / 9 < points / 6


@pytest.mark.usefixtures("small_parts")
@pytest.mark.parametrize("later", [(), (Stage.T2,), (Stage.T3,), BOTH], ids=["none", "T2", "T3", "both"])
@pytest.mark.parametrize("earlier", [(), (Stage.T2,), BOTH], ids=["none", "T2", "both"])
def test_parts_with_different_stamps_of_the_middleware_give_the_same(runs, again, earlier, later):
    write_runs(runs, range(4), received=earlier)
    again()
    write_runs(runs, [4], received=later)
    assert again().paired == [4]


@pytest.mark.usefixtures("small_parts")
def test_deliveries_are_shown_of_what_was_stamped(runs, again):
    again()
    write_runs(runs, [7], groups=3, received=BOTH)
    parts = analyze(runs, cache=True).details.breakdown["part"]
    assert {"relay_delivery_ns", "ping_delivery_ns"} <= set(parts)


@pytest.mark.usefixtures("small_parts")
def test_runs_that_started_in_another_order_than_their_numbers(runs, again, monkeypatch):
    """Freshness and outages are by run_id, rows by start."""
    monkeypatch.setattr(
        "campaigns.run", lambda run_id, real=write_runs.__globals__["run"], **of: real(run_id=57 - run_id, **of)
    )
    shutil.rmtree(runs)
    write_runs(runs, range(4))
    again()
    write_runs(runs, [4])
    assert len(again().paired) == 1
    assert analyze(runs, cache=True).details.freshness["run_id"].to_list() == [46, 47, 48, 49, 50]


def test_a_group_of_which_no_batch_is_whole(runs, again, monkeypatch):
    monkeypatch.setattr(batches, "WHOLE_GROUP_EVENTS", 200)
    monkeypatch.setattr(batches, "BATCH_EVENTS", 140)
    again()
    write_runs(runs, [7], groups=3, received=BOTH)
    assert again() == ([7], [1001], [7])


PACKS_BESIDE_A_READER = """
import threading
import numpy as np, polars as pl
from dds_trace.analyzer.engines.result_cache import pack_frames, unpack_frames

frame, is_done = pl.DataFrame({"group": np.arange(100_000, dtype=np.uint32)}), threading.Event()
def look():
    while not is_done.is_set():
        frame.get_column("group")
reader = threading.Thread(target=look)
reader.start()
for _ in range(100):
    packed = pack_frames({"frame": frame})
is_done.set()
reader.join()
assert unpack_frames(packed)["frame"].equals(frame)
"""


def test_a_frame_is_packed_while_another_thread_reads_it():
    # In a process of its own: where polars' lock and Python's are taken in two orders, it never ends.
    subprocess.run([sys.executable, "-c", PACKS_BESIDE_A_READER], timeout=60, check=True)


def test_frames_come_back_as_they_were_packed():
    frames = {
        "empty": pl.DataFrame(schema={"group": pl.UInt32, "name": pl.String}),
        "values": pl.DataFrame(
            {"group": [0, 1], "name": ["one", None], "ratio": [None, 0.5], "is_late": [True, None]},
            schema_overrides={"group": pl.UInt32},
        ),
    }
    unpacked = unpack_frames(pack_frames(frames))
    assert unpacked.keys() == frames.keys()
    for name, frame in frames.items():
        assert unpacked[name].schema == frame.schema
        assert unpacked[name].equals(frame)
