import re
from pathlib import Path

import pytest
from rewritten_traces import rewrite_sessions, shift_relay_clock

from dds_trace.analyzer.pipeline import analyze
from dds_trace.reports.book.book import Book
from dds_trace.reports.figures.clocks import clock_figure, clock_info
from dds_trace.reports.figures.figure import Figure, LeftOut

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
    (pair,) = clock_info(Book(shifted)).pairs
    at_ns = shifted.details.clock_knots.sort("at_ns")["at_ns"].to_list()
    assert len(pair.offset_ns) == len(at_ns) == 5, "one for each run: they are short"
    for at, offset, bound in zip(at_ns, pair.offset_ns, pair.bound_ns, strict=True):
        assert abs(pair.first_offset_ns + offset - truth(at)) <= bound + 1000
    assert list(pair.elapsed_s) == [round((at - at_ns[0]) / 1e9, 3) for at in at_ns]
    assert max(pair.elapsed_s) > 10


def test_the_drift_is_in_the_title(shifted):
    (pair,) = clock_info(Book(shifted)).pairs
    drift, within = map(float, re.fullmatch(r"alpha → beta: drift \+([\d.]+) ± ([\d.]+) ppm", pair.title).groups())
    assert abs(drift - DRIFT_PPM) <= within < DRIFT_PPM
    assert isinstance(clock_figure(clock_info(Book(shifted))), Figure)


def test_latencies_are_those_of_the_true_clock(shifted):
    """A relay that drifts by 40 ppm is off by 40 ppm of the time that a message spends in it, and by no more."""
    expected = analyze(SAMPLES).summary
    for name in ("latency_p50_ns", "intermediate_p50_ns", "rtt_p50_ns"):
        for found, true in zip(shifted.summary[name], expected[name], strict=True):
            assert found == pytest.approx(true, rel=1e-4)


def test_traces_of_one_clock_have_no_clock_figure(tmp_path):
    rewrite_sessions(SAMPLES, tmp_path / "one", {"device": "alpha"})
    left_out = clock_figure(clock_info(Book(analyze(tmp_path / "one"))))
    assert isinstance(left_out, LeftOut)
    assert "one device" in left_out.reason
