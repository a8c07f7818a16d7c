"""What is no fault of a result is no finding about it, and what explains one is named."""

from dataclasses import replace

import pytest
from campaigns import write_run
from trace_files import Stage, evenly, ping_events, ping_session, relay_events, relay_session, run, write_trace
from wording import numbers

from dds_trace.analyzer.pipeline import analyze

MS = 1_000_000
PERIOD = 100 * MS
OF_PINGS = {"overlapping_pings", "unfinished_run", "loss", "outage", "late_sends"}


def codes(folder):
    return {finding.code: finding for finding in analyze(folder).findings}


@pytest.mark.parametrize("role", ["beacon", "ping"])
def test_beacons_end_one_after_the_other_and_go_on_together(tmp_path, role):
    for number, (sent, lost) in enumerate([(90, 0), (110, 20)]):
        messages = evenly([MS] * sent, start_ns=10**9 + number * PERIOD, period_ns=PERIOD)
        for n in range(3, sent, 20):
            messages[n] = replace(messages[n], t0=messages[n].t0 - 30 * MS)
        messages[sent - lost :] = [one.lost() for one in messages[sent - lost :]]
        labels = {"role": role} if role == "beacon" else {}
        write_run(
            tmp_path / str(number),
            number,
            messages,
            planned_messages=14_400,
            published=sent,
            payload_bytes=91 + number,
            labels=labels,
        )
    assert OF_PINGS & set(codes(tmp_path)) == (set() if role == "beacon" else OF_PINGS)


@pytest.mark.parametrize(
    ("requested", "relays", "traces", "is_found", "kept"),
    [
        *((None, 2, 2, True, 2), ("3", 2, 2, False, 2), ("2", 3, 3, True, 3), (None, 1, 1, False, 1)),
        *((None, 2, 1, True, 1), ("2", 3, 2, True, 2), ("2", 3, 1, False, 3), (None, 2, 0, True, 2)),
    ],
)
def test_a_relay_that_nobody_requested_is_a_finding(tmp_path, requested, relays, traces, is_found, kept):
    messages = evenly([MS] * 40, start_ns=10**9)
    ping = {Stage.T1: ping_events(messages)[Stage.T1], Stage.T2: []}
    for relay_id in range(1, relays + 1):
        answered = messages if traces in (0, relays) else messages[:5] if relay_id > traces else messages[10:]
        ping[Stage.T2] += ping_events(answered, relay_id=relay_id)[Stage.T2]
    for relay_id in range(1, traces + 1):
        session = relay_session(session_id=relay_id, relay_id=relay_id)
        write_trace(tmp_path / f"relay{relay_id}.mcap", session, (), relay_events(messages, relay_id=relay_id))
    settings = {"settings": {"relays": requested}} if requested else {}
    write_trace(tmp_path / "ping.mcap", ping_session(extra=settings), [run(planned_messages=40, published=40)], ping)
    analysis = analyze(tmp_path, details=False)
    assert analysis.summary["published"].sum() == 40 * kept
    found = {finding.code: finding for finding in analysis.findings}
    assert ("unrequested_relay" in found) is is_found
    if is_found:
        assert numbers(found["unrequested_relay"].what)[0] == relays
        assert f"relays={relays}" in found["unrequested_relay"].action


@pytest.mark.parametrize("drops", [(0, 0), (0, 64), (64, 64), (64, 0)])
def test_a_jump_with_size_names_what_only_the_larger_size_has(tmp_path, drops):
    number = 0
    for _ in range(3):
        for payload_bytes, way_ns, dropped in ((33_000, MS, drops[0]), (145_000, 40 * MS, drops[1])):
            messages = evenly([way_ns + n % 7 for n in range(60)], start_ns=number * 10**11, period_ns=PERIOD)
            sockets = [[{"protocol": "udp", "inode": 1, "dropped": count}] for count in (0, dropped)]
            applied = {name: {"sockets": one} for name, one in zip(("begin", "end"), sockets, strict=True)}
            write_run(
                tmp_path / str(number),
                number,
                messages,
                payload_bytes=payload_bytes,
                ping={"extra": {"applied": applied}},
            )
            number += 1
    found = codes(tmp_path)
    assert ("udp_buffer_overflow" in found) is any(drops)
    assert ("receive buffer" in found["latency_jumps_with_size"].what) is (drops == (0, 64))
    assert ("no cause" in found["latency_jumps_with_size"].what) is (drops != (0, 64))
