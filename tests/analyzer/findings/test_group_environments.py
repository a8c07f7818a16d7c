from __future__ import annotations

import pytest
from campaigns import write_run
from trace_files import Message, merged_events, ping_events, ping_session, relay_events, relay_session, run, write_trace

from dds_trace.analyzer.model.finding import Severity
from dds_trace.analyzer.pipeline import analyze
from dds_trace.tracefile.format.events import Stage

MS = 1_000_000


def messages(number):
    times = [number * 60_000 * MS + s * 100 * MS for s in range(30)]
    return [Message(s, t0=t, t1=t, t3=t + MS, t4=t + MS, t2=t + 2 * MS + s) for s, t in enumerate(times)]


def record(folder, number, *, size=33_000, ping=None, relay=None):
    """One run; `ping` and `relay` are the fingerprints of the devices."""
    hosts = {"ping": {"host": ping or {"kernel": "6.1"}}, "relay": {"host": relay or {"kernel": "6.1"}}}
    write_run(folder / str(number), number, messages(number), payload_bytes=size, **hosts)


def environment_findings(folder):
    return [finding for finding in analyze(folder).findings if finding.code == "environment_differs"]


def test_unlike_environments_are_a_warning_on_their_group_and_on_no_other(tmp_path):
    record(tmp_path, 1, size=1000)
    record(tmp_path, 2, size=1000)
    record(tmp_path, 3, size=502_000, ping={"kernel": "6.1", "cpu_governor": "powersave"})
    record(tmp_path, 4, size=502_000, ping={"kernel": "6.6", "cpu_governor": "performance"})
    (finding,) = environment_findings(tmp_path)
    analysis = analyze(tmp_path)
    (group,) = finding.groups
    assert analysis.summary["payload_bytes"][group] == 502_000
    assert finding.severity is Severity.WARNING
    assert 'ping kernel: "6.1"; "6.6"' in finding.what
    assert 'ping cpu_governor: "performance"; "powersave"' in finding.what
    environments = dict(zip(analysis.summary["payload_bytes"], analysis.summary["environment"], strict=True))
    assert "+" in environments[502_000]  # two digests
    assert "+" not in environments[1000]


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ({"kernel": "6.1", "wifi": {"wlan0": {"signal": -40}}}, {"kernel": "6.1", "wifi": {}}),
        ({"kernel": "6.1", "middleware": {"tuned": "true"}}, {"kernel": "6.1"}),
        ({"kernel": "6.1", "mtu": {"lo": 65536}}, {"kernel": "6.1", "mtu": {"eth7": 65536}}),
    ],
)
def test_what_changes_by_the_minute_or_was_asked_for_is_no_other_environment(tmp_path, one, other):
    record(tmp_path, 1, ping=one)
    record(tmp_path, 2, ping=other)
    assert environment_findings(tmp_path) == []


def test_unlike_environments_of_relays_are_told_of_the_relay(tmp_path):
    record(tmp_path, 1)
    record(tmp_path, 2, relay={"kernel": "6.6"})
    (finding,) = environment_findings(tmp_path)
    assert 'relay kernel: "6.1"; "6.6"' in finding.what


def test_a_run_with_two_relays_is_another_group_than_one_with_one(tmp_path):
    record(tmp_path, 1)
    record(tmp_path, 2)
    second, fields = relay_session(session_id=900, relay_id=0xCAFE), {"run_id": 72, "relay_id": 0xCAFE}
    write_trace(tmp_path / "2" / "second.mcap", second, (), relay_events(messages(2), **fields))
    ping = ping_session(session_id=52, host={"kernel": "6.1"})
    described = run(run_id=72, planned_messages=30, published=30, extra={"session_id": f"{52:016x}"})
    replies = {Stage.T2: ping_events(messages(2), **fields)[Stage.T2]}
    both = merged_events([ping_events(messages(2), run_id=72), replies])
    write_trace(tmp_path / "2" / "ping.mcap", ping, [described], both)
    assert sorted(analyze(tmp_path).summary["setting"].to_list()) == ["", "relays=2"]
