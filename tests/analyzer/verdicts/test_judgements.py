from dataclasses import replace

import numpy as np
import pytest
from analyses import BRIDGED, MS, ZENOH, Measured, around, make_analysis

from dds_trace.analyzer.run_statistics.received import loss_excesses
from dds_trace.analyzer.run_statistics.setups import RunLogarithms, campaign_variance, passes_depend, setup_means
from dds_trace.analyzer.verdicts.job import Job
from dds_trace.analyzer.verdicts.judgements import Claim
from dds_trace.extensions.campaigns.recommend import recommend_settings

CHANCE = np.random.default_rng(2).standard_normal((24, 5))


def runs_losing(*counts, messages=1000):
    return [np.arange(messages) % (messages // count) != 1 if count else np.ones(messages, bool) for count in counts]


@pytest.mark.parametrize(
    ("runs", "is_sure"),
    [
        pytest.param(runs_losing(25, 40, 25), True, id="three percent of three runs"),
        pytest.param(runs_losing(25, 40), False, id="two runs"),
        pytest.param(runs_losing(1, 1, 0, messages=40), False, id="two of 120"),
        pytest.param(runs_losing(10, 10, 10), False, id="one percent"),
        pytest.param([np.zeros(100, bool)] * 3, True, id="everything"),
    ],
)
def test_advice_needs_more_than_one_percent_for_sure(runs, is_sure):
    assert loss_excesses([runs], 0.01)[0].is_sure() is is_sure


def runs_of(values):
    """Two setups, of as many kinds each."""
    return {(row // 2, "ab"[row % 2]): RunLogarithms(own, tuple(range(len(own)))) for row, own in enumerate(values)}


def test_passes_depend_where_neighbours_are_more_alike():
    assert passes_depend(runs_of(np.cumsum(CHANCE, axis=1)))
    assert not passes_depend(runs_of(CHANCE))
    assert not passes_depend(runs_of(np.zeros((24, 5))))
    # Sizes that move together are as few as setups.
    assert not passes_depend(runs_of(np.tile(CHANCE[:2, :3], (12, 1))))
    assert not passes_depend(runs_of(np.tile([1.0, -2.0, 1.0], (24, 1)) + 0.1 * CHANCE[:, :3]))


def test_few_runs_that_agree_are_no_quieter_than_their_campaign():
    modes = 0.01 * CHANCE[:12, :3] + 0.4 * np.array([[0, 0, 1], [0, 1, 0], [1, 0, 0], [0, 0, 0]] * 3)
    means = setup_means({(kind, "a"): RunLogarithms(row, (0, 1, 2)) for kind, row in enumerate(modes)})
    assert means[3, "a"].variance == pytest.approx(campaign_variance([modes - modes.mean(axis=1, keepdims=True)]) / 3)


def test_links_bridges_own_nodes_and_a_job_are_rows_of_the_frame():
    sides = ((1, {}), (2, {"connectivity": "wireless"}), (4, ZENOH), (3, BRIDGED))
    analysis = make_analysis(*(Measured(5 * around(ms * MS), runs=3, **side) for ms, side in sides))
    job = Job("binary", 33_000, 10.0, 5 * MS // 2, 0.9, domain_mode="same", metric="latency")
    asked = replace(analysis.details, recommendation=recommend_settings(analysis.load_roundtrips(), job))
    assert analysis.judgements is analysis.judgements
    judged = replace(analysis, details=asked).judgements
    of_job = judged.filter(statistic="latency_p90", base="2.5 ms").sort("value")
    assert of_job.select("claim", "verdict").rows() == [("meets", "open"), ("meets", "open"), ("misses", "proven")]
    numbers = {
        (row["claim"], row["subject"].split(";")[0], row["base"], row["verdict"]): row["value"]
        for row in judged.filter(statistic="latency_p50").iter_rows(named=True)
        if row["claim"] not in ("leads", "takes longer")
    }
    assert numbers == {
        ("differs over", "wireless", "wired", "proven"): pytest.approx(2, rel=0.01),
        ("differs through", "builtin", "the same domain", "proven"): pytest.approx(3, rel=0.01),
        (Claim.OWN_NODES.value, "zenoh", "fastdds", "open"): 0.0,
    }
