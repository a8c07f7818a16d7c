"""Stamps decide: recordings with a known truth, and what is said of their losses, ages and clocks."""

import numpy as np
import pytest
from card_bags import MS, START_NS, card, timer, write

from dds_trace.analyzer.recordings.periods import find_regularity
from dds_trace.reports.topics.renderers import render_markdown

S = 1000 * MS


def camera(hz, count, selected=None, *, late_ms=3.0, jitter_ms=0.2, stamp_jitter_ms=0.0, seed=3):
    """Log times and stamps of the selected frames of a camera that stamps on a grid; `late_ms` may be one of each frame."""
    rng = np.random.default_rng(seed)
    stamps = START_NS + np.arange(count) * 1e9 / hz + rng.normal(0, stamp_jitter_ms, count) * MS
    logged = stamps + (np.asarray(late_ms) + np.abs(rng.normal(0, jitter_ms, count))) * MS
    selected = np.arange(count) if selected is None else np.flatnonzero(selected)
    return sorted((int(logged[n]), int(stamps[n])) for n in selected)


def at_random(count, share):
    selected = np.random.default_rng(7).random(count) > share
    selected[[0, -1]] = True
    return selected


N = np.arange(16_000)
GRIDS = {
    "every second frame gone in half of the time": (15, (N[:900] // 75 % 2 == 0) | (N[:900] % 2 == 0), 0.0),
    "every second frame gone, stamps with jitter": (15, (N[:900] // 75 % 2 == 0) | (N[:900] % 2 == 0), 1.0),
    "three quarters lost at random": (20, at_random(1200, 0.75), 0.0),
    "three quarters lost at random, stamps with jitter": (20, at_random(1200, 0.75), 1.0),
    "five of sixteen arrive": (1000, N % 16 < 5, 0.0),
}


@pytest.mark.parametrize("name", GRIDS)
def test_stamps_on_a_grid_count_what_is_missing(tmp_path, name):
    hz, selected, stamp_jitter_ms = GRIDS[name]
    frames = camera(hz, len(selected), selected, stamp_jitter_ms=stamp_jitter_ms)
    row = card(write(tmp_path / "x.mcap", {"/points": frames}))[2]["/points"]
    missing = int((~selected[: np.flatnonzero(selected)[-1]]).sum())
    assert (row["missing"], row["missing_low"], row["missing_from"]) == (missing, missing, "stamps")
    assert row["expected_rate_hz"] == pytest.approx(hz, rel=1e-3)


def stalled(seed, every, stall_ms, next_ms):
    """Arrivals of a 50 Hz timer whose messages wait in a queue at each stall, in ms."""
    rng, now, arrivals = np.random.default_rng(seed), 0.0, []
    for n in range(1000):
        now = max(now + next_ms * (1 + 0.05 * rng.normal()), n * 20 + abs(rng.normal(0, 0.6)))
        if n % every == every - 1:
            now = n * 20 + stall_ms * (0.6 + 0.8 * rng.random())
        arrivals.append(now)
    return np.array(arrivals)


@pytest.mark.parametrize(
    ("every", "stall_ms", "next_ms"), [(50, 100, 2.2), (25, 100, 0.2), (15, 80, 5), (100, 500, 2.2)]
)
def test_a_queue_that_is_flushed_is_no_other_rate(every, stall_ms, next_ms):
    for seed in range(40):
        times_ns = START_NS + (stalled(seed, every, stall_ms, next_ms) * MS).astype(np.int64)
        regularity = find_regularity(times_ns)
        assert (regularity.missing, regularity.low) == (0, 0)
        assert regularity.rate_hz == pytest.approx(50, rel=0.02)


def test_a_stall_of_the_recorder_is_one_finding(tmp_path):
    topics = {}
    for name, hz in (("/imu", 100), ("/odom", 50)):
        due = np.arange(hz * 20) * 1000 / hz
        late = np.where((due > 5000) & (due < 5800), 5800 - due, np.where((due > 9000) & (due < 9500), 9500 - due, 0))
        topics[name] = camera(hz, len(due), late_ms=3 + late)
    _, health, rows = card(write(tmp_path / "x.mcap", topics))
    assert [(row["missing_low"], row["missing_high"]) for row in rows.values()] == [(0, 0), (0, 0)]
    (note,) = [note for note in health.notes if "stalled" in note]
    assert "2 times" in note
    assert "at 00:05" in note
    assert health.verdict == "whole"


def test_two_readings_of_arrivals_are_within_the_interval(tmp_path):
    """Half of the frames, or another rate: without stamps nobody knows."""
    selected = (N[:900] < 450) | (N[:900] % 2 == 0)
    topics = {"/a": [(log, log) for log, _ in camera(15, 900, selected, jitter_ms=1)]}
    report, health, rows = card(write(tmp_path / "x.mcap", topics))
    assert (rows["/a"]["missing_low"], health.verdict) == (0, "whole")
    assert rows["/a"]["missing_high"] == pytest.approx(224, abs=2)
    assert "are missing" not in render_markdown(report)


@pytest.mark.parametrize("name", ["/cmd_vel", "/something"])
def test_silence_of_commands_is_no_loss(tmp_path, name):
    pressed = [(2, 5), (20, 22.5), (41, 47)]
    keys = [at for at in np.arange(2, 47, 1 / 30) if any(first <= at < last for first, last in pressed)]
    topics = {name: [(START_NS + int(at * S), START_NS + int(at * S) - 2 * MS) for at in keys], "/odom": timer(20, 60)}
    _, health, rows = card(write(tmp_path / "x.mcap", topics))
    assert (rows[name]["missing"], rows[name]["missing_from"], health.verdict) == (None, "", "whole")


def ages(count, hz, age_ms):
    """Log times and stamps of messages of some age, those of the future on time."""
    due = [(START_NS + int(n * S / hz), int(age_ms(n) * MS)) for n in range(count)]
    return [(at + max(age_ns, 0), at + max(-age_ns, 0)) for at, age_ns in due]


STEADY = {"/imu": ages(3200, 100, lambda _: 3), "/odom": ages(640, 20, lambda _: 3)}
CLOCKS = {
    "a topic": ({"/color": ages(450, 15, lambda n: 60 if n < 150 else 1200), **STEADY}, "/color became 1.14 s later at 00:10"),
    "the recorder": ({t: ages(600, 20, lambda n: 3 + 2500 * (n > 300)) for t in ("/a", "/b")}, "was set forward by 2.5 s at 00:15"),
    "a device": ({"/oak": ages(300, 30, lambda n: 3 - 4000 * (n > 120)), **STEADY}, "jump 1 time"),
    "latched": ({"/tf_static": [(START_NS + n * MS, START_NS - 156 * S // (n + 1)) for n in range(3)], **STEADY}, "nodes that started earlier"),
    "two kinds": ({"/tf": sorted(ages(1000, 20, lambda _: 2) + [(at + 7 * MS, at + 1200 * MS) for at, _ in ages(100, 2, lambda _: 0)])}, "two kinds"),
    "a slow simulation": ({"/pose": [(START_NS + int(n * 0.1 / 0.28 * S), 10 * S + n * 100 * MS) for n in range(1200)]}, "0.28 of real time"),
    "TAI": ({"/points": ages(200, 10, lambda _: -36_995), **STEADY}, "TAI"),
    "GPS": ({"/fix": ages(200, 10, lambda _: -17_950), **STEADY}, "GPS"),
    "microseconds": ({"/flow": [(START_NS + n * 20 * MS, START_NS + n * 20_000) for n in range(500)]}, "microseconds"),
    "growth": ({"/image": ages(1800, 30, lambda n: 30 + 6000 * n / 1800)}, "from 36.7 ms to"),
}  # fmt: skip


@pytest.mark.parametrize("name", CLOCKS)
def test_each_change_of_an_age_has_its_own_sentence(tmp_path, name):
    topics, words = CLOCKS[name]
    _, health, rows = card(write(tmp_path / "x.mcap", topics))
    notes = [note for note in health.notes if "another clock" not in note]
    assert len(notes) == 1
    assert words in notes[0]
    assert ("recorder's clock" in notes[0]) is (name == "the recorder")
    assert not any(row["missing_low"] for row in rows.values())


def test_bursts_and_units_of_stamps_are_said(tmp_path):
    bursts = [(START_NS + b * 100 * MS + k * 100_000, START_NS + (b - 1) * 100 * MS + k * 5 * MS) for b in range(200) for k in range(20)]  # fmt: skip
    seconds = [(at, at // S * S) for at, _ in timer(20, 20)]
    report, _, rows = card(write(tmp_path / "x.mcap", {"/livox": bursts, "/odom": seconds}))
    assert (rows["/livox"]["expected_rate_hz"], rows["/livox"]["missing"]) == (pytest.approx(200), 0)
    assert (rows["/livox"]["burst_messages"], rows["/livox"]["burst_ns"]) == (20, 1.9 * MS)
    assert rows["/odom"]["age_resolution_ns"] == S
    page = render_markdown(report)
    assert "then 98.1 ms" in page
    assert "below 1 s" in page
