from __future__ import annotations

import polars as pl

from dds_trace.analyzer.pairing.one_way import KNOT_SCHEMA, SEGMENT_SCHEMA, pair_devices

S = 1_000_000_000
MS = 1_000_000


def fits_of(*segments):
    """Segments of `(boot, start and end in s, drift bound in ppb, step and its bound in ms)`, of alpha and beta."""
    rows = [
        {
            "ping_device": "alpha",
            "relay_device": "beta",
            "boot": boot,
            "segment": 0,
            "start_ns": begin * S,
            "end_ns": end * S,
            "drift_ppb": drift[0],
            "drift_bound_ppb": drift[1],
            "step_before_ns": step_ns,
            "step_bound_ns": bound_ns,
        }
        for boot, begin, end, drift, step_ns, bound_ns in segments
    ]
    return pl.DataFrame(rows, schema=SEGMENT_SCHEMA)


def knots_of(*knots):
    """Knots of `(run, instant in s, offset in ms)`, of alpha and beta."""
    rows = [(0, run_id, 1, "alpha", "beta", 1, at * S, offset * MS, 10_000, None, None) for run_id, at, offset in knots]
    return pl.DataFrame(rows, schema=KNOT_SCHEMA, orient="row")


def test_each_boot_of_a_ping_has_its_own_knots_by_time():
    still = (0.0, 1000.0)
    fits = fits_of((0, 0, 9, still, None, None), (4, 0, 9, still, None, None), (7, 0, 9, still, None, None))
    knots = knots_of((1, 8, 3), (2, 5, 1), (3, 2, 2))  # of the third run no boot is known
    pairs = list(pair_devices(fits, knots, {1: 0, 2: 4}))
    assert [pair.segments[0]["boot"] for pair in pairs] == [0, 4, 7]
    assert [pair.knots["run_id"].to_list() for pair in pairs] == [[3, 1], [2], []]
    assert {tuple(pair.knots.columns) for pair in pairs} == {tuple(KNOT_SCHEMA)}
    assert [pair.slews for pair in pairs] == [()] * 3


def test_steps_from_the_second_segment_on_are_slews():
    # 10 ms each five seconds; the first segment, which has no step, is as near as the others.
    unsure = (0.0, 500_000.0)
    starts = (5, 10, 15)
    fits = fits_of((0, 0, 5, unsure, None, None), *((0, at, at + 5, unsure, 10 * MS, MS // 10) for at in starts))
    (pair,) = pair_devices(fits, knots_of(*((1, at, 2 * at) for at in range(21))), {1: 0})
    (slew,) = pair.slews
    assert (slew.first, slew.after, slew.rate_ppm) == (1, 4, 2000.0)
    assert len(pair.segments) == 4


def test_a_step_counts_with_its_bound():
    # It barely shows beside a clock that ran fast: a slew; known ten times as well it is a jump.
    fast, still = (400_000.0, 50_000.0), (0.0, 1000.0)
    knots = knots_of(*((1, at, at) for at in range(100)))
    found = []
    for bound_ns in (11 * MS, MS):
        fits = fits_of((0, 0, 40, fast, None, None), (0, 40, 100, still, 12 * MS, bound_ns))
        (pair,) = pair_devices(fits, knots, {1: 0})
        found.append([(slew.first, slew.after) for slew in pair.slews])
    assert found == [[(1, 2)], []]
