import csv
import json
import math
from collections import Counter
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from sweep_desk import FIRST, PLAN, SECOND, files_of

from dds_trace.base.errors import OptionError
from dds_trace.extensions.campaigns.max_rate_report import COLUMNS, max_rate_rows, max_rate_svg, write_max_rates
from dds_trace.extensions.campaigns.plan.cells import Cell
from dds_trace.extensions.campaigns.plan.plan import Search
from dds_trace.extensions.campaigns.plan.plan_file import parse_plan
from dds_trace.extensions.campaigns.plan.schedule import LOSS_OVERHEAD_S, plan_seconds
from dds_trace.extensions.campaigns.run.result import CellResult
from dds_trace.extensions.campaigns.search import (
    Bisection,
    MaxRate,
    RateAnswer,
    bisect_rates,
    messages_needed,
    search_estimate,
    search_estimates,
    search_plan,
    why_not_sustained,
)
from dds_trace.extensions.campaigns.sweep import Until, parse_target
from dds_trace.tracefile.reading.reader import read_trace

SEARCH = Search(min_rate=1, max_rate=1000, resolution=1.1, knee_repeats=3)


def search(holds, settings=SEARCH):
    trials = Counter()

    def trial(rate_hz, number):
        trials[rate_hz] += 1
        return "" if holds(rate_hz, number) else f"{rate_hz:g} is too much"

    return bisect_rates(settings, trial), trials


@pytest.mark.parametrize("limit_hz", [1.5, 7, 33, 100, 480, 990])
def test_limit_is_found_within_the_resolution(limit_hz):
    (answer, rate_hz, failing_hz, reason), trials = search(lambda rate_hz, _: rate_hz <= limit_hz)
    assert answer is RateAnswer.FOUND
    assert rate_hz <= limit_hz < failing_hz <= rate_hz * 1.11
    assert reason == f"{failing_hz:g} is too much"
    assert (
        sum(trials.values()) <= 23
    )  # 7 halvings of a factor of 1000 to 1.1, failures confirmed, and the repeats at the knee


@pytest.mark.parametrize(
    ("sustains", "knee"),
    [(True, (RateAnswer.AT_LEAST, 1000, None, "")), (False, (RateAnswer.BELOW, 1, 1, "1 is too much"))],
)
def test_middleware_that_sustains_everything_or_nothing(sustains, knee):
    found, trials = search(lambda *_: sustains)
    assert found == knee
    assert trials[found.rate_hz] == 2  # two of three decide


@pytest.mark.parametrize(
    ("holds", "low", "high"),
    [
        pytest.param(lambda rate, n: rate <= 100 and (n > 1 or rate < 90), 82, 100, id="one bad run"),
        pytest.param(lambda rate, n: rate <= 50 or (n == 1 and rate <= 120), 45, 50, id="one lucky run"),
    ],
)
def test_one_run_at_the_knee_is_outvoted(holds, low, high):
    (answer, rate_hz, _, _), _ = search(holds)
    assert answer is RateAnswer.FOUND
    assert low <= rate_hz <= high


def result(**changes):
    fields = {
        "run_id": "00000000000000ff",
        "planned": 1000,
        "published": 1000,
        "received": 1000,
        "sent_bytes": 33_000_000,
        "achieved_rate_hz": 100.0,
        "rtt_ms": {"p50": 1.0, "p99": 20.0},
        "response_ms": {"p50": 1.0, "p99": 20.0},
        "dropped_events": 0,
        "cut_off": False,
    }
    return CellResult(**{**fields, **changes})


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({}, ""),
        ({"received": 999}, ""),
        ({"received": 990}, "1 % lost"),
        ({"planned": 225, "published": 225, "received": 224}, ""),  # one lost says nothing about 0.1 %
        ({"planned": 225, "published": 225, "received": 223}, "0.889 % lost"),
        ({"achieved_rate_hz": 95.0}, ""),
        ({"achieved_rate_hz": 94.0}, "94 of 100 Hz sent"),
        ({"achieved_rate_hz": None}, "0 of 100 Hz sent"),
        ({"response_ms": {"p50": 1.0, "p99": 51.0}}, "response p99 51 ms"),
        ({"response_ms": None, "received": 0}, "100 % lost; response p99 inf ms"),
        ({"not_applied": "asked for UDP"}, "not applied: asked for UDP"),
        ({"cut_off": True, "published": 500, "received": 500}, "cut off after 500 of 1,000 messages"),
    ],
)
def test_conditions_of_a_rate_that_holds(changes, why):
    assert why_not_sustained(Search(), 100.0, result(**changes)) == why


