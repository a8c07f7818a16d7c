from dataclasses import fields, replace

import polars as pl
import pytest
from campaigns import write_run
from polars.testing import assert_frame_equal
from roundtrip_frames import rows_by_group
from trace_files import (
    RELAY_ID,
    WALL_ANCHOR_NS,
    Message,
    event,
    ping_session,
    relay_session,
    run,
    write_pair,
    write_runs,
    write_trace,
)

import dds_trace.analyzer.pairing.rows
from dds_trace.analyzer.clocks.boots import ping_wall_offsets
from dds_trace.analyzer.groups.freshness import OUTAGE_SCHEMA
from dds_trace.analyzer.pipeline import analyze
from dds_trace.analyzer.statistics.percentiles import PERCENTILES
from dds_trace.analyzer.verdicts.answers import find_answers
from dds_trace.analyzer.verdicts.job import make_job
from dds_trace.extensions.gates.compare import CompareOptions
from dds_trace.extensions.gates.costs import bridge_cost
from dds_trace.tracefile.format.events import Stage

MS = 1_000_000
PERIOD = 100 * MS
AHEAD = 5_000 * MS  # the relay's clock


def drawn(count=200, ahead=AHEAD, first=0):
    """Out in 2 ms, 1 ms in the relay, back in 3 ms; sent 50 ns late."""
    times = [(s, (first + s) * PERIOD) for s in range(count)]
    return [
        Message(s, t0=t, t1=t + 50, t3=t + 50 + 2 * MS + ahead, t4=t + 50 + 3 * MS + ahead, t2=t + 50 + 6 * MS)
        for s, t in times
    ]


def test_one_way_times_are_in_the_rows_and_hold_the_truth_within_their_bound(tmp_path):
    write_pair(tmp_path, drawn())
    analysis = analyze(tmp_path)
    rows = analysis.load_roundtrips()
    assert rows.columns[-6:-2] == ["outbound_ns", "return_ns", "clock_bound_ns", "setting"]
    assert (rows["outbound_ns"] + rows["return_ns"] == 5 * MS).all()
    # Nothing tells 2 ms out and 3 ms back from a clock that is off by half a millisecond.
    assert ((rows["outbound_ns"] - 2 * MS).abs() <= rows["clock_bound_ns"]).all()
    assert rows["clock_bound_ns"].min() >= 2.5 * MS
    assert rows["clock_bound_ns"].max() < 2.6 * MS
    assert analysis.details.one_way["metric"].to_list() == ["outbound", "return"]
    assert analysis.details.one_way["messages"].to_list() == [200, 200]


def test_intervals_repeat_the_summary_and_are_null_where_the_sample_is_too_small(tmp_path):
    write_pair(tmp_path, drawn())
    analysis = analyze(tmp_path)
    latency = analysis.details.intervals.filter(metric="latency")
    assert latency["percentile"].to_list() == [percentile.name for percentile in PERCENTILES]
    rows = {row["percentile"]: row for row in latency.to_dicts()}
    assert {row["messages"] for row in rows.values()} == {200}
    for name in ("p50", "p90"):
        assert (rows[name]["estimate_ns"], rows[name]["high_ns"]) == (2.5 * MS, 2.5 * MS)
        assert rows[name]["method"] == "order_statistics"
    for name, estimate_ns in (("p95", 2.5 * MS), ("p99", 2.5 * MS), ("p99_9", None)):
        assert (rows[name]["estimate_ns"], rows[name]["high_ns"], rows[name]["method"]) == (estimate_ns, None, None)
    for name in ("p50", "p90", "p95", "p99"):
        assert analysis.summary[f"latency_{name}_ns"][0] == 2.5 * MS


def test_breakdown_without_stamps_of_the_middleware_has_four_parts(tmp_path):
    write_pair(tmp_path, drawn())
    details = analyze(tmp_path).details
    parts = dict(details.breakdown.select("part", "mean_ns").rows())
    assert list(parts) == ["waiting_ns", "outbound_ns", "relay_ns", "return_ns"]
    assert (parts["waiting_ns"], parts["relay_ns"]) == (50, MS)
    assert sum(parts.values()) == pytest.approx(6 * MS + 50)
    assert details.responses.select("messages", "late_ratio", "waiting_max_ns").rows() == [(200, 0.0, 50)]


def test_a_deadline_is_judged_per_run_and_relay(tmp_path):
    messages = drawn()
    lost = [Message(m.sequence, t0=m.t0, t1=m.t1) if 20 <= m.sequence < 25 else m for m in messages]
    write_pair(tmp_path, lost)
    details = analyze(tmp_path, deadline_ns=3 * MS, deadline_metric="latency").details
    assert details.deadline_ns == 3 * MS
    (row,) = details.freshness.iter_rows(named=True)
    assert (row["group"], row["judged"], row["missed"], row["longest_missed"]) == (0, 200, 5, 5)
    assert row["longest_missed_ns"] == 5 * PERIOD
    (outage,) = details.outages.iter_rows(named=True)
    assert (outage["group"], outage["first_sequence"], outage["messages"]) == (0, 20, 5)
    assert outage["duration_ns"] == 5 * PERIOD + 50 + 6 * MS


