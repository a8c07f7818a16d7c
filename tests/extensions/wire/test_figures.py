"""Figures about the wire, from frames drawn by hand."""

import re
from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest
from analyses import MS, Measured, make_analysis
from rewritten_traces import rewrite_sessions, shift_relay_clock

from dds_trace.analyzer.pipeline import analyze
from dds_trace.extensions.wire.analyze import WIRE_CLASS_SCHEMA, WIRE_REPEAT_SCHEMA, WIRE_SCHEMA
from dds_trace.extensions.wire.figures import SENT_AGAIN, WIRE_COST, Repeats, WirePart, sent_again_plan, wire_cost_plan
from dds_trace.reports.book.book import Book
from dds_trace.reports.figures.clocks import CLOCK, clock_plan
from dds_trace.reports.figures.own_times import FIRST_MESSAGE, first_message_plan


def frame(schema, *rows):
    return pl.DataFrame([dict.fromkeys(schema) | row for row in rows], schema)


def drawn(wire=(), classes=(), repeats=()):
    analysis = make_analysis(Measured([MS, 2 * MS]), Measured([MS, 3 * MS], rate_hz=20.0))
    details = replace(
        analysis.details,
        wire=frame(WIRE_SCHEMA, *wire),
        wire_classes=frame(WIRE_CLASS_SCHEMA, *classes),
        wire_repeats=frame(WIRE_REPEAT_SCHEMA, *repeats),
    )
    return Book(replace(analysis, details=details))


def test_a_bar_is_the_bytes_per_payload_byte_by_what_they_were_spent_on():
    classes = [
        {"group": 1, "wire_class": name, "share": share}
        for name, share in (("data", 0.4), ("data_frag", 0.2), ("data_frag_again", 0.25), ("acknack", 0.05), ("spdp", 0.1))
    ]  # fmt: skip
    plan = wire_cost_plan(drawn([{"group": 1, "complete": False, "bytes_per_payload_byte": 2.0}], classes))
    assert (plan["groups"], plan["incomplete"]) == ([1], [1])
    assert [(part.name, pytest.approx(part.ratio)) for part in plan["parts"][1]] == [
        ("data", 1.2),
        ("again", 0.5),
        ("control", 0.1),
        ("discovery", 0.2),
    ]
    assert plan["parts"][1][1] == WirePart("again", 0.5, 0.25)
    assert list(plan["names"]) == ["data", "again", "control", "discovery"]


def test_an_unknown_class_is_other():
    classes = [{"group": 0, "wire_class": "of a later version", "share": 1.0}]
    plan = wire_cost_plan(drawn([{"group": 0, "complete": True, "bytes_per_payload_byte": 1.5}], classes))
    assert plan["parts"] == {0: (WirePart("other", 1.5, 1.0),)}


def test_a_group_without_repeats_is_not_drawn():
    rows = [
        {"group": 0, "repeats": 0, "messages": 2, "rtt_p50_ns": 5.0, "latency_p50_ns": 2.0, "latency_max_ns": 3.0},
        {"group": 1, "repeats": 0, "messages": 1, "rtt_p50_ns": 5.0, "latency_p50_ns": 2.4, "latency_max_ns": 2.6},
        {"group": 1, "repeats": 1, "messages": 1},
    ]  # fmt: skip
    groups = {1: (Repeats(0, 1, 2, 3), Repeats(1, 1, None, None))}
    assert sent_again_plan(drawn(repeats=rows)) == {"groups": groups, "metric": "latency"}


def test_without_a_relays_trace_the_round_trip_is_drawn():
    rows = [{"group": 0, "repeats": 1, "messages": 2, "rtt_p50_ns": 5.0, "rtt_max_ns": 6.0}]
    assert sent_again_plan(drawn(repeats=rows)) == {"groups": {0: (Repeats(1, 2, 5, 6),)}, "metric": "rtt"}


def test_time_to_the_first_message_is_a_mark_for_each_group_that_has_it():
    rows = [{"group": 0, "match_p50_ns": 40e6}, {"group": 1}]
    plan = first_message_plan(drawn(rows))
    assert (plan["groups"], plan["values_ns"]) == ([0], {0: 40_000_000})


def test_without_the_wire_each_figure_says_so():
    for row in (WIRE_COST, SENT_AGAIN, FIRST_MESSAGE):
        assert row.plan(drawn()) is None
        assert "--wire" in row.nothing


SAMPLES = Path(__file__).parents[3] / "sample_traces" / "same_domain"
AHEAD_NS = 3_250_000_000
DRIFT_PPM = 40


@pytest.fixture(scope="module")
def truth():
    """Relay's clock minus ping's at an instant of the ping's: recorded on one machine, both were on one clock."""
    first_ns = analyze(SAMPLES).details.clock_knots["at_ns"].min()
    return lambda at_ns: AHEAD_NS + (at_ns - first_ns) * DRIFT_PPM // 1_000_000


@pytest.fixture(scope="module")
def shifted(tmp_path_factory, truth):
    folder = tmp_path_factory.mktemp("shifted") / "same_domain"
    shift_relay_clock(SAMPLES, folder, lambda at_ns: at_ns + truth(at_ns))
    return analyze(folder)


def test_every_mark_is_within_its_bound_of_the_clock_that_was_set(shifted, truth):
    (pair,) = clock_plan(Book(shifted))["pairs"]
    at_ns = shifted.details.clock_knots.sort("at_ns")["at_ns"].to_list()
    assert len(pair.offset_ns) == len(at_ns) == 5, "one for each run: they are short"
    for at, offset, bound in zip(at_ns, pair.offset_ns, pair.bound_ns, strict=True):
        assert abs(pair.first_offset_ns + offset - truth(at)) <= bound + 1000
    assert list(pair.elapsed_s) == [round((at - at_ns[0]) / 1e9, 3) for at in at_ns]
    assert max(pair.elapsed_s) > 10


def test_the_drift_is_in_the_title(shifted):
    (pair,) = clock_plan(Book(shifted))["pairs"]
    drift, within = map(float, re.fullmatch(r"alpha → beta: drift \+([\d.]+) ± ([\d.]+) ppm", pair.title).groups())
    assert abs(drift - DRIFT_PPM) <= within < DRIFT_PPM


def test_latencies_are_those_of_the_true_clock(shifted):
    """A relay that drifts by 40 ppm is off by 40 ppm of the time that a message spends in it, and by no more."""
    expected = analyze(SAMPLES).summary
    for name in ("latency_p50_ns", "intermediate_p50_ns", "rtt_p50_ns"):
        for found, true in zip(shifted.summary[name], expected[name], strict=True):
            assert found == pytest.approx(true, rel=1e-4)


def test_traces_of_one_clock_have_no_clock_figure(tmp_path):
    rewrite_sessions(SAMPLES, tmp_path / "one", {"device": "alpha"})
    assert CLOCK.plan(Book(analyze(tmp_path / "one"))) is None
    assert "one device" in CLOCK.nothing