def test_runs_are_long_enough_for_the_percentile():
    needed = {50.0: 2, 90.0: 10, 95.0: 20, 99.0: 100, 99.9: 1000}
    assert {p: messages_needed(Search(percentile=p)) for p in needed} == needed
    plan = search_plan(parse_plan("[run]\nmessages = 7\n[axes]\nrate = [1, 10]\n[search]\nseconds = 5\n", "p", "p"))
    assert plan.name == "p-max-rate"
    assert len(plan.cells) == 1
    assert plan.run.messages_at(2.0) == 100
    assert plan.run.messages_at(100.0) == 500


ANSWERS = [
    MaxRate(Cell(size=33_000, rate=480.0), RateAnswer.FOUND, 510.0, (3, 3), "2 % lost"),
    MaxRate(Cell(size=91, rate=1000.0), RateAnswer.AT_LEAST, None, (2, 2), ""),
    MaxRate(Cell(size=4_000_000, rate=1.0), RateAnswer.BELOW, 1.0, (0, 2), "response p99 80 ms"),
    MaxRate(Cell(backend="<b>", rate=0.0), RateAnswer.FAILED, None, (0, 0), "no echo"),
]


def test_table_has_a_rate_only_where_one_holds():
    rows = [dict(zip(COLUMNS, row, strict=True)) for row in max_rate_rows(ANSWERS)]
    assert [row["max_rate_hz"] for row in rows] == ["480", "1000", "", ""]
    assert [row["fails_at_hz"] for row in rows] == ["510", "", "1", ""]
    assert rows[0]["held"] == "3/3"
    assert rows[0]["size"] == "33KB"


def test_table_and_figure_are_written(tmp_path):
    paths = write_max_rates(tmp_path, ANSWERS, SEARCH)
    assert [path.name for path in paths] == ["max_rate.json", "max_rate.csv", "max_rate.svg"]
    assert json.loads(paths[0].read_text())["answers"][0]["answer"] == "found"
    assert len(list(csv.reader(paths[1].read_text().splitlines()))) == 1 + len(ANSWERS)
    bars = [
        float(element.get("width"))
        for element in ET.parse(paths[2]).getroot()
        if element.get("fill", "").startswith("#") and element.tag.endswith("rect")
    ]
    assert bars[1] > bars[0] > bars[2]


def test_figure_escapes_its_texts_and_takes_an_empty_list():
    assert "<b>" not in max_rate_svg(ANSWERS, SEARCH)
    assert "&lt;b&gt;" in max_rate_svg(ANSWERS, SEARCH)
    ET.fromstring(max_rate_svg([], replace(SEARCH, min_rate=3, max_rate=7)))