@pytest.mark.parametrize(("lost", "outages"), [((20, 21), 0), ((20, 22, 24), 0), ((20, 21, 22), 1)])
def test_an_outage_is_three_lost_messages_in_a_row(tmp_path, lost, outages):
    messages = [Message(m.sequence, t0=m.t0, t1=m.t1) if m.sequence in lost else m for m in drawn()]
    write_pair(tmp_path, messages)
    details = analyze(tmp_path).details
    assert details.freshness["outages"].to_list() == [outages]
    assert details.outages["messages"].to_list() == [len(lost)] * outages
    assert details.outages.columns == list(OUTAGE_SCHEMA)


def with_clocks(*clocks):
    """Runs 1, 2 ... one after the other, each with the relay's clock so far ahead."""
    return [
        (run(run_id=number + 1, planned_messages=200, published=200), drawn(ahead=ahead, first=300 * number))
        for number, ahead in enumerate(clocks)
    ]


def test_the_clock_of_two_devices_is_fitted_over_all_their_runs(tmp_path):
    write_runs(tmp_path, with_clocks(AHEAD, AHEAD))
    details = analyze(tmp_path).details
    (fit,) = details.clock_fits.iter_rows(named=True)
    assert (fit["ping_device"], fit["relay_device"], fit["same_clock"]) == ("alpha", "beta", False)
    assert abs(fit["offset_ns"] - AHEAD) <= fit["bound_ns"]
    assert abs(fit["drift_ppb"]) <= fit["drift_bound_ppb"]
    assert fit["step_before_ns"] is None


def test_a_step_between_two_runs_is_found(tmp_path):
    write_runs(tmp_path, with_clocks(AHEAD, AHEAD + 1000 * MS))
    details = analyze(tmp_path).details
    before, after = details.clock_fits.iter_rows(named=True)
    assert (before["segment"], after["segment"]) == (0, 1)
    assert abs(after["step_before_ns"] - 1000 * MS) <= after["step_bound_ns"] < 30 * MS


def test_on_one_machine_one_way_times_are_exact(tmp_path):
    write_pair(tmp_path, drawn(ahead=0), relay=relay_session(device="alpha"))
    analysis = analyze(tmp_path)
    assert analysis.details.clock_fits["same_clock"].to_list() == [True]
    assert analysis.load_roundtrips()["outbound_ns"].unique().to_list() == [2 * MS]
    assert analysis.load_roundtrips()["clock_bound_ns"].unique().to_list() == [0]


def test_reception_stamps_are_those_of_the_events_that_were_paired(tmp_path):
    # us  T0=0  T1=5  source 7  R3=45  T3=60  T4=70  source 73  R2=112  T2=120; wall clock stamps but for T0 to T4.
    def stamped(monotonic_us, source_us, received_us, relay_id=RELAY_ID):
        wall = [WALL_ANCHOR_NS + us * 1000 for us in (source_us, received_us)]
        return event(0, monotonic_us * 1000, relay_id=relay_id, source_ns=wall[0], received_ns=wall[1])

    taken = stamped(60, 7, 45)
    events = {Stage.T3: [taken, stamped(65, 9, 50), taken], Stage.T4: [event(0, 70_000, relay_id=RELAY_ID)]}
    write_trace(tmp_path / "relay.mcap", relay_session(device="alpha"), (), events)
    described = [run(planned_messages=1, published=1)]
    others = stamped(119, 74, 111, relay_id=RELAY_ID + 1)
    events = {Stage.T1: [event(0, 5_000)], Stage.T2: [stamped(120, 73, 112), others, stamped(130, 80, 125)]}
    write_trace(tmp_path / "ping.mcap", ping_session(), described, events)
    parts = analyze(tmp_path).details.breakdown.filter(group=0)
    assert parts.select("part", "mean_ns").rows() == [
        ("waiting_ns", 5_000),
        ("outbound_transport_ns", 40_000),
        ("relay_delivery_ns", 15_000),
        ("relay_ns", 10_000),
        ("return_transport_ns", 42_000),
        ("ping_delivery_ns", 8_000),
    ]


def test_a_group_has_the_same_details_alone_and_beside_another(tmp_path):
    write_pair(tmp_path / "alone", drawn())
    write_pair(tmp_path / "both" / "one", drawn())
    write_trace(
        tmp_path / "both" / "other.mcap",
        ping_session(session_id=7, vendor="zenoh"),
        [run(run_id=9, planned_messages=1, published=1, extra={})],
        {Stage.T1: [event(0, 1, run_id=9)]},
    )
    alone, both = analyze(tmp_path / "alone").details, analyze(tmp_path / "both").details
    for name in ("intervals", "one_way", "breakdown", "responses", "freshness", "outages", "clock_knots"):
        assert_frame_equal(getattr(alone, name), getattr(both, name).filter(pl.col("group") == 0))


