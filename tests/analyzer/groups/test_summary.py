"""Groups, counts, rates and statistics of the summary, by hand."""

import math

import pytest
from trace_files import (
    RELAY_ID,
    Message,
    event,
    ping_events,
    ping_session,
    relay_events,
    relay_session,
    run,
    write_pair,
    write_trace,
)

from dds_trace.analyzer.model.metrics import METRICS
from dds_trace.analyzer.pipeline import analyze
from dds_trace.analyzer.statistics.percentiles import PERCENTILES
from dds_trace.tracefile.format.descriptions import Qos
from dds_trace.tracefile.format.events import Stage

MS = 1_000_000


def test_counts_and_statistics_of_one_group(tmp_path):
    messages = [
        Message(0, t0=0, t1=10, t3=100, t4=120, t2=210),  # warm-up
        Message(1, t0=1000, t1=1010, t3=1100, t4=1120, t2=1230),  # rtt 220, intermediate 20, latency 100, response 230
        Message(2, t0=2000, t1=2020, t3=2100, t4=2130, t2=2370),  # rtt 350, intermediate 30, latency 160, response 370
        Message(3, t0=3000, t1=3000),  # lost on the way out
        Message(4, t0=4000, t1=4000, t3=4100),  # lost in the relay
        Message(5, t0=5000, t1=5000, t3=5100, t4=5160),  # lost on the way back, intermediate 60
        Message(6, t0=6000, t1=6000, t3=6100, t4=6110, t2=6110),  # rtt 110, intermediate 10, latency 50, response 110
    ]
    write_pair(tmp_path, messages, runs=[run(warmup_messages=1, payload_bytes=1000)])
    (group,) = analyze(tmp_path).summary.to_dicts()
    counts = {
        "published": 6,
        "received": 3,
        "lost_outbound": 1,
        "lost_in_relay": 1,
        "lost_return": 1,
        "lost_unknown": 0,
        "duplicates": 0,
        "reordered": 0,
        "received_ratio": 0.5,
    }
    assert {name: group[name] for name in counts} == counts
    # Five intervals from T1 = 1010 to 6000.
    assert group["achieved_rate_hz"] == pytest.approx(5 / 4990e-9)
    # Five messages reached the relay between its first T3 = 1100 and its last T4 = 6110.
    assert group["transfer_rate_bytes_per_s"] == pytest.approx(5000 / 5010e-9)
    assert (group["rtt_mean_ns"], group["rtt_min_ns"], group["rtt_p50_ns"], group["rtt_max_ns"]) == (
        pytest.approx(680 / 3),
        110,
        220,
        350,
    )
    assert group["rtt_std_ns"] == pytest.approx(
        math.sqrt(((220 - 680 / 3) ** 2 + (350 - 680 / 3) ** 2 + (110 - 680 / 3) ** 2) / 2)
    )
    assert (group["intermediate_mean_ns"], group["intermediate_p50_ns"], group["intermediate_max_ns"]) == (30, 25, 60)
    assert (group["latency_mean_ns"], group["latency_p50_ns"]) == (pytest.approx(310 / 3), 100)
    assert (group["response_min_ns"], group["response_p50_ns"], group["response_max_ns"]) == (110, 230, 370)
    assert [group[f"{metric}_p90_ns"] for metric in METRICS] == [None] * len(METRICS)


def test_duplicates_and_reordering_are_counted(tmp_path):
    ping = ping_events([Message(s, t0=s, t1=s) for s in range(3)])
    ping[Stage.T2] = [event(s, t, relay_id=RELAY_ID) for s, t in ((1, 50), (0, 60), (0, 61), (2, 70), (0, 80))]
    write_trace(tmp_path / "ping.mcap", ping_session(), [run()], ping)
    analysis = analyze(tmp_path)
    assert analysis.load_roundtrips().select("duplicates", "reordered").rows() == [(2, True), (0, False), (0, False)]
    assert analysis.summary.select("duplicates", "reordered", "received").rows() == [(2, 1, 3)]
    assert {"duplicates", "reordering"} <= {finding.code for finding in analysis.findings}


def test_without_the_relays_trace_replies_make_the_transfer_rate(tmp_path):
    messages = [Message(s, t0=s * MS, t1=s * MS, t2=s * MS + 500) for s in range(11)]
    write_trace(tmp_path / "ping.mcap", ping_session(), [run(payload_bytes=100)], ping_events(messages))
    (group,) = analyze(tmp_path).summary.to_dicts()
    assert group["transfer_rate_bytes_per_s"] == pytest.approx(1100 / 10e-3)
    assert group["achieved_rate_hz"] == pytest.approx(1000)


def test_a_rate_takes_two_messages(tmp_path):
    write_pair(tmp_path, [Message(0, t0=0, t1=5, t3=7, t2=9)])
    (group,) = analyze(tmp_path).summary.to_dicts()
    assert (group["achieved_rate_hz"], group["transfer_rate_bytes_per_s"]) == (None, None)


