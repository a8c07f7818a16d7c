"""Recordings of known truth: harmless ones are not said to lack messages, losses are found, and no rule takes more than linear time."""

import ast
import csv
import importlib.util
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from card_bags import START_NS, S, card, timer, write, write_mcap
from made_recordings import EVIDENCE, HARMLESS, LOSSES, MS, Made, Topic, lossy
from made_recordings import timer as made_timer
from typer.testing import CliRunner

from dds_trace.extensions.bags.analyze import analyze_topics
from dds_trace.extensions.bags.chains import Stamped, find_links
from dds_trace.extensions.bags.clocks import Stamps
from dds_trace.extensions.bags.command import app
from dds_trace.extensions.bags.losses import TopicTimes
from dds_trace.extensions.bags.observations import rate_stretches, regular_gaps
from dds_trace.extensions.bags.report import verdict_words
from dds_trace.extensions.bags.weighing import Source, weigh

ROOT = next(folder for folder in Path(__file__).parents if (folder / "benchmarks").is_dir())
SPEC = importlib.util.spec_from_file_location("bench_evidence", ROOT / "benchmarks" / "bench_evidence.py")
bench = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(bench)
SEEDS = range(1000, 1012)
RULES = (
    "bounds", "card", "chains", "clocks", "holes", "losses", "neighbours", "observations", "periods", "sync", "weighing",
)  # fmt: skip


@pytest.mark.parametrize("kind", HARMLESS)
def test_harmless_recordings_lack_nothing_for_sure(kind):
    assert bench.count(kind, "", SEEDS)[0] <= (kind == "paused, without stamps")  # for whole periods


@pytest.mark.parametrize(
    ("shift", "words"),
    [
        (0, "copies of the stamps, as RealSense writes them (.db3)"),
        (1_795_840_374 * S, "as RealSense writes them (.bag)"),
    ],
)
def test_recordings_of_realsense_are_named(tmp_path, shift, words):
    topic = "/device_0/sensor_0/Depth_0/image/data"
    times = [(at - START_NS + 1, at - START_NS + 1 + shift) for at, _ in timer(30, 10)]
    _, health, rows = card(write(tmp_path / "a.mcap", {topic: times}))
    (note,) = health.notes
    assert words in note
    assert rows[topic]["no_age"]
    _, health, _ = card(write(tmp_path / "b.mcap", {"/scan": times}))
    assert not any("RealSense" in note for note in health.notes)


@pytest.mark.parametrize("evidence", EVIDENCE)
@pytest.mark.parametrize("loss", LOSSES)
def test_losses_are_found(loss, evidence):
    found, within = bench.count(loss, evidence, SEEDS)
    assert within >= 0.5 * len(SEEDS)
    if (loss, evidence) != ("every second", "arrival"):  # or the rate changes
        assert found >= 0.9 * len(SEEDS)


def weighed(made):
    columns = [*made.columns()]
    times = [TopicTimes(*arrays) for _, _, arrays in columns]
    return weigh(
        times, [Source(name) for name, _, _ in columns], np.sort(np.concatenate([one.log_ns for one in times]))
    )


@pytest.mark.parametrize("evidence", EVIDENCE)
def test_what_a_recorder_lost_of_all_topics_is_no_clock_that_was_set(evidence):
    for seed in SEEDS:
        notes = weighed(lossy(np.random.default_rng(seed), "of all topics", evidence)).clocks.notes
        assert not [note for note in notes if "clock was set" in note.words]


@pytest.mark.parametrize("seed", range(5))
def test_regular_gaps_and_rates_that_change_are_seen(seed):
    rng = np.random.default_rng(seed)
    every, rates = int(rng.integers(4, 20)), rng.choice([10, 15, 22, 33, 50], 2, replace=False)
    _, log_ns = made_timer(rng, seconds=60, jitter=0.02)
    kept = np.arange(len(log_ns)) % every > 0
    assert (regular_gaps(log_ns[kept]), rate_stretches(log_ns)[1:]) == ((every - 1, 2), [])
    assert regular_gaps(log_ns[rng.random(len(log_ns)) > 1 / every]) is None
    changed_ns = np.cumsum(np.repeat(1 / rates, 20 * rates) * S) + rng.normal(0, 0.3 * MS, 20 * rates.sum())
    (_, before_hz), (at_ns, after_hz) = rate_stretches(changed_ns.astype(np.int64))
    assert [before_hz, after_hz, at_ns / S] == pytest.approx([*rates, 20], rel=0.05)