def test_host_samples_are_rows_over_time(tmp_path):
    samples = [
        {
            "monotonic_ns": second * 10**9,
            "host": {"cpu_percent": 40.0, "cpu_percent_each": [10.0, 70.0], "temperature_c": None},
            "udp": {"RcvbufErrors": 100 + second},
            "wifi": {"wlan0": {"signal_dbm": -61}},
            "processes": {"self": {"cpu_percent": 12.5}, "bridge": {"cpu_percent": 5.0}},
        }
        for second in range(3)
    ]
    write_pair(tmp_path, drawn(), host=[*samples, {"host": [], "wifi": {"w": 3}, "processes": None}])
    details = analyze(tmp_path).details
    columns = ["monotonic_ns", "cpu_percent", "cpu_busiest_percent", "wifi_signal_dbm", "udp_receive_errors"]
    assert details.host_samples.select(columns).rows() == [
        (0, 40.0, 70.0, -61.0, 0.0),
        (10**9, 40.0, 70.0, -61.0, 1.0),
        (2 * 10**9, 40.0, 70.0, -61.0, 2.0),
        (3 * 10**9, None, None, None, None),
    ]
    assert details.host_samples["bridge_cpu_percent"].to_list() == [5.0, 5.0, 5.0, None]


def write_campaign(folder):
    """Two sizes, each within a domain and through two bridges; the first size also by another middleware."""
    number = 0
    for size in (33_000, 502_000):
        ways = [("none", None, "fastdds"), ("builtin", 9, "fastdds"), ("domain_bridge", 9, "fastdds")]
        for bridge, domain, vendor in [*ways, ("none", None, "zenoh")][: 4 if size == 33_000 else 3]:
            number += 1
            messages = [replace(m, t2=m.t2 + number * MS + 1000 * m.sequence) for m in drawn()]
            write_run(
                folder / f"{number}",
                number,
                messages,
                ping={"vendor": vendor},
                relay={"domain_id": domain or 5},
                payload_bytes=size,
                bridge=bridge,
                relay_domain_id=domain,
            )


@pytest.mark.parametrize("held_rows", [10**6, 300])
def test_comparisons_are_those_of_all_rows_though_a_kind_of_message_is_read_at_a_time(tmp_path, monkeypatch, held_rows):
    write_campaign(tmp_path)
    monkeypatch.setattr(dds_trace.analyzer.pairing.rows, "MOST_ROWS_IN_MEMORY", held_rows)
    analysis = analyze(tmp_path)
    details, rows = analysis.details, analysis.load_roundtrips()
    wall_offsets_ns = ping_wall_offsets(analysis.sessions, analysis.runs)
    assert details.answers == find_answers(rows_by_group(rows), wall_offsets_ns=wall_offsets_ns)
    assert [(a.domain_mode, a.payload_bytes, len(a.contenders)) for a in details.answers] == [
        ("different", 33_000, 2),
        ("different", 502_000, 2),
        ("same", 33_000, 2),
        ("same", 502_000, 1),
    ]
    options = CompareOptions(metrics=("latency",), statistics=tuple(percentile.name for percentile in PERCENTILES))
    assert_frame_equal(details.bridge_costs, bridge_cost(rows, options), check_exact=True)
    costs = details.bridge_costs.filter(statistic="p50").select("bridge", "payload_bytes", "difference_ns")
    assert costs.rows() == [
        ("builtin", 33_000, 0.5 * MS),
        ("builtin", 502_000, 0.5 * MS),
        ("domain_bridge", 33_000, MS),
        ("domain_bridge", 502_000, MS),
    ]


def test_details_that_are_not_requested_are_empty_frames_and_null_columns(tmp_path):
    write_pair(tmp_path, drawn())
    analysis = analyze(tmp_path, details=False)
    assert not analysis.details.requested
    requested = analyze(tmp_path).details
    for field in fields(requested):
        value = getattr(requested, field.name)
        if isinstance(value, pl.DataFrame):
            empty = getattr(analysis.details, field.name)
            assert empty.is_empty(), field.name
            assert empty.schema == value.schema, field.name
    assert analysis.details.answers == ()
    assert analysis.load_roundtrips()["outbound_ns"].null_count() == 200


def test_a_job_gets_its_recommendation(tmp_path):
    write_pair(tmp_path, drawn())
    job = make_job(data="binary", size="33KB", rate="10", deadline="50ms", reliability="0.9")
    details = analyze(tmp_path, job=job).details
    assert details.recommendation is not None
    assert [c.fit.value for c in details.recommendation.candidates] == ["likely"]  # one run


def test_every_frame_has_its_columns_where_nothing_came_back(tmp_path):
    write_trace(tmp_path / "ping.mcap", ping_session(), [run()], {Stage.T1: [event(0, 1)]})
    write_pair(tmp_path / "full", drawn(), runs=[run(run_id=5)])
    one, other = analyze(tmp_path / "ping.mcap").details, analyze(tmp_path / "full").details
    for field in fields(one):
        value = getattr(one, field.name)
        if isinstance(value, pl.DataFrame):
            assert value.schema == getattr(other, field.name).schema, field.name
