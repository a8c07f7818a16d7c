"""One-way times of rows, and the clocks of devices over several runs, on stamps drawn by hand."""

from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest
from roundtrip_frames import roundtrips, with_one_way

from dds_trace.analyzer.pairing.one_way import KNOT_SCHEMA, _are_sane, _usable, fit_devices, segment_table
from dds_trace.analyzer.pairing.pair import MISSING
from dds_trace.analyzer.pairing.utc import is_synchronized, utc_columns, utc_text
from dds_trace.tracefile.format.descriptions import Session

MESSAGE = {"publish_ns": 0, "relay_in_ns": 1100, "relay_out_ns": 1200, "receive_ns": 300}
ONE_WAY = ["outbound_ns", "return_ns", "clock_bound_ns"]


def test_one_way_times_take_four_stamps_that_agree():
    frame = roundtrips(
        [
            MESSAGE,
            {"publish_ns": 1000, "relay_in_ns": 2100},  # lost on the way back
            {"publish_ns": 2000, "relay_in_ns": 3100, "relay_out_ns": 3900, "receive_ns": 2500},  # 800 in 500 ns
        ]
    )
    aligned = with_one_way(frame)
    assert aligned.select(ONE_WAY).rows() == [(100, 100, 101), (None, None, None), (None, None, None)]
    assert aligned.drop(ONE_WAY).equals(frame.drop(ONE_WAY))


def test_a_way_may_take_no_time():
    # The clocks are apart by 1000 or 1001 ns, by the even one of the two.
    aligned = with_one_way(roundtrips([{"publish_ns": 7, "relay_in_ns": 1007, "relay_out_ns": 1007, "receive_ns": 8}]))
    assert aligned.select("outbound_ns", "return_ns").rows() == [(0, 1)]


def test_one_way_columns_are_int64_without_a_relay():
    aligned = with_one_way(roundtrips([{"publish_ns": 0}], relay_device=None))
    assert aligned["outbound_ns"].to_list() == [None]
    assert aligned["clock_bound_ns"].dtype == pl.Int64


def test_device_pairs_and_boots_are_fitted_apart():
    def knot(run_id, relay_device, offset_ns):
        return (0, run_id, 1, "ping-pi", relay_device, 1, 150, offset_ns, 101, None, None)

    knots = pl.DataFrame(
        [knot(1, "relay-pi", 1000), knot(2, "relay-pi", 5_001_000), knot(3, "third", 1000)],
        schema=KNOT_SCHEMA,
        orient="row",
    )
    fits = fit_devices(knots, {1: 100, 2: 900})
    assert [(f.relay_device, f.boot, f.segments[0].offset_ns) for f in fits] == [
        ("relay-pi", 100, 1000),
        ("relay-pi", 900, 5_001_000),
        ("third", 0, 1000),
    ]
    assert segment_table(fits).select("segment", "at_ns", "bound_ns").rows() == [(0, 150, 102)] * 3
    assert segment_table(fit_devices(knots.clear(), {})).is_empty()


def test_a_relay_that_was_rebooted_between_two_runs_has_no_step():
    def knot(run_id, at_ns, offset_ns, relay_boot):
        return (0, run_id, 1, "ping-pi", "relay-pi", 1, at_ns, offset_ns, 101, relay_boot, False)

    knots = [(1, 150, 1000, "aa"), (2, 10**9, -(10**12), "bb"), (3, 2 * 10**9, -(10**12), "bb")]
    rebooted = pl.DataFrame([knot(*each) for each in knots], schema=KNOT_SCHEMA, orient="row")
    fits = fit_devices(rebooted, {})
    assert [(f.relay_boot, f.segments[0].messages, f.steps) for f in fits] == [("aa", 1, ()), ("bb", 2, ())]
    assert [f.boot for f in fits] == [0, 0]  # no run is known to name its session
    assert segment_table(fits)["relay_boot"].to_list() == ["aa", "bb"]
    (unknown,) = fit_devices(rebooted.with_columns(relay_boot=pl.lit(None, pl.String)), {})
    assert len(unknown.steps) == 1  # without the boot id it cannot be told from a step


def test_a_segment_is_told_with_the_step_that_began_it():
    def knot(at_s, offset_ns):
        return (0, 1, 1, "ping-pi", "relay-pi", 1, at_s * 10**9, offset_ns, 101, None, None)

    knots = [knot(0, 0), knot(1, 10**9), knot(2, 3 * 10**9)]
    table = segment_table(fit_devices(pl.DataFrame(knots, schema=KNOT_SCHEMA, orient="row"), {}))
    assert table.select("segment", "at_ns", "offset_ns", "step_before_ns").rows() == [
        (0, 0, 0, None),
        (1, 10**9, 10**9, 10**9),
        (2, 2 * 10**9, 3 * 10**9, 2 * 10**9),
    ]
    assert table["step_bound_ns"].to_list() == [None, 1_100_203, 1_100_203]


