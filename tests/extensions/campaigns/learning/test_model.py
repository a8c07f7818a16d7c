"""What is learned: made campaigns of a known law, and a part of docs/results/."""

import math
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from dds_trace.analyzer.model.parameters import CELL_COLUMNS, QOS_DEFAULTS, SETTING_COLUMNS
from dds_trace.analyzer.verdicts.job import Job
from dds_trace.extensions.campaigns.halving import Candidate
from dds_trace.extensions.campaigns.learning.model import (
    OUTSIDE,
    Estimator,
    Learned,
    link_numbers,
    minutes_to_measure,
    order,
    question_of,
)
from dds_trace.extensions.campaigns.learning.results import Campaign, Result, keep
from dds_trace.extensions.campaigns.plan.cells import Cell
from dds_trace.extensions.campaigns.question import as_learned, ask

ROOT = Path(__file__).parents[4]
MEDIAN = "response 0.5"
SLOWNESS = {"fastdds": 1.5, "cyclonedds": 1.0, "zenoh": 2.5}
SIZES, RATES = (1_000, 10_000, 50_000, 200_000), (2.0, 5.0, 10.0)


def parameters(vendor="fastdds", size=10_000, rate=5.0, link="rate_mbit_s=50", **more):
    usual = {**dict.fromkeys((*SETTING_COLUMNS, *CELL_COLUMNS)), **QOS_DEFAULTS}
    named = {"vendor": vendor, "backend": "ros2", "bridge": "none", "ping_device": "a", "relay_device": "b"}
    message = {"data_type": "binary", "payload_bytes": size, "rate_hz": rate}
    return {
        **usual,
        **named,
        **message,
        "connectivity": "emulated-x",
        "setting": f"link=x({link})" if link else "",
        **more,
    }


def law_ns(values):
    return 1e6 * SLOWNESS[values["vendor"]] * (1 + values["payload_bytes"] / 5_000)


def campaign(seed, *, change=lambda _values, time_ns: time_ns, spread=0.05):
    random = np.random.default_rng(seed)
    off = random.normal(0, spread)
    cells = [parameters(vendor, size, rate) for vendor in SLOWNESS for size in SIZES for rate in RATES]
    times = [change(values, law_ns(values) * math.exp(off + random.normal(0, spread))) for values in cells]
    return Campaign(
        (f"{seed}",),
        tuple(Result(values, {MEDIAN: ns, "response 0.9": ns}) for values, ns in zip(cells, times, strict=True)),
    )


def test_a_link_of_strangers_is_read_as_far_as_it_is_one():
    assert link_numbers("link=air-30(queue_ms=400,rate_mbit_s=30,shared=1),load=busy")["rate_mbit_s"] == 30
    assert link_numbers("link=x(rate_mbit_s=nan,delay_ms=-1,loss_percent=much,a=1e300)") == {}
    assert link_numbers("link=x(file=a=b#1(") == {}


def test_the_offered_load_is_over_the_rate_that_both_directions_share():
    loads = [
        question_of(parameters(size=125_000, rate=10, link=link)).load
        for link in ("rate_mbit_s=20", "rate_mbit_s=20,shared=1")
    ]
    assert loads == pytest.approx([0.5, 1.0])


@pytest.mark.parametrize("reliability", [0.5, 0.99, 0.999])
def test_the_minutes_are_of_a_sweep_that_would_measure_it(reliability):
    few = minutes_to_measure(parameters(rate=100.0), reliability)
    assert 1 <= few < minutes_to_measure(parameters(rate=0.1), reliability)


def test_without_scikit_learn_nothing_is_guessed_and_the_order_stays(monkeypatch):
    monkeypatch.setitem(sys.modules, "sklearn", None)
    guess = Estimator(None, Job("binary", 10_000, 5.0, 10**7, 0.5))(parameters())
    assert (guess.value_ns, guess.reason) == (None, "not known: measure it (1 minute)")
    candidates = [parameters(vendor) for vendor in ("zenoh", "cyclonedds")]
    assert order(candidates, [campaign(1)], MEDIAN) == candidates


@pytest.mark.parametrize("reliability", [0.91, 0.99, 0.999])
def test_beyond_p90_nothing_is_guessed(reliability):
    guess = Estimator(None, Job("binary", 10_000, 5.0, 10**7, reliability))(parameters())
    assert guess.value_ns is None
    assert "estimates end at --reliability 0.9" in guess.reason
    assert guess.reason.startswith("not known: measure it (")


@pytest.fixture(scope="module")
def learned():
    pytest.importorskip("sklearn", reason="the extra learn is not installed")
    return Learned([campaign(seed) for seed in range(3)], MEDIAN)


