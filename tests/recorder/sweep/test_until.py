from __future__ import annotations

import math

import pytest
from sweep_desk import FIRST, PLAN, SECOND, files_of

from dds_trace.base.errors import OptionError
from dds_trace.recorder.sweep.sweep import Until, parse_target
from dds_trace.tracefile.reading.reader import read_trace


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
