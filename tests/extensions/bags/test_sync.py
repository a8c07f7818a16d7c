"""Stamps of two topics against each other: offsets and drifts that are known, and what cannot be compared."""

from types import SimpleNamespace

import numpy as np
import pytest
from card_bags import MS, START_NS, S, write
from typer.testing import CliRunner

from dds_trace.base.errors import OptionError
from dds_trace.extensions.bags.analyze import analyze_topics
from dds_trace.extensions.bags.command import app
from dds_trace.extensions.bags.report import BagReport
from dds_trace.extensions.bags.sync import compare_stamps


def made(rng, rate_hz, seconds, offset_ns=0.0, ppm=0.0):
    sent_s = np.sort(rng.uniform(0, seconds, int(rate_hz * seconds)))
    log_s = np.sort(sent_s + rng.gamma(3, 3e-4, len(sent_s)))
    stamps_ns = sent_s * 1e9 * (1 - ppm * 1e-6) - offset_ns
    return START_NS + np.rint(log_s * 1e9).astype(np.int64), START_NS + np.rint(stamps_ns).astype(np.int64)


def times(log_ns, stamp_ns):
    return SimpleNamespace(log_ns=log_ns, stamp_ns=stamp_ns)


@pytest.mark.parametrize("keeps", range(5))
def test_offset_and_drift_are_within_their_bounds(keeps):
    outside = 0
    for seed in range(40):
        rng = np.random.default_rng(100 * keeps + seed)
        seconds, ppm, offset_ns = rng.uniform(20, 600), rng.uniform(-100, 100), rng.uniform(-S, S)
        topics = {"/a": times(*made(rng, 30, seconds, offset_ns, ppm)), "/b": times(*made(rng, 200, seconds))}
        sync = compare_stamps(("/a", "/b"), topics)
        middle_ns = offset_ns + ppm * 1e-6 * seconds * 1e9 / 2
        assert sync.offset_ns == pytest.approx(middle_ns, abs=MS)
        assert sync.end_ns - sync.start_ns == pytest.approx(ppm * seconds * 1e3 * 14 / 16, abs=MS)
        assert sync.spread_ns < MS
        outside += abs(sync.drift_ppm - ppm) > sync.drift_bound_ppm
    assert outside <= 6  # of 40, with an interval of 95 %


def test_the_bag_has_it_in_words_and_json(tmp_path):
    rng = np.random.default_rng(1)
    topics = {"/camera": made(rng, 30, 100, 40 * MS, 50), "/imu": made(rng, 100, 100)}
    path = write(
        tmp_path / "a.mcap", {name: [*zip(*map(np.ndarray.tolist, both), strict=True)] for name, both in topics.items()}
    )
    report = analyze_topics(path, sync=("/camera", "/imu"))
    (row,) = BagReport(report).document["syncs"]
    assert (row["topic"], row["other"], row["messages"]) == ("/camera", "/imu", 3000)
    assert row["drift_ppm"] == pytest.approx(50, abs=2)
    done = CliRunner().invoke(app, [str(path), "--sync", "/camera,/imu", "--out", str(tmp_path / "out")])
    assert "/camera are 42.5 ms older" in " ".join(done.output.split())
    same = analyze_topics(path, sync=("/camera", "/camera")).syncs[0][1]
    assert "no drift above" in same.words


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ("/camera", "name two topics"),
        ("/camera,/nothing", "no topic /nothing"),
        ("/camera,", "name two topics"),
        ("/camera,/late", "fewer than 8 messages"),
        ("/camera,/a,/b", "name two topics"),
    ],
)
def test_what_cannot_be_compared_is_one_line(tmp_path, asked, words):
    rng = np.random.default_rng(1)
    log_ns, stamp_ns = made(rng, 30, 60)
    topics = {"/camera": (log_ns, stamp_ns), "/late": (log_ns[-9:], stamp_ns[-9:])}
    path = write(
        tmp_path / "a.mcap", {name: [*zip(*map(np.ndarray.tolist, both), strict=True)] for name, both in topics.items()}
    )
    done = CliRunner().invoke(app, [str(path), "--sync", asked])
    assert isinstance(done.exception, OptionError)
    assert words in str(done.exception)


def test_a_topic_without_stamps_has_no_clock():
    none = times(np.arange(20), np.full(20, -(2**63)))
    with pytest.raises(OptionError, match="have no stamp"):
        compare_stamps(("/a", "/a"), {"/a": none})
