"""The frames about the wire, from counts and records drawn by hand."""

import numpy as np
import pytest
from trace_files import (
    PING_SESSION_ID,
    RELAY_ID,
    RELAY_SESSION_ID,
    RUN_ID,
    Message,
    ping_events,
    ping_session,
    relay_events,
    relay_session,
    run,
    write_trace,
)
from wording import numbers

from dds_trace.analyzer.analysis import load_analysis
from dds_trace.analyzer.pipeline import analyze
from dds_trace.extensions.wire.format import MESSAGE_ROW, Direction, row_texts

MS = 1_000_000
COUNTS = {
    "duration_s": 30.0,
    "match_ns": 40 * MS,
    "requests": 2,
    "kernel_drops": 0,
    "tcp_again_bytes": 0,
    "ip": {"reassembly_failed": 1, "udp_receive_buffer_full": 0},
    "classes": [
        {"name": "data", "direction": "sent", "packets": 20, "bytes": 330_000},
        {"name": "data", "direction": "received", "packets": 20, "bytes": 330_000},
        {"name": "data_again", "direction": "sent", "packets": 10, "bytes": 220_000},
        {"name": "spdp", "direction": "sent", "packets": 1, "bytes": 110_000},
        {"name": "sedp", "direction": "received", "packets": 1, "bytes": 110_000},
    ],
}


def record(sequence, relay_id=0, direction=Direction.SENT, **fields):
    row = np.zeros(1, MESSAGE_ROW)
    row["run_id"], row["sequence"], row["relay_id"], row["direction"] = RUN_ID, sequence, relay_id, direction
    row["resent_after_ns"] = -1
    for name, value in fields.items():
        row[name] = value
    return row


def texts(*records):
    return list(row_texts(np.concatenate(records)))


def of_relay(**changes):
    return {
        "session_id": f"{RELAY_SESSION_ID:016x}",
        "run_ids": [f"{RUN_ID:016x}"],
        "counts": {"begin_ns": 5, "requests": 3, "ip": {"reassembly_failed": 4}, **changes},
    }


MESSAGES = [Message(s, t0=s, t1=s, t3=s + 10, t4=s + 10, t2=s + 20 * (s + 1)) for s in range(4)]


def folder_of(tmp_path, ping_wire=(), relay_wire=(), counts=COUNTS):
    described = run(planned_messages=4, published=4, extra={"session_id": f"{PING_SESSION_ID:016x}", "wire": counts})
    write_trace(tmp_path / "ping.mcap", ping_session(), [described], ping_events(MESSAGES), wire=ping_wire)
    write_trace(tmp_path / "relay.mcap", relay_session(), (), relay_events(MESSAGES), wire=relay_wire)
    return tmp_path


def test_bytes_of_a_group_by_class_and_per_payload_byte(tmp_path):
    details = analyze(folder_of(tmp_path)).details
    (row,) = details.wire.to_dicts()
    assert (row["group"], row["runs"], row["complete"], row["total_bytes"]) == (0, 1, True, 1_100_000)
    assert row["payload_bytes"] == 4 * 33_000 * 2
    assert row["bytes_per_payload_byte"] == pytest.approx(1_100_000 / 264_000)
    assert row["again_bytes_share"] == pytest.approx(0.2)
    assert row["discovery_share"] == pytest.approx(0.2)
    assert row["discovery_bytes_per_minute"] == pytest.approx(440_000)
    assert row["match_p50_ns"] == 40 * MS
    assert details.wire_classes.select("wire_class", "packets", "bytes", "share").rows() == [
        ("data", 40, 660_000, 0.6),
        ("data_again", 10, 220_000, 0.2),
        ("sedp", 1, 110_000, 0.1),
        ("spdp", 1, 110_000, 0.1),
    ]


def test_what_the_relays_capture_counted_is_added_once(tmp_path):
    wire = [of_relay(), of_relay(), of_relay(begin_ns=9, kernel_drops=7)]
    (row,) = analyze(folder_of(tmp_path, relay_wire=wire)).details.wire.to_dicts()
    assert row["requests"] == 2 + 3 + 3
    assert row["reassembly_failed"] == 1 + 4 + 4
    assert (row["kernel_drops"], row["complete"]) == (7, False)


