from dataclasses import replace

import pytest
import trace_files

from dds_trace.analyzer.pipeline import analyze

US, S = 1_000, 1_000_000_000
MESSAGES, RELAYS = 200, 3
BOOT = {"boot_id": "a-boot"}
WIRE = {
    "classes": [
        {"name": "data", "direction": "sent", "bytes": 600_000, "packets": 600},
        {"name": "data", "direction": "received", "bytes": 900_000, "packets": 600},
    ]
}
DISCOVERY = {"matched_ns": [S // 10, S // 5, 3 * S], "missed": [1, 2, 30], "bytes": 4321}


def message(sequence, relay):
    sent = sequence * S // 100
    out = 100 * US + 50 * US * (relay - 1)
    if relay == RELAYS and sequence % 10 == 0:
        out = 60 * US
    t3 = sent + out
    return trace_files.Message(sequence, t0=sent, t1=sent, t3=t3, t4=t3 + 10 * US, t2=t3 + 110 * US)


def campaign(folder, change=lambda one, _relay: one, relays=RELAYS, run_id=trace_files.RUN_ID, first=1, **fields):
    sent = [message(sequence, 1) for sequence in range(MESSAGES)]
    described = trace_files.run(
        run_id=run_id, planned_messages=MESSAGES, published=MESSAGES, relay_domain_id=10, extra=fields
    )
    ping = trace_files.ping_session(session_id=run_id + 1, host={"cpu_cores": 2}, extra=BOOT)
    events = [trace_files.ping_events([one.lost() for one in sent], run_id=run_id)]
    for relay in range(first, first + relays):
        got = [change(message(sequence, relay - first + 1), relay) for sequence in range(MESSAGES)]
        events.append(trace_files.ping_events([replace(one, t1=None) for one in got], run_id=run_id, relay_id=relay))
        session = trace_files.relay_session(session_id=run_id + 100 + relay, relay_id=relay, extra=BOOT)
        trace_files.write_trace(
            folder / f"relay-{relay}.mcap", session, (), trace_files.relay_events(got, run_id=run_id, relay_id=relay)
        )
    trace_files.write_trace(folder / "ping.mcap", ping, [described], trace_files.merged_events(events))
    return analyze(folder)


def test_the_known_first_and_last_receiver_come_back(tmp_path):
    analysis = campaign(tmp_path, wire=WIRE, discovery=DISCOVERY)
    (row,) = analysis.details.fan_out.iter_rows(named=True)
    assert (row["receivers"], row["senders"], row["messages"], row["complete"]) == (3, 1, MESSAGES, MESSAGES)
    assert row["first_receiver_p50_ns"] == 100 * US
    assert row["last_receiver_p50_ns"] == 200 * US
    assert (row["spread_p50_ns"], row["spread_p99_ns"]) == (100 * US, 100 * US)
    assert (row["first_reply_p50_ns"], row["last_reply_p50_ns"]) == (210 * US, 310 * US)
    assert row["position_step_ns"] == pytest.approx(50 * US)
    assert row["bound_ns"] == 0
    assert row["wire_bytes_per_receiver"] == 600_000 / MESSAGES / RELAYS
    assert (row["matched_p50_ns"], row["missed_p50"], row["discovery_bytes_p50"]) == (3 * S, 33, 4321)
    assert (row["recorders"], row["processors"]) == (4, 2)
    shares = analysis.details.fan_out_positions.select("relay_id", "first_share", "last_share").rows()
    assert shares == [(1, 0.9, 0.0), (2, 0.0, 0.1), (3, 0.1, 0.9)]
    codes = {finding.code for finding in analysis.findings}
    assert {"shared_cores", "slow_discovery"} <= codes


def test_a_message_that_one_relay_missed_is_in_no_spread(tmp_path):
    analysis = campaign(tmp_path, lambda one, relay: one.lost() if relay == 2 and one.sequence < 50 else one)
    (row,) = analysis.details.fan_out.iter_rows(named=True)
    assert (row["messages"], row["complete"]) == (MESSAGES, MESSAGES - 50)
    received = analysis.details.fan_out_positions["received"].to_list()
    assert received == [MESSAGES, MESSAGES - 50, MESSAGES]
    assert row["matched_p50_ns"] is None


def test_relays_of_repeats_are_no_positions(tmp_path):
    campaign(tmp_path / "three")
    campaign(tmp_path / "one", relays=1, run_id=trace_files.RUN_ID + 1000)
    campaign(tmp_path / "again", relays=1, run_id=trace_files.RUN_ID + 2000, first=7)
    details = analyze(tmp_path).details
    assert details.fan_out.sort("receivers")["receivers"].to_list() == [1, 3]
    assert details.fan_out.filter(receivers=1)["position_step_ns"].to_list() == [None]
    assert len(details.fan_out_positions) == RELAYS


def test_one_relay_has_no_fan_out(tmp_path):
    details = campaign(tmp_path, relays=1).details
    assert details.fan_out.is_empty()
    assert details.fan_out_positions.is_empty()


@pytest.mark.parametrize("described", [{"matched_ns": "soon", "missed": [-1, None]}, [], "x", {"matched_ns": [1e300]}])
def test_what_a_file_says_of_discovery_is_checked(tmp_path, described):
    (row,) = campaign(tmp_path, discovery=described).details.fan_out.iter_rows(named=True)
    assert row["matched_p50_ns"] is None