@pytest.mark.parametrize(("lowest", "highest"), [(1, 1000), (3, 7), (30, 45), (0.5, 2000)])
def test_figure_has_its_labels_whole_and_ticks_of_its_axis(lowest, highest):
    long = Cell(backend="ros2", rmw="rmw_fastrtps_dynamic_cpp", bridge="zenoh-bridge-ros2dds", size=4, depth=1, rate=1)
    answers = [MaxRate(long, RateAnswer.FOUND, 2.0, (3, 3), ""), *ANSWERS]
    drawn = ET.fromstring(max_rate_svg(answers, replace(SEARCH, min_rate=lowest, max_rate=highest)))
    texts = {text.text: text for text in drawn if text.tag.endswith("text")}
    label = max((name for name, text in texts.items() if text.get("text-anchor") == "end"), key=len)
    assert "depth" in label
    assert float(texts[label].get("x")) > 6.5 * len(label)  # from the right end
    ticks = [text for name, text in texts.items() if text.get("text-anchor") == "middle" and name[0].isdigit()]
    assert len(ticks) >= 2
    assert any("log scale" in name for name in texts)
    assert any("1 Hz fails" in name for name in texts)


@pytest.mark.parametrize("truth_hz", [100, 1000])
def test_single_losses_of_half_the_limit_seldom_halve_the_answer(truth_hz):
    """0.05 % of the messages are lost one by one, 0.1 % are allowed; 23 % of answers were below half of 1000 Hz."""
    settings, low = Search(), 0
    for seed in range(200):
        losses: dict[tuple[float, int], str] = {}
        draws = np.random.default_rng(seed)

        def trial(rate_hz, number, losses=losses, draws=draws):
            sent = max(100, int(rate_hz * settings.seconds))
            lost = result(published=sent, received=sent - int(draws.binomial(sent, 5e-4)), achieved_rate_hz=rate_hz)
            why = why_not_sustained(settings, rate_hz, lost)
            return losses.setdefault((rate_hz, number), why or "late" * (rate_hz > truth_hz))

        knee = bisect_rates(settings, trial)
        low += knee.answer is RateAnswer.BELOW or knee.rate_hz < truth_hz / 2
    assert low <= 4


def test_the_answer_is_at_least_the_rate_where_the_steps_run_out_on_the_way_up(monkeypatch):
    monkeypatch.setattr("dds_trace.extensions.campaigns.search.KNEE_STEPS", 1)
    knee = Bisection(1, 1000, 1.1, 3, lambda rate, _: "late" * (rate > 900))._settle(30, 33, "late once")
    assert knee == (RateAnswer.AT_LEAST, 33, None, "")


class Widths:
    """A measure by hand: the first cell is precise at once, the second only from its third run on."""

    def __init__(self):
        self.asked = []

    def __call__(self, folder, runs):
        self.asked.append({name: len(of_cell) for name, of_cell in runs.items()})
        for name, of_cell in runs.items():
            paths = sorted(folder.glob(f"{name}*.ping.mcap"))
            assert [read_trace(path).runs[0].run_id for path in paths] == list(of_cell)
        return {name: 4.0 if name == FIRST else 12.0 / len(of_cell) for name, of_cell in runs.items()}


def until(measure, max_passes, percent=5.0):
    return Until("latency_p99", percent, max_passes, measure)


def test_further_passes_are_run_over_the_wide_cells_alone(desk, sentences):
    measure = Widths()
    outcome = desk.sweep(until=until(measure, 20))
    assert (outcome.missing, outcome.too_wide, outcome.cells) == ({}, {}, 4)
    assert desk.traces == files_of(FIRST, SECOND, f"{SECOND}_r2", f"{SECOND}_r3")
    assert measure.asked == [{FIRST: 1, SECOND: n} for n in (1, 2, 3)]
    sentences(desk.heard.notes[-1])


def test_cells_still_too_wide_are_named_and_a_later_call_goes_on(desk):
    first = desk.sweep(until=until(Widths(), 2))
    assert first.too_wide == {SECOND: 6.0}
    starts = desk.started
    second = desk.sweep(until=until(Widths(), 3))
    assert second.too_wide == {}
    assert (desk.started - starts).total() == 2  # one ping and its relay
    assert desk.traces == files_of(FIRST, SECOND, f"{SECOND}_r2", f"{SECOND}_r3")