class TestWithScikitLearn:
    @pytest.fixture(autouse=True)
    def needs(self):
        pytest.importorskip("sklearn", reason="the extra learn is not installed")

    @pytest.mark.parametrize("more", [(), (campaign(9, change=lambda _, time_ns: 8 * time_ns),)])
    def test_a_size_and_a_rate_between_also_next_to_a_campaign_beside_other_work(self, learned, more):
        values = parameters(size=25_000, rate=3.0)
        learned = Learned([*more, *map(campaign, range(3))], MEDIAN) if more else learned
        assert learned.campaigns == 3
        value, lower, upper = learned.guess(question_of(values))
        assert value == pytest.approx(law_ns(values), rel=0.3)
        assert lower < law_ns(values) < upper < 2 * value

    @pytest.mark.parametrize(
        "more",
        [
            {"size": 500_000},
            {"rate": 50.0},
            {"rate": math.inf},
            {"link": "rate_mbit_s=500"},
            {"link": "rate_mbit_s=50,delay_ms=40"},
            {"link": "rate_mbit_s=50,loss_percent=2"},
            {"vendor": "connext"},
            {"relay_device": "pi"},
            {"bridge": "builtin"},
            {"setting": "link=x(rate_mbit_s=50),load=busy"},
        ],
    )
    def test_outside_of_what_was_measured_nothing_is_said(self, learned, more):
        assert learned.guess(question_of(parameters(**more))) == OUTSIDE

    def test_settings_that_nobody_measured_are_named(self, learned):
        assert "depth=1" in learned.guess(question_of(parameters(depth=1)))

    def test_a_link_that_the_load_fills(self):
        campaigns = [campaign(seed) for seed in range(3)]
        full = Result(parameters(size=200_000, rate=100.0), {MEDIAN: 1e9})
        learned = Learned([*campaigns, Campaign(("9",), (full,))], MEDIAN)
        assert "320 % of the link" in learned.guess(question_of(parameters(size=200_000, rate=99.9)))

    def test_next_to_losses_nothing_is_said(self):
        def losing(values, time_ns):
            return math.inf if values["payload_bytes"] == max(SIZES) and values["vendor"] == "fastdds" else time_ns

        learned = Learned([campaign(seed, change=losing) for seed in range(3)], MEDIAN)
        assert "lost" in learned.guess(question_of(parameters(size=150_000)))
        assert not isinstance(learned.guess(question_of(parameters(size=20_000))), str)

    def test_where_left_out_campaigns_are_twice_off_nothing_is_said(self):
        campaigns = [campaign(seed, change=lambda _, ns, seed=seed: ns * 9**seed) for seed in range(3)]
        answer = Learned(campaigns, MEDIAN).guess(question_of(parameters(size=25_000, rate=3.0)))
        assert "too little" in answer or "too far" in answer

    def test_one_campaign_is_left_out_by_its_sizes_and_rates(self):
        learned = Learned([campaign(1)], MEDIAN)
        assert learned.errors.held_out > 3 * len(SLOWNESS)  # those between
        assert not isinstance(learned.guess(question_of(parameters(size=25_000, rate=3.0))), str)

    @pytest.mark.parametrize("count", [0, 5])
    def test_of_few_results_nothing_is_learned(self, count):
        few = Campaign(("1",), campaign(1).results[:count])
        assert isinstance(Learned([few], MEDIAN).guess(question_of(parameters())), str)
        assert order([parameters()], [few], MEDIAN) == [parameters()]

    def test_the_quickest_candidate_comes_first_and_one_that_loses_last(self):
        def losing(values, time_ns):
            return math.inf if values["vendor"] == "cyclonedds" else time_ns

        candidates = [parameters(vendor, 30_000) for vendor in ("zenoh", "cyclonedds", "fastdds")]
        for change, expected in ((lambda _, ns: ns, "cfz"), (losing, "fzc")):
            ranked = order(candidates, [campaign(seed, change=change) for seed in range(2)], MEDIAN)
            assert "".join(values["vendor"][0] for values in ranked) == expected

    def test_advise_tries_first_what_was_quick_before(self):
        plan = ask("30KB", "5", link="wifi-54")
        candidates = [
            Candidate(vendor, vendor, "", (Cell(backend="ros2", size=30_000, rate=5.0),)) for vendor in SLOWNESS
        ]
        assert as_learned(plan, candidates) == candidates
        keep(campaign(1))
        candidates.append(replace(candidates[1], bundle="buffers", turn=2))
        ranked = [(one.vendor, one.bundle) for one in as_learned(plan, candidates)]
        assert ranked == [("cyclonedds", ""), ("fastdds", ""), ("zenoh", ""), ("cyclonedds", "buffers")]

    @pytest.mark.thorough
    def test_of_kept_campaigns_that_are_left_out_most_are_within_twice(self, monkeypatch):
        monkeypatch.setattr(sys, "path", [str(ROOT / "benchmarks"), *sys.path])
        bench = import_module("bench_learning")
        campaigns = bench.kept_campaigns("gallery", "loopback", "study/link", "study/explain-size", "emulated-link")
        shares = bench.shares(list(bench.left_out(campaigns, MEDIAN)))
        assert shares["number"] >= 0.5
        assert shares["within"] >= 0.9
        assert shares["covered"] >= 0.7
