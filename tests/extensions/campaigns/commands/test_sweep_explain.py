import itertools
from dataclasses import replace

import pytest
from campaigns import write_run
from trace_files import evenly

from dds_trace.extensions.campaigns.commands.explain import answer, answer_lines
from dds_trace.extensions.campaigns.explain import explain_rates, explain_size
from dds_trace.extensions.campaigns.plan.plan_file import parse_plan

US = 1_000
LATENCY_US = {
    "as is": (300, 500),
    "machine": (60, 180),
    "realtime": (300, 500),
    "awake": (290, 380),
    "dma_latency": (300, 450),
}
EXTRA = {
    "awake": {"load": {"kind": "awake", "program": "own", "cpu_s": 1.0, "elapsed_s": 2.0}},
    "realtime": {"realtime_priority": 50, "realtime_threads": 4},
    "dma_latency": {"load": {"kind": "dma-latency", "program": "cpu_dma_latency 0 us"}},
}


def write_cell(folder, number, cell, repeat, latency_us, extra, lost=0):
    messages = evenly([latency_us * US] * 10, period_ns=1_000_000_000, relay_ns=50)
    write_run(
        folder / str(number),
        number,
        [replace(one, t2=None) for one in messages[:lost]] + messages[lost:],
        ping={"extra": extra},
        rate_hz=cell.rate,
        labels={"cell": cell.name, "pass": str(repeat)},
        extra={"settings": {"cell": cell.name}},
    )


def write_campaign(folder, explanation, latencies_us, extra=EXTRA):
    numbers = itertools.count(1)
    (setup,) = explanation.setups
    cells = {}
    for key, pair in setup.pairs.items():
        for cell, latency_us in zip(pair, latencies_us.get(key, (0, 0)), strict=True):
            if latency_us:
                cells.setdefault(cell, (latency_us, extra.get(key, {})))
    for (cell, (latency_us, more)), repeat in itertools.product(cells.items(), (1, 2, 3)):
        write_cell(folder, next(numbers), cell, repeat, latency_us + 5 * repeat, more)
    return setup.name


def rates():
    return explain_rates(parse_plan('[axes]\nbackend = "cyclonedds"\nrate = [10, 500]', "p", "p.toml"))


def test_shares_of_made_traces_are_the_ones_they_were_made_with(tmp_path):
    explanation = rates()
    name = write_campaign(tmp_path, explanation, LATENCY_US)
    answers, left_out = answer(explanation, tmp_path)
    found = answers[name]
    assert found.rise.value == pytest.approx(200 * US)
    assert {one.name: round(one.value / US) for one in found.shares} == {
        "machine": 120,
        "middleware and client library": 80,
    }
    lines = list(answer_lines(explanation, explanation.setups[0], found))
    assert lines[0].startswith(name)
    assert len(lines) == 1 + len(found.shares) + len(found.removed)
    removed = {one.name: round(one.value / US) for one in found.removed}
    if "dma_latency" in explanation.left_out:
        removed.setdefault("dma_latency", 50)
    assert removed == {"awake": 110, "dma_latency": 50, "realtime": 0}
    assert left_out == {}


def test_a_condition_that_its_process_did_not_have_counts_for_nothing(tmp_path):
    explanation = rates()
    without = {
        "awake": {"load": {"kind": "awake", "program": "", "cpu_s": 0.0, "elapsed_s": 2.0}},
        "realtime": {"realtime_priority": 50},
        "dma_latency": {"load": {"kind": "dma-latency", "program": ""}},
    }
    name = write_campaign(tmp_path, explanation, LATENCY_US, without)
    answers, left_out = answer(explanation, tmp_path)
    assert answers[name].removed == ()
    assert left_out.keys() >= {"awake", "realtime"}


def test_a_size_whose_messages_are_lost_has_a_jump_and_the_factor_that_brings_them_back_moves_it(tmp_path):
    plan = parse_plan('[axes]\nbackend = "cyclonedds"\n', "p", "p.toml")
    explanation = explain_size(plan, "100KB..300KB")
    (setup,) = explanation.setups
    numbers = itertools.count(1)
    for key, (small, large) in setup.pairs.items():
        for repeat in (1, 2, 3):
            write_cell(tmp_path, next(numbers), small, repeat, 100 + repeat, {})
            write_cell(tmp_path, next(numbers), large, repeat, 100 + repeat, {}, lost=0 if key == "buffer" else 8)
    found = answer(explanation, tmp_path)[0][setup.name]
    assert found.rise.value == pytest.approx(2e9 / (102 * US), rel=0.1)
    assert found.cause == "buffer"


def test_without_a_rise_there_are_no_shares(tmp_path):
    explanation = rates()
    name = write_campaign(tmp_path, explanation, LATENCY_US | {"as is": (300, 290)})
    found = answer(explanation, tmp_path)[0][name]
    assert len(list(answer_lines(explanation, explanation.setups[0], found))) == 2