def test_runs_of_equal_parameters_are_one_group_and_weigh_by_duration(tmp_path):
    # Run 1: 3 messages in 20 ms; run 2: 2 messages in 30 ms: 3 intervals in 50 ms, 60 Hz, not the mean of 100 and 33.
    runs = [run(run_id=1, payload_bytes=1000), run(run_id=2, payload_bytes=1000)]
    first = [
        Message(s, t0=10 * s * MS, t1=10 * s * MS, t3=s * 10 * MS, t4=s * 10 * MS, t2=10 * s * MS + 200)
        for s in range(3)
    ]
    second = [
        Message(
            s,
            t0=(100 + 30 * s) * MS,
            t1=(100 + 30 * s) * MS,
            t3=(50 + 30 * s) * MS,
            t4=(50 + 30 * s) * MS,
            t2=(100 + 30 * s) * MS + 400,
        )
        for s in range(2)
    ]
    ping, relay = {}, {}
    for run_id, messages in ((1, first), (2, second)):
        for held, events in (
            (ping, ping_events(messages, run_id=run_id)),
            (relay, relay_events(messages, run_id=run_id)),
        ):
            for stage, of_run in events.items():
                held.setdefault(stage, []).extend(of_run)
    write_trace(tmp_path / "ping.mcap", ping_session(), runs, ping)
    write_trace(tmp_path / "relay.mcap", relay_session(), (), relay)
    analysis = analyze(tmp_path)
    (group,) = analysis.summary.to_dicts()
    assert (group["published"], group["received"]) == (5, 5)
    assert group["achieved_rate_hz"] == pytest.approx(3 / 50e-3)
    assert group["transfer_rate_bytes_per_s"] == pytest.approx(5000 / 50e-3)
    assert group["rtt_p50_ns"] == 200
    assert group["rtt_mean_ns"] == pytest.approx((3 * 200 + 2 * 400) / 5)
    assert analysis.timeline.select("group", "run_id").rows() == [(0, 1)] * 3 + [(0, 2)] * 2
    assert analysis.timeline["elapsed_s"].to_list() == pytest.approx([0, 0.01, 0.02, 0, 0.03])


def test_groups_are_sorted_by_their_parameters_null_last(tmp_path):
    variants = [
        run(run_id=1, payload_bytes=500),
        run(run_id=2, payload_bytes=33),
        run(run_id=3, payload_bytes=33, rate_hz=2.0),
        run(run_id=4, payload_bytes=33, qos=Qos(reliability="best_effort")),
    ]
    events = {Stage.T1: [event(0, 10 * r.run_id, run_id=r.run_id, scheduled_ns=1) for r in variants]}
    # Run 1 has a relay with a trace, the others have none: null comes after a name.
    events[Stage.T2] = [event(0, 15, run_id=1, relay_id=RELAY_ID)]
    write_trace(tmp_path / "ping.mcap", ping_session(), variants, events)
    write_trace(tmp_path / "relay.mcap", relay_session(), (), {})
    summary = analyze(tmp_path).summary
    assert summary.select("relay_vendor", "payload_bytes", "rate_hz", "reliability").rows() == [
        ("fastdds", 500, 10.0, "reliable"),
        (None, 33, 2.0, "reliable"),
        (None, 33, 10.0, "best_effort"),
        (None, 33, 10.0, "reliable"),
    ]


def test_only_warmup_leaves_a_group_without_numbers(tmp_path):
    write_pair(tmp_path, [Message(0, t0=0, t1=5, t3=7, t4=8, t2=9)], runs=[run(warmup_messages=10)])
    analysis = analyze(tmp_path)
    assert analysis.load_roundtrips().height == analysis.timeline.height == analysis.distributions.height == 0
    (group,) = analysis.summary.to_dicts()
    assert (group["published"], group["received"], group["received_ratio"], group["rtt_p50_ns"]) == (0, 0, None, None)
    assert "nothing_counted" in {finding.code for finding in analysis.findings}


def test_messages_support_every_percentile(tmp_path):
    # rtt = 1001, 1003 ... ns; intermediate 1 ns: latency = 500, 501 ... ns.
    count = max(percentile.needs for percentile in PERCENTILES)
    messages = [
        Message(s, t0=s * MS, t1=s * MS, t3=s * MS, t4=s * MS + 1, t2=s * MS + 1001 + 2 * s) for s in range(count)
    ]
    write_pair(tmp_path, messages)
    analysis = analyze(tmp_path)
    (group,) = analysis.summary.to_dicts()
    for percentile in PERCENTILES:
        assert group[f"latency_{percentile.name}_ns"] == pytest.approx(500 + (count - 1) * percentile.quantile)
    assert "few_samples" not in {finding.code for finding in analysis.findings}
    latency = analysis.distributions.filter(metric="latency")
    assert latency["count"].sum() == count
    assert latency["value_ns"].to_list()[:1000] == [float(v) for v in range(500, 1500)]  # one bucket a nanosecond here
