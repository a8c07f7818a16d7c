"""The details that an earlier analysis made: the same numbers, made for new runs alone, and never those of anything else."""

from __future__ import annotations

import shutil
import subprocess
import sys

import polars as pl
import pytest
from campaigns import assert_as_without_cache, assert_same_results, payload_sizes, write_runs
from file_damage import DAMAGES

from dds_trace.analyzer.cache.store import TraceCache
from dds_trace.analyzer.engines import batches, cached_details
from dds_trace.analyzer.engines.cached_details import KnownDetails, pack_frames, unpack_frames
from dds_trace.analyzer.groups import timeline
from dds_trace.analyzer.pipeline import analyze


@pytest.fixture(autouse=True)
def small_batches(monkeypatch):
    """Each group is a batch of its own."""
    monkeypatch.setattr(batches, "BATCH_EVENTS", 1)


@pytest.fixture
def made(monkeypatch):
    """The payload sizes of the batches whose frames an analysis with a cache made, in bytes."""
    sizes = []

    def counted(known, batch, parts, make):
        def making():
            sizes.extend(payload_sizes(batch))
            return make()

        return real(known, batch, parts, making)

    real = KnownDetails.frames_of
    monkeypatch.setattr(KnownDetails, "frames_of", counted)
    return sizes


@pytest.fixture
def kept(cached):
    """Paths of the details in the cache."""
    return lambda: cached("details")


def test_a_second_analysis_makes_no_details_and_says_the_same(runs, made):
    first = analyze(runs, cache=True)
    assert sorted(made) == [1000, 1001, 1002]
    made.clear()
    again = analyze(runs, cache=True)
    assert made == []
    assert_as_without_cache(runs, first)
    assert_as_without_cache(runs, again)


@pytest.mark.parametrize(("name", "none"), [("measure_batch", None), ("MAKERS", {"sending": None})])
def test_neither_does_it_measure_anew(runs, name, none, monkeypatch):
    """Statistics and how a ping kept to its schedule are known, too; what is drawn follows from the whole campaign."""
    first = analyze(runs, cache=True)
    monkeypatch.setattr(batches, name, none)
    assert_same_results(analyze(runs, cache=True), first)


def test_a_grown_campaign_draws_fewer_points_of_known_runs(runs, monkeypatch):
    monkeypatch.setattr(timeline, "_ALL_POINTS", 96)
    monkeypatch.setattr(timeline, "_POINTS_OF_EXCHANGE", (4, 100))
    points = analyze(runs, cache=True).timeline.height
    write_runs(runs, [7, 8, 9], groups=3)
    found = analyze(runs, cache=True)
    assert found.timeline.height / 9 < points / 6
    assert_as_without_cache(runs, found)


def test_a_new_run_makes_those_of_its_group_alone(runs, made):
    analyze(runs, cache=True)
    made.clear()
    write_runs(runs, [7], groups=3)
    found = analyze(runs, cache=True)
    assert made == [1001]
    assert_as_without_cache(runs, found)


def test_a_new_group_before_the_others_numbers_them_anew(tmp_path, made):
    runs = tmp_path / "runs"
    write_runs(runs, [1, 2, 4, 5], groups=3)  # 1001 and 1002 bytes
    analyze(runs, cache=True)
    made.clear()
    write_runs(runs, [3], groups=3)  # 1000 bytes: the first group now
    found = analyze(runs, cache=True)
    assert made == [1000]
    assert found.details.intervals["group"].unique().sort().to_list() == [0, 1, 2]
    assert_as_without_cache(runs, found)


def test_traces_that_moved_are_known_and_other_traces_under_their_names_are_not(runs, made):
    analyze(runs, cache=True)
    made.clear()
    for path in list(runs.iterdir()):
        path.rename(path.with_name(f"moved_{path.name}"))
    assert_as_without_cache(runs, analyze(runs, cache=True))
    assert made == []
    write_runs(runs, [10], latency_ns=999, groups=3)
    for role in ("ping", "relay"):
        (runs / f"{role}10.mcap").replace(runs / f"moved_{role}4.mcap")
    assert_as_without_cache(runs, analyze(runs, cache=True))
    assert made == [1001]