def test_over_loopback_one_kernel_counts_for_both_and_the_ping_tells_it(tmp_path):
    local = [{"name": "data", "direction": "local", "packets": 40, "bytes": 660_000}]
    both = COUNTS | {"classes": local}
    wire = [of_relay(classes=local, kernel_drops=7, tcp_again_bytes=9)]
    (row,) = analyze(folder_of(tmp_path, relay_wire=wire, counts=both)).details.wire.to_dicts()
    assert (row["requests"], row["reassembly_failed"], row["tcp_again_bytes"]) == (2, 1, 0)
    assert (row["kernel_drops"], row["complete"]) == (7, False)


def test_how_tcp_connections_fared(tmp_path):
    def connection(retransmitted, rtt_us, window, sent=1):
        return {
            "retransmitted_segments": retransmitted,
            "rtt_us": rtt_us,
            "congestion_window": window,
            "bytes_sent": sent,
        }

    counts = {**COUNTS, "tcp": [connection(3, 200, 10), connection(1, 400, 20), connection(50, 9, 9, sent=0)]}
    (row,) = analyze(
        folder_of(tmp_path, relay_wire=[of_relay(tcp=[connection(2, 900, 99)])], counts=counts)
    ).details.wire.to_dicts()
    assert row["tcp_retransmitted_segments"] == 3 + 1 + 2
    assert (row["tcp_rtt_p50_ns"], row["tcp_congestion_window_p50"]) == (300_000, 15)


def test_without_tcp_nothing_is_said_of_its_connections(tmp_path):
    (row,) = analyze(folder_of(tmp_path)).details.wire.to_dicts()
    assert row["tcp_retransmitted_segments"] == 0
    assert (row["tcp_rtt_p50_ns"], row["tcp_congestion_window_p50"]) == (None, None)


def two_runs(tmp_path, run_ids, **of_second):
    """Two runs of a ping with a capture each, and counts of the relay's capture over `run_ids`."""
    described = [
        run(run_id=number, planned_messages=4, published=4, extra={"wire": COUNTS}, **changes)
        for number, changes in ((1, {}), (2, of_second))
    ]
    sent, relayed = {}, {}
    for each in described:
        for held, made in ((sent, ping_events), (relayed, relay_events)):
            for stage, events in made(MESSAGES, run_id=each.run_id, payload_bytes=each.payload_bytes).items():
                held[stage] = held.get(stage, []) + events
    counts = of_relay(kernel_drops=1) | {"run_ids": [f"{number:016x}" for number in run_ids]}
    write_trace(tmp_path / "ping.mcap", ping_session(), described, sent)
    write_trace(tmp_path / "relay.mcap", relay_session(), (), relayed, wire=[counts])
    return analyze(tmp_path)


def test_a_relays_counts_over_two_runs_of_a_group_are_added_once(tmp_path):
    (row,) = two_runs(tmp_path, (1, 2)).details.wire.to_dicts()
    assert (row["requests"], row["reassembly_failed"]) == (2 + 2 + 3, 1 + 1 + 4)
    assert (row["kernel_drops"], row["shared_counts"]) == (1, 0)


@pytest.mark.parametrize("run_ids", [(1, 2), (1, 99)], ids=["of two groups", "of an unknown run"])
def test_a_relays_counts_over_runs_of_two_groups_are_nobodys(tmp_path, run_ids):
    analysis = two_runs(tmp_path, run_ids, payload_bytes=500)
    first, second = analysis.details.wire.sort("payload_bytes", descending=True).to_dicts()
    # What the capture missed, it missed of each; requests and lost datagrams may be the other's.
    assert (first["requests"], first["reassembly_failed"], first["kernel_drops"]) == (2, 1, 1)
    assert [each["shared_counts"] for each in (first, second)] == [1, int(2 in run_ids)]
    shared = {f.groups for f in analysis.findings if f.code == "wire_counts_shared"}
    assert shared == ({(0,), (1,)} if 2 in run_ids else {(first["group"],)})