@pytest.mark.parametrize("kept", [3, 6, 12, 40])
@pytest.mark.parametrize("seed", range(3))
def test_a_queue_that_drops_the_newest_hides_no_loss_and_sets_no_clock(kept, seed):
    rng, topics = np.random.default_rng(seed), {}
    at_s, stall_s = rng.uniform(10, 40), rng.uniform(1.5, 4)
    for hz in (30, 50, 100):
        due, log_ns = made_timer(rng, seconds=60, hz=hz, jitter=0.01)
        stalled = np.flatnonzero((due > at_s * S) & (due < (at_s + stall_s) * S))
        log_ns[stalled[:kept]] = (at_s + stall_s) * S - MS
        topics[f"/{hz}"] = Topic(np.delete(log_ns, stalled[kept:]), np.delete(due, stalled[kept:]))
    found = weighed(Made(topics))
    for hz, loss, times in zip((30, 50, 100), found.losses, found.times, strict=True):
        assert loss.low <= int(hz * 60) - len(times.log_ns) <= loss.high
    assert not found.clocks.notes


def stored_rows():
    with (ROOT / "docs" / "results" / "evidence.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_the_stored_rows_keep_the_bound_and_name_each_kind():
    rows = stored_rows()
    assert [row["kind"] for row in rows if row["table"] == "harmless"] == [*HARMLESS]
    named = [(row["kind"], row["shown_by"]) for row in rows if row["table"] == "losses"]
    assert named == [(loss, evidence) for loss in LOSSES for evidence in EVIDENCE]
    assert {row["recordings"] for row in rows} == {"200"}
    assert all(int(row["exit_30"]) <= 200 * bench.MOST_FALSE for row in rows if row["table"] == "harmless")


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_stored_rows_are_what_the_benchmark_counts():
    counted = [{name: str(value) for name, value in row.items()} for row in bench.rows_of("", range(200))]
    assert counted == stored_rows()


SHIFTS = {
    "clocks that are set": lambda number: number // 5000 * 3.1 * S,
    "pauses": lambda number: number // 500 * 1.7 * S,
    "late by turns": lambda number: number % 3 * 250 * MS,
}


def grow(kind, count, rng):
    due, log_ns = made_timer(rng, seconds=count / 100, hz=100, jitter=0.3 if "jitter" in kind else 0.01)
    number = np.arange(len(due))
    topics = {
        "jitter without a header": Topic(log_ns),
        "losses by arrival": Topic(log_ns),
        "losses by numbers": Topic(log_ns, None, number),
        "events": Topic(np.cumsum(rng.exponential(10 * MS, count))),
        "bursts": Topic((number // 20 * 200 + number % 20 * 0.1) * MS, due),
        "stamps that go back": Topic(log_ns, due - (number % 10 == 7) * 200 * MS),
        "two publishers": Topic(log_ns, due, None, number % 2),
    }
    topic = topics.get(kind) or Topic(log_ns + SHIFTS.get(kind, lambda at: 0 * at)(number), due)
    if kind.startswith("losses"):
        topic = topic.only(rng.random(len(due)) > 0.2)
    if kind == "many topics":
        return Made({f"/t{n}": topic.only(number % (count // 100) == n) for n in range(count // 100)})
    return Made({"/topic": topic, "/other": Topic(log_ns + MS)})


KINDS = (
    "steady", "jitter without a header", "jitter", "losses by stamps", "losses by numbers", "losses by arrival", "events", "bursts",
    "stamps that go back", "two publishers", "clocks that are set", "pauses", "late by turns", "many topics",
)  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_no_rule_takes_more_than_linear_time(kind):
    taken_s = []
    for count in (5_000, 10_000, 20_000, 40_000):
        columns = [*grow(kind, count, np.random.default_rng(5)).columns()]
        sources = [Source(name) for name, _, _ in columns]
        tries = []
        for _ in range(2):
            times = [TopicTimes(*arrays) for _, _, arrays in columns]
            logged = np.sort(np.concatenate([one.log_ns for one in times]))
            began_s = time.process_time()
            weigh(times, sources, logged)
            find_links([Stamped(s.name, "", t.log_ns, t.stamp_ns, True) for s, t in zip(sources, times, strict=True)])
            tries.append(time.process_time() - began_s)
        taken_s.append(min(tries))
    assert taken_s[-1] < 3 * 8 * max(taken_s[0], 1e-3), taken_s  # of square time 64


def test_the_part_has_few_bounds_and_its_rules_have_none_of_their_own():
    bounds, bare = [], []
    for room in RULES:
        for node in ast.parse((ROOT / "extensions" / "bags" / f"{room}.py").read_text()).body:
            values = [one.value for one in ast.walk(node) if isinstance(one, ast.Constant)]
            numbers = [value for value in values if type(value) in (int, float)]
            if isinstance(node, ast.Assign) and numbers:
                bounds += [getattr(target, "id", "") for target in node.targets]
            elif isinstance(node, ast.FunctionDef | ast.ClassDef):
                bare += [(room, node.name, one) for one in numbers if one not in (-1, 0, 1, 2)]
    assert bare == []
    assert len(bounds) <= 20, bounds


def test_gaps_that_pauses_explain_are_not_called_whole():
    row, health = (
        {"topic": "/a", "missing_low": 0},
        SimpleNamespace(verdict="unknown", readable=1, duration_ns=0, notes=()),
    )
    assert "found" in verdict_words(health, [row | {"missing_high": 0}])
    assert "5 messages may" in verdict_words(health, [row | {"missing_high": 5}])
    assert "analyze" in verdict_words(health, [row | {"topic": "/dds_trace/tap"}])


def numbered(path, numbers, hz=20, seconds=5, since=0):
    for n in numbers:
        at = START_NS + (n - since) * seconds * S
        write(path(n), {"/chatter": timer(hz, seconds, since_ns=at), "/odd": [(at + S, at)]})


NAMINGS = {
    "NAME_N": lambda n: f"drive_{n}.mcap",
    "N_NAME_TIME": lambda n: f"{n}_drive_2026_11_28-03_{10 + n // 12:02}_{n * 5 % 60:02}.mcap",
}


@pytest.mark.parametrize("naming", NAMINGS)
@pytest.mark.parametrize("gone", [(), (3,), (3, 4, 5)])
def test_splits_that_count_on_are_one_recording(tmp_path, naming, gone):
    numbered(lambda n: tmp_path / NAMINGS[naming](n), [n for n in range(12) if n not in gone])
    report = analyze_topics(tmp_path)
    (health,) = report.recordings
    row = report.topics.filter(topic="/chatter").row(0, named=True)
    assert (health.path, health.messages) == (str(tmp_path), (12 - len(gone)) * 101)
    assert (row["missing"], row["missing_low"]) == (100 * len(gone), 100 * len(gone))
    assert health.verdict == ("damaged" if gone else "whole")
    assert len(health.damages) == bool(gone)


def test_recordings_that_only_are_named_alike_stay_apart(tmp_path):
    for n in (1, 2, 3):
        write(tmp_path / f"run_{n}.mcap", {"/a": timer(20, 5, since_ns=START_NS + n * 600 * S)})
    write(tmp_path / "other.mcap", {"/a": timer(20, 5)})
    report = analyze_topics(tmp_path)
    names = [Path(health.path).name for health in report.recordings]
    assert names == ["other.mcap", "run_1.mcap", "run_2.mcap", "run_3.mcap"]
    assert report.verdict == "whole"


def test_a_recording_without_a_message_is_not_whole(tmp_path):
    write_mcap(tmp_path / "two.mcap", [])
    write(tmp_path / "one.mcap", {"/a": timer(20, 5)})
    result = CliRunner().invoke(app, [str(tmp_path), "--out", str(tmp_path / "out")])
    assert result.exit_code == 31, result.output
    assert "No message was recorded." in result.output
    assert [health.verdict for health in analyze_topics(tmp_path).recordings] == ["whole", "empty"]


def test_the_exit_code_is_made_from_the_observations(tmp_path):
    topics = {"/a": timer(20, 30, without=[(10, 12)]), "/b": timer(10, 30)}
    report, health, rows = card(write(tmp_path / "x.mcap", topics))
    counted = report.observations.filter(kind="counted", topic="/a")
    assert dict(counted.select("reading", "low").rows()) == {"stamps": 40, "period": 40, "all": 40}
    union = tuple(rows["/a"][f"missing_{end}"] for end in ("low", "high"))
    assert counted.filter(reading="all").select("low", "high").row(0) == union
    seen = report.observations.filter(kind="seen")
    assert seen.select("topic", "start_s", "low", "high").rows() == [("/a", pytest.approx(10), 40, 40)]
    assert health.verdict == "holes"


AGES = {
    "copies": (lambda at: at, "-"),
    "a replay three hours later": (lambda at: at - 10_758 * S, "other clock"),
    "days behind": (lambda at: at - 6 * 86_400 * S, "other clock"),
    "a simulation at half speed": (lambda at: 10 * S + (at - START_NS) // 2, "other clock"),
}


@pytest.mark.parametrize("name", AGES)
@pytest.mark.parametrize("seed", range(3))
def test_what_is_no_age_is_named_and_none_is_printed(tmp_path, name, seed):
    stamp, word = AGES[name]
    rng = np.random.default_rng(seed)
    topics = {}
    for topic in ("/a", "/b"):
        at = START_NS + (np.arange(300) * 50 * MS + rng.normal(0, 0.1 * MS, 300)).astype(np.int64)
        topics[topic] = [(int(t), int(stamp(int(t)))) for t in at]
    _, health, rows = card(write(tmp_path / "x.mcap", topics))
    assert [row["no_age"] for row in rows.values()] == [word, word]
    assert sum("stamps" in note for note in health.notes) == 1


def test_history_is_out_of_rate_and_age(tmp_path):
    history = [(START_NS + n * MS // 10, START_NS - (9 - n) * S) for n in range(8)]
    live = [(START_NS + S // 2 + n * S, START_NS + n * S + S // 5) for n in range(40)]
    _, health, rows = card(write(tmp_path / "x.mcap", {"/map": history + live, "/imu": timer(100, 40)}))
    row = rows["/map"]
    assert (row["latched"], row["messages"], row["missing"]) == (8, 48, 0)
    assert row["rate_hz"] == pytest.approx(1, rel=0.01)
    assert row["age_max_ns"] == pytest.approx(300 * MS, rel=0.01)
    assert "history" in health.notes[0]


def test_two_publishers_with_clocks_of_their_own_are_no_history():
    log_ns = np.arange(2000) * 20 * MS
    topic = Topic(log_ns, log_ns - (1000 + log_ns // (20 * MS) % 2 * 30) * S)
    columns = [*Made({"/tf": topic}).columns()]
    times = [TopicTimes(*arrays) for _, _, arrays in columns]
    times[0].frame = np.arange(2000) % 2
    found = weigh(times, [Source("/tf")], times[0].log_ns)
    assert found.history == [0]
    assert not [note for note in found.clocks.notes if "history" in note.words]


@pytest.mark.parametrize("frames", [1, 2])
def test_the_speed_of_stamps_is_that_of_each_frame(frames):
    log_ns = START_NS + np.arange(600) * 20 * MS
    frame = np.arange(600) % frames
    stamps = Stamps(log_ns, 400 * S + (log_ns - START_NS) // 2 + frame * 30 * S, frame)
    assert stamps.speed == pytest.approx(0.5)
    assert Stamps(log_ns, np.random.default_rng(1).integers(0, 10**18, 600), frame).speed is None