def test_interval_without_an_end_is_too_wide_and_the_number_of_passes_ends_it(desk):
    outcome = desk.sweep(until=until(lambda _, runs: dict.fromkeys(runs, math.inf), 2))
    assert outcome.too_wide == {FIRST: math.inf, SECOND: math.inf}
    assert outcome.cells == 4


def test_cell_that_was_never_recorded_is_missing_and_is_not_tried_in_further_passes(desk):
    desk.script(**{FIRST: ["unavailable"]})
    outcome = desk.sweep(PLAN, until=until(Widths(), 3))
    assert list(outcome.missing) == [FIRST]
    assert outcome.too_wide == {}
    assert desk.started[FIRST] == 1


@pytest.mark.parametrize(
    ("text", "target"), [("latency_p99:5%", ("latency_p99", 5.0)), (" rtt_p50 : 2.5 % ", ("rtt_p50", 2.5))]
)
def test_target_is_a_statistic_and_a_percentage(text, target):
    assert parse_target(text) == target


@pytest.mark.parametrize("text", ["latency_p99", "latency_p99:5", "latency_p99:0%", "latency_p99:1.2.3%", ":5%"])
def test_other_targets_are_refused(text):
    with pytest.raises(OptionError, match="write STATISTIC:PERCENT"):
        parse_target(text)


SEARCHED = """
[search]
min_rate = 10
max_rate = 1000
[axes]
backend = "socket"
[[matrix]]
size = ["33KB", "145KB"]
"""


@pytest.mark.parametrize("limit_hz", [5, 12, 70, 300, 990, 5000])
def test_a_dry_run_of_a_search_counts_the_recordings_that_the_search_makes(limit_hz):
    plan = search_plan(parse_plan(SEARCHED, "s", "s.toml"))
    cell, recorded = plan.cells[0], set()

    def trial(rate_hz, number):
        recorded.add((rate_hz, number))
        return "late" * (rate_hz > limit_hz)

    bisect_rates(plan.search, trial)
    cost = search_estimate(plan, cell, limit_hz)
    assert len(recorded) <= cost.recordings <= 2 * len(recorded)
    least_s = sum(plan.run.planned_seconds(rate_hz) for rate_hz, _ in recorded)
    assert least_s < cost.seconds < 3 * least_s + 12 * cost.recordings
    least, expected, most = search_estimates(plan)
    assert least.recordings <= 2 * cost.recordings <= most.recordings
    assert least.seconds <= expected.seconds <= most.seconds
    all_work = 2 * search_estimate(plan, cell, 5000).recordings
    assert all_work < expected.recordings < (all_work + most.recordings) / 2


def test_a_link_that_carries_less_or_loses_takes_time_as_long_as_a_run_may_take():
    text = "[run]\nseconds = 5\n{}[axes]\nbackend = '{}'\n[[matrix]]\nsize = '145KB'\nrate = {}\n"

    def seconds(link, rate_hz, backend="cyclonedds"):
        plan = parse_plan(text.format(link, backend, rate_hz), "s", "s.toml")
        return plan_seconds(plan).seconds

    wire, lossy = "[link]\nrate_mbit_s = 100\n", "[link]\nrate_mbit_s = 100\nloss_percent = 1\n"
    plain = seconds("", 50)
    assert seconds(wire, 50) == plain
    assert seconds(lossy, 50) == plain + LOSS_OVERHEAD_S
    assert seconds(lossy, 50, "socket") == plain  # TCP
    assert seconds(wire, 172.4, "socket") == pytest.approx(plain + 5, rel=0.01)
    assert seconds(wire, 172.4) == pytest.approx(plain + LOSS_OVERHEAD_S + 5, rel=0.01)  # twice what it carries
    assert seconds(wire, 2000) == pytest.approx(plain + LOSS_OVERHEAD_S + 30, rel=0.01)
    assert seconds(wire.replace("]", "]\nshared = true"), 86.2) == pytest.approx(plain + LOSS_OVERHEAD_S + 5, rel=0.01)