def test_repeats_of_both_ways_are_joined_to_the_messages(tmp_path):
    ping = texts(
        record(0),
        record(1, repeats=2, resent_after_ns=30 * MS, waited_heartbeats=3),
        record(2),
        record(3, repeats=1, resent_after_ns=10 * MS, waited_heartbeats=1),
        record(0, RELAY_ID, Direction.RECEIVED, repeats=9),  # a copy that arrives proves no second sending
    )
    relay = texts(record(2, RELAY_ID, repeats=1, resent_after_ns=50 * MS, waited_heartbeats=4))
    details = analyze(folder_of(tmp_path, ping, relay)).details
    assert details.wire_repeats.select(
        "group", "repeats", "messages", "returned", "rtt_p50_ns", "rtt_max_ns"
    ).rows() == [(0, 0, 1, 1, 20.0, 20.0), (0, 1, 2, 2, 70.0, 80.0), (0, 2, 1, 1, 40.0, 40.0)]
    (row,) = details.wire.to_dicts()
    assert (row["messages"], row["again_messages"]) == (4, 3)
    assert (row["resent_after_p50_ns"], row["waited_heartbeats_p50"]) == (30.0 * MS, 3.0)


def test_on_loopback_both_captures_have_a_message_and_it_counts_once(tmp_path):
    local = texts(*(record(s, direction=Direction.LOCAL, repeats=1) for s in range(4)))
    details = analyze(folder_of(tmp_path, local, local)).details
    assert details.wire_repeats.select("repeats", "messages").rows() == [(1, 4)]


def test_without_the_wire_the_frames_are_empty(tmp_path):
    details = analyze(folder_of(tmp_path, counts=None)).details
    assert (details.wire.height, details.wire_classes.height, details.wire_repeats.height) == (0, 0, 0)
    assert details.wire.width == 24


@pytest.mark.parametrize("counts", [7, [], {"classes": 3, "ip": [], "duration_s": "long"}, {"classes": [1]}])
def test_counts_that_are_no_counts_end_no_analysis(tmp_path, counts):
    wire = [{"counts": 1, "run_ids": [1]}, {"counts": {"requests": None}, "run_ids": [f"{RUN_ID:016x}"]}]
    assert analyze(folder_of(tmp_path, relay_wire=wire, counts=counts)).summary.height == 1


def test_a_saved_analysis_has_its_wire(tmp_path):
    analysis = analyze(folder_of(tmp_path))
    analysis.save(tmp_path / "saved")
    assert load_analysis(tmp_path / "saved").details.wire.equals(analysis.details.wire)


def finding(tmp_path, **changes):
    wire = texts(*(record(s, repeats=1, resent_after_ns=90 * MS, waited_heartbeats=2) for s in range(4)))
    found = analyze(folder_of(tmp_path, wire, counts={**COUNTS, **changes})).findings
    return {each.code: each for each in found if each.groups == (0,)}


def test_repeats_that_are_a_load_of_their_own_are_a_storm(tmp_path, sentences):
    classes = [*COUNTS["classes"], {"name": "data_frag_again", "packets": 1, "bytes": 100_000}]
    storm = finding(tmp_path, classes=classes)["retransmission_storm"]
    assert numbers(storm.what) == [26.7, 4, 4, 2]
    sentences(storm.what)
    assert "retransmission_storm" not in finding(tmp_path)  # a fifth is the limit


def many_again(tmp_path, again, count=40, waited=0, **changes):
    """Findings of a run of `count` messages, of which the first `again` were sent twice, with few bytes."""
    messages = [Message(s, t0=s, t1=s, t3=s + 10, t4=s + 10, t2=s + 20) for s in range(count)]
    counts = {**COUNTS, "classes": COUNTS["classes"][:2], "requests": 0, "ip": {}, **changes}
    described = run(
        planned_messages=count, published=count, extra={"session_id": f"{PING_SESSION_ID:016x}", "wire": counts}
    )
    again_of = {"resent_after_ns": MS, "waited_heartbeats": waited}
    wire = texts(*(record(s, repeats=int(s < again), **again_of) for s in range(count)))
    write_trace(tmp_path / "ping.mcap", ping_session(), [described], ping_events(messages), wire=wire)
    write_trace(tmp_path / "relay.mcap", relay_session(), (), relay_events(messages))
    return {each.code: each for each in analyze(tmp_path).findings}


def test_many_messages_sent_again_are_a_storm_though_their_bytes_are_few(tmp_path, sentences):
    storm = many_again(tmp_path, 6)["retransmission_storm"]
    assert numbers(storm.what) == [0, 6, 40]
    sentences(storm.what)
    assert storm.effect == pytest.approx(6 / 40)
    assert "retransmission_storm" not in many_again(tmp_path, 4)  # a tenth is the limit
    assert "retransmission_storm" not in many_again(tmp_path, 4, count=10)  # four are few


