import numpy as np
import polars as pl
import pytest

from dds_trace.extensions.campaigns.verdicts.explain import client_median, explain

US = 1_000.0
REPEATS = range(1, 7)
PAIRS = {
    "as is": ("fast", "slow"),
    "machine": ("socket fast", "socket slow"),
    "client library": ("client fast", "client slow"),
    "awake": ("fast awake", "slow awake"),
    "realtime": ("fast fifo", "slow fifo"),
}


def medians(seed=2, spread_us=4.0):
    """A rise of 200 us: 120 of the machine, 50 of the client library; awake processors remove 110. The machine drifts by repeats."""
    chance = np.random.default_rng(seed)
    drift = dict(zip(REPEATS, chance.normal(0, 20, len(REPEATS)), strict=True))
    truth = {
        "fast": 300,
        "slow": 500,
        "socket fast": 60,
        "socket slow": 180,
        "client fast": 90,
        "client slow": 140,
        "fast awake": 290,
        "slow awake": 380,
        "fast fifo": 300,
        "slow fifo": 500,
    }
    return {
        cell: {number: US * (us + drift[number] + chance.normal(0, spread_us)) for number in REPEATS}
        for cell, us in truth.items()
    }


def test_shares_add_up_and_their_intervals_contain_the_truth():
    answer = explain(PAIRS, medians(), is_ratio=False)
    shares = {one.name: one for one in answer.shares}
    assert sum(one.value for one in answer.shares) == pytest.approx(answer.rise.value)
    assert sum(one.share for one in answer.shares) == pytest.approx(1)
    for name, truth_us in (("machine", 120), ("client library", 50), ("middleware", 30)):
        assert shares[name].low < truth_us * US < shares[name].high
    removed = {one.name: one for one in answer.removed}
    assert removed["awake"].low < 110 * US < removed["awake"].high
    assert not removed["realtime"].is_sure
    assert answer.cause == "awake"


def test_intervals_contain_the_truth_as_often_as_they_say():
    covered = 0
    for seed in range(200):
        (machine, *_) = explain(PAIRS, medians(seed), is_ratio=False).shares
        covered += machine.low < 120 * US < machine.high
    assert 180 <= covered <= 199


def test_the_native_vendor_is_the_client_librarys_control():
    values = medians() | {
        "native fast": dict.fromkeys(REPEATS, 100 * US),
        "native slow": dict.fromkeys(REPEATS, 240 * US),
    }
    answer = explain({**PAIRS, "native": ("native fast", "native slow")}, values, is_ratio=False)
    shares = {one.name: one.value / US for one in answer.shares}
    assert shares["client library"] == pytest.approx(60, abs=10)
    assert sum(shares.values()) == pytest.approx(answer.rise.value / US)


def test_what_was_not_measured_is_not_told_apart():
    pairs = {"as is": PAIRS["as is"], "machine": ("a", "b"), "awake": ("c", "d")}
    answer = explain(pairs, medians(), is_ratio=False)
    assert [one.name for one in answer.shares] == ["middleware and client library"]
    assert answer.removed == ()
    assert answer.cause == ""
    assert explain({"as is": ("a", "b")}, medians(), is_ratio=False) is None


def jump(segment, buffer, repeats=5, seed=3, spread=0.1):
    chance = np.random.default_rng(seed)
    truth = {"small": 1e6, "large": 8e6, "small s": 1e6, "large s": segment, "small b": 1e6, "large b": buffer}
    values = {
        cell: {number: ns * float(np.exp(chance.normal(0, spread))) for number in range(1, repeats + 1)}
        for cell, ns in truth.items()
    }
    pairs = {"as is": ("small", "large"), "segment": ("small s", "large s"), "buffer": ("small b", "large b")}
    return explain(pairs, values, is_ratio=True)


@pytest.mark.parametrize(
    ("segment", "buffer", "cause"),
    [
        (1e6, 8e6, "segment"),
        (8e6, 1e6, "buffer"),
        (1e6, 4e6, "segment"),  # both move it: the one that moves it more
        (8e6, 8e6, ""),
        (6e6, 8e6, ""),  # less than a quarter of it
        (2e9, 8e6, ""),  # worse
    ],
)
def test_a_jump_is_moved_by_what_removes_most_of_it(segment, buffer, cause):
    answer = jump(segment, buffer)
    assert answer.rise.low < 8 < answer.rise.high
    assert answer.cause == cause
    assert answer.shares == ()


def test_two_repeats_name_nothing():
    answer = jump(1e6, 8e6, repeats=2)
    assert (answer.rise.low, answer.cause) == (None, "")


def test_noise_is_not_named():
    assert sum(jump(8e6, 8e6, seed=seed, spread=0.4).cause != "" for seed in range(200)) <= 10


def test_the_client_library_has_the_waits_of_both_ways():
    parts = ["relay_delivery_ns", "outbound_transport_ns", "ping_delivery_ns"]
    frame = pl.DataFrame({"part": parts, "p50_ns": [40.0, 900.0, 60.0]})
    assert client_median(frame) == 50
    assert client_median(frame.head(1)) is None
