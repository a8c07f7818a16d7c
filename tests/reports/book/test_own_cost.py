from dataclasses import replace

import pytest
from analyses import MS, Measured, make_analysis
from wording import numbers

from dds_trace.reports.book.book import Book
from dds_trace.reports.book.overview import Fact
from dds_trace.reports.book.recording import OwnCost, own_costs
from dds_trace.reports.reporters import load_reporter

FLOOR = {"median_ns": 400_000, "p99_ns": 1_200_000, "messages": 50}
COST = {"record_median_ns": 900, "record_p99_ns": 2000}


def analysis_of(extras, *measured):
    """One session's `extra` after the other, in the order of the sessions."""
    analysis = make_analysis(*(measured or (Measured([MS]),)))
    held = [replace(session, extra=extra) for session, extra in zip(analysis.sessions, extras, strict=False)]
    return replace(analysis, sessions=(*held, *(replace(one, extra={}) for one in analysis.sessions[len(held) :])))


def facts(analysis):
    return {fact.label: fact.value for fact in Book(analysis).overview.facts}


def test_of_several_sessions_the_slowest_counts(sentences):
    slower = {"recorder_cost": {**COST, "record_p99_ns": 5000}, "client_library_floor": {**FLOOR, "messages": 20}}
    analysis = analysis_of([{"recorder_cost": COST, "client_library_floor": FLOOR}, slower])
    assert own_costs(analysis) == (OwnCost("fastdds", "ros2", 900, 5000, 400_000, 1_200_000, 20),)
    assert numbers(facts(analysis)["Cost of measuring"]) == [900, 5, 400, 1.2]
    sentences(facts(analysis)["Cost of measuring"])


def test_of_several_middlewares_the_slowest_is_told_in_one_line(sentences):
    analysis = analysis_of(
        [
            {"client_library_floor": {**FLOOR, "median_ns": 90_000}},
            {"client_library_floor": FLOOR},
            {"client_library_floor": {**FLOOR, "median_ns": 70_000}},
        ],
        Measured([MS], vendor="zenoh", backend="zenoh", relay_device=None),
        Measured([MS], vendor="cyclonedds", relay_device=None),
        Measured([MS], vendor="cyclonedds", backend="cyclonedds", relay_device=None),
    )
    assert numbers(facts(analysis)["Cost of measuring"]) == [400, 1.2]
    sentences(facts(analysis)["Cost of measuring"])
    assert {(cost.vendor, cost.backend): cost.floor_median_ns for cost in own_costs(analysis)} == {
        ("cyclonedds", "cyclonedds"): 90_000,
        ("cyclonedds", "ros2"): 400_000,
        ("zenoh", "zenoh"): 70_000,
    }


@pytest.mark.parametrize("extra", [{}, {"client_library_floor": None}, {"client_library_floor": {"median_ns": "x"}}])
def test_what_was_not_measured_is_not_shown(extra):
    assert own_costs(analysis_of([extra])) == ()
    assert "Cost of measuring" not in facts(analysis_of([extra]))


@pytest.mark.parametrize("kind", ["html", "md", "terminal", "json"])
def test_every_report_has_both(kind):
    text = load_reporter(kind).render(Book(analysis_of([{"recorder_cost": COST, "client_library_floor": FLOOR}])))
    words = " ".join(text.split())
    assert "recording an event 900 ns" in words
    assert "from a node to itself 400" in words


def test_a_fact_without_a_value_is_no_fact():
    assert Fact("Cost of measuring", "") not in Book(make_analysis()).overview.facts