@pytest.mark.parametrize(
    ("kernel", "words"),
    [
        ({"udp_receive_buffer_full": 7, "reassembly_failed": 9}, "7 datagrams met"),
        ({"reassembly_failed": 9}, "9 datagrams that"),
        ({}, "look at the link"),
    ],
)
def test_what_to_set_against_a_storm_goes_by_what_the_kernels_counted(tmp_path, kernel, words, sentences):
    action = many_again(tmp_path, 20, ip=kernel)["retransmission_storm"].action
    assert words in action
    sentences(action)


def test_fragments_that_were_lost_while_a_run_was_captured(tmp_path, sentences):
    found = finding(tmp_path)["fragments_lost"]
    assert numbers(found.what) == [1]
    sentences(found.what)
    assert "Cyclone DDS MaxMessageSize" in found.action
    assert "fragments_lost" not in finding(tmp_path, ip={"reassembly_failed": 0})


def test_discovery_out_of_proportion(tmp_path, sentences):
    classes = [*COUNTS["classes"], {"name": "liveliness", "packets": 1, "bytes": 100_000}]
    found = finding(tmp_path, classes=classes)["discovery_traffic"]
    assert numbers(found.what) == [26.7, 640]
    sentences(found.what)
    assert "discovery_traffic" not in finding(tmp_path, classes=classes, duration_s=3000.0)


def test_discovery_is_held_against_payload_that_went_through_memory(tmp_path):
    of_shared_memory = [{"name": "spdp", "packets": 9, "bytes": 150_000}]
    through_memory = {"classes": of_shared_memory, "duration_s": 10.0}
    # 264 KB of payload left nothing on the wire: a share of 100 % of the bytes there, 57 % of the payload.
    assert "discovery_traffic" in finding(tmp_path, **through_memory)
    of_shared_memory[0]["bytes"] = 60_000  # 360 KB a minute, but less than the first minute of a run may take
    assert "discovery_traffic" not in finding(tmp_path, **through_memory)
    assert "discovery_traffic" not in {
        each.code
        for each in many_again(tmp_path, 0, classes=[{"name": "spdp", "packets": 9, "bytes": 600_000}]).values()
    }  # of 2.6 MB


def test_too_few_repeats_say_nothing_of_heartbeats(tmp_path):
    assert "heartbeat_bound_recovery" not in finding(tmp_path)


def test_repeats_that_waited_for_heartbeats(tmp_path, sentences):
    found = many_again(tmp_path, 30, waited=2)["heartbeat_bound_recovery"]
    assert numbers(found.what) == [30, 40, 2, 1]
    assert found.effect == pytest.approx(30 / 40)
    sentences(found.what)


def test_a_capture_with_drops_is_the_only_finding_about_the_wire(tmp_path, sentences):
    classes = [{"name": "data_again", "packets": 1, "bytes": 100}]
    found = finding(tmp_path, classes=classes, kernel_drops=1)
    assert numbers(found["wire_incomplete"].what) == [1, 1]
    sentences(found["wire_incomplete"].what)
    assert not {"retransmission_storm", "fragments_lost", "discovery_traffic"} & set(found)


def test_messages_that_left_on_two_interfaces_are_carried_twice(tmp_path):
    twice = [record(s, first_ns=1000 + s + interface) for s in range(3) for interface in (0, 7)]
    once = [record(3, first_ns=1003), *(record(s, RELAY_ID, first_ns=5000 + s) for s in range(4))]
    analysis = analyze(folder_of(tmp_path, texts(*twice, *once)))
    assert analysis.details.wire["carried_twice"].to_list() == [3]
    (finding,) = [finding for finding in analysis.findings if finding.code == "carried_twice"]
    assert numbers(finding.what)[:2] == [3, 4]


def test_a_copy_of_a_record_is_no_second_interface(tmp_path):
    copies = (record(s, first_ns=1000 + s) for s in (0, 1, 2, 3) for _ in range(2))
    analysis = analyze(folder_of(tmp_path, texts(*copies)))
    assert analysis.details.wire["carried_twice"].to_list() == [0]
    assert "carried_twice" not in {finding.code for finding in analysis.findings}