@pytest.mark.parametrize(
    ("ppm", "step_ns", "is_bounded"),
    [(0, 0, True), (90, 0, True), (600, 0, False), (1000, 0, False), (1500, 0, False), (0, 50_000_000, False)],
)
def test_a_clock_that_was_slewed_or_stepped_has_no_bounds(ppm, step_ns, is_bounded):
    """A relay that slews from 20 to 40 s of a minute, and is set then; 90 ppm from the start are a crystal's."""
    since = np.arange(0, 60 * 10**9, 10**8)
    slewed = np.clip(since - 20 * 10**9, 0, 20 * 10**9) if ppm > 100 else since
    offset = slewed * ppm // 10**6 + np.where(since >= 40 * 10**9, step_ns, 0)
    frame = roundtrips(
        {
            "publish_ns": t,
            "relay_in_ns": t + ahead + 10_000,
            "relay_out_ns": t + ahead + 10_000,
            "receive_ns": t + 20_000,
        }
        for t, ahead in zip(since.tolist(), offset.tolist(), strict=True)
    )
    aligned = with_one_way(frame)
    assert aligned["clock_bound_ns"].is_null().all() is not is_bounded
    assert aligned["clock_bound_ns"].null_count() in (0, aligned.height)
    assert aligned["outbound_ns"].null_count() == aligned["return_ns"].null_count() == 0


def test_stamps_of_a_sane_clock_are_usable_up_to_its_edges():
    sane_ns = 1 << 60

    def usable(*messages):
        names = ("publish_ns", "relay_in_ns", "relay_out_ns", "receive_ns")
        stamps = dict(zip(names, np.array(messages, np.int64).T, strict=True))
        damaged = [name for name in names if not _are_sane(stamps[name])]
        return _usable(stamps, slice(None), damaged).tolist()

    assert usable((0, 1100, 1200, 300), (0, 500, 800, 300), (0, 500, 801, 300)) == [True, True, False]
    low, high = -sane_ns + 2, sane_ns - 1
    assert usable((low, 0, 0, low), (high, 0, 0, high), (0, low, low, 0), (0, high, high, 0)) == [True] * 4
    for edge in (low, high):
        assert usable((edge, 0, 0, edge), (MISSING, 0, 0, 0), (0, 0, 0, MISSING)) == [True, False, False]
    for place in range(4):
        for beyond in (low - 1, high + 1, MISSING):
            damaged = [5, 5, 5, 5]
            damaged[place] = beyond
            if beyond > 0 and place in (1, 3):  # the times themselves would agree
                assert usable(damaged, (0, 0, 0, 0)) == [False, True]
            else:
                assert not usable(damaged, (0, 0, 0, 0))[0]


SANE_NS = 1 << 61


def session(wall_ns, monotonic_ns, **extra):
    return Session(1, "ping", "a", "ros2", "fastdds", None, 5, None, "wired", wall_ns, monotonic_ns, extra=extra)


def utc_of(*of_exchanges):
    exchanges = [SimpleNamespace(ping=ping, relay=relay) for ping, relay, _ in of_exchanges]
    instants_ns = np.concatenate([np.array(each, np.int64) for *_, each in of_exchanges])
    bounds = np.cumsum([0, *(len(each) for *_, each in of_exchanges)])
    columns = utc_columns(exchanges, bounds, pl.DataFrame({"publish_ns": instants_ns, "relay_in_ns": instants_ns}))
    return [column.to_physical().to_list() for column in columns]


def test_an_instant_is_as_far_from_the_anchor_on_both_clocks():
    instants_ns = [99, 100, 250, SANE_NS - 1, SANE_NS, MISSING]
    publish, relay_in = utc_of(
        (session(1100, 100), session(5000, 0), instants_ns), (None, session(7000, 3000), [250, 3000])
    )
    # Before its session's start, beyond 73 years and without an event there is none.
    assert publish == [None, 1100, 1250, SANE_NS - 1 + 1000, None, None, None, None]
    assert relay_in == [5099, 5100, 5250, SANE_NS - 1 + 5000, None, None, None, 7000]


@pytest.mark.parametrize("way", [1, -1])
def test_a_wall_clock_that_is_off_by_73_years_tells_nothing(way):
    assert utc_of((session(way * SANE_NS, 0), None, [0, 5]))[0] == [None, None]
    assert utc_of((session(way * (SANE_NS - 1), 0), None, [0, 5]))[0] == [way * (SANE_NS - 1), way * (SANE_NS - 1) + 5]


def test_the_kernel_says_whether_a_clock_is_synchronized():
    assert is_synchronized(session(0, 0, clock={"begin": {"status": 0x2001}})) is True
    assert is_synchronized(session(0, 0, clock={"begin": {"status": 0x41}})) is False
    for clock in (None, 5, {"begin": 5}, {"begin": {"status": "64"}}):
        assert is_synchronized(session(0, 0, clock=clock)) is None


def test_an_instant_is_written_as_far_as_an_int64_reaches():
    assert utc_text(0) == "1970-01-01T00:00:00.000000000Z"
    assert utc_text(2**63 - 1) == utc_text(2**63 + 5) == "2262-04-11T23:47:16.854775807Z"
    assert utc_text(-(2**63) + 1) == utc_text(-(2**63) - 5) == "1677-09-21T00:12:43.145224193Z"