def test_a_copy_of_a_trace_is_looked_at(runs, made):
    """Its events are the same ones; whether they are is not known before they are merged."""
    analyze(runs, cache=True)
    made.clear()
    shutil.copy(runs / "ping2.mcap", runs / "copy.mcap")
    assert_as_without_cache(runs, analyze(runs, cache=True))
    assert made == [1002]


@pytest.mark.parametrize(
    "asked", [{"deadline_ns": 500}, {"deadline_ns": 600}, {"deadline_ns": 500, "deadline_metric": "rtt"}]
)
def test_another_deadline_is_another_detail(runs, made, asked):
    analyze(runs, cache=True)
    analyze(runs, cache=True, deadline_ns=500, deadline_metric="latency")
    made.clear()
    found = analyze(runs, cache=True, **asked)
    assert sorted(made) == [1000, 1001, 1002]
    assert_as_without_cache(runs, found, **asked)


def test_other_code_makes_its_own(runs, made, monkeypatch):
    """What is known of one version is not told by another: also of one that somebody is just working at."""
    analyze(runs, cache=True)
    made.clear()
    monkeypatch.setattr(cached_details, "code_of_analysis", lambda: ("another",))
    analyze(runs, cache=True)
    assert len(made) == 3


def test_every_file_that_can_change_a_number_is_part_of_the_code():
    named = {each[0] for each in cached_details.code_of_analysis() if isinstance(each, tuple)}
    assert {
        "intervals.py",
        "bursts.py",
        "one_way.py",
        "freshness.py",
        "events.py",
        "cached_details.py",
        "reader.py",
    } <= named


def test_without_details_there_is_nothing_to_know(runs, kept):
    analyze(runs, cache=True, details=False)
    assert kept() == []


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_and_foreign_details_are_made_anew(runs, made, kept, damage):
    analyze(runs, cache=True)
    made.clear()
    for path in kept():
        damage(path)
    assert_as_without_cache(runs, analyze(runs, cache=True))
    assert sorted(made) == [1000, 1001, 1002]


def test_details_of_other_groups_are_made_anew(runs, made, kept):
    analyze(runs, cache=True)
    made.clear()
    others = [path.read_bytes() for path in kept()]
    for number, path in enumerate(kept()):
        path.write_bytes(others[number - 1])
    assert_as_without_cache(runs, analyze(runs, cache=True))
    assert sorted(made) == [1000, 1001, 1002]


@pytest.mark.parametrize("packed", [b"", b"[]", b"[]\n", b'[["intervals", 9]]\nnot arrow', b"3\n", b"\xff\n"])
def test_sealed_nonsense_is_made_anew(runs, made, kept, packed):
    analyze(runs, cache=True)
    made.clear()
    cache = TraceCache.open()
    for path in kept():
        cache.write(path.stem, "details", packed)
    cache.close()
    assert_as_without_cache(runs, analyze(runs, cache=True))
    assert sorted(made) == [1000, 1001, 1002]


@pytest.mark.parametrize("missing", ["statistics", "sending", "intervals"])
def test_sealed_frames_without_one_are_made_anew(runs, made, take_out_of_cached, missing):
    analyze(runs, cache=True)
    made.clear()
    take_out_of_cached("details", missing)
    assert_as_without_cache(runs, analyze(runs, cache=True))
    assert sorted(made) == [1000, 1001, 1002]


def test_details_that_are_too_large_are_not_kept(runs, kept, monkeypatch):
    monkeypatch.setattr(cached_details, "MOST_BYTES", 100)
    assert_as_without_cache(runs, analyze(runs, cache=True))
    assert kept() == []


PACKS_BESIDE_A_READER = """
import threading
import numpy as np, polars as pl
from dds_trace.analyzer.engines.cached_details import pack_frames, unpack_frames

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


def test_a_frame_is_packed_while_another_thread_looks_at_it():
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
