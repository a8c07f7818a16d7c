import pytest
import trace_files
from campaigns import write_run

from dds_trace.analyzer.model.finding import Severity
from dds_trace.analyzer.pipeline import analyze
from dds_trace.tracefile.format.events import Stage

PERIOD = 100_000_000
COUNT = 50


def recorded(folder, *, load=None, host=()):
    messages = trace_files.sound(COUNT)
    described = trace_files.run(planned_messages=COUNT, published=COUNT)
    extra = {} if load is None else {"load": load}
    trace_files.write_trace(
        folder / "ping.mcap", trace_files.ping_session(), [described], trace_files.ping_events(messages)
    )
    trace_files.write_trace(
        folder / "relay.mcap", trace_files.relay_session(extra=extra), (), trace_files.relay_events(messages), host=host
    )
    return {finding.code: finding for finding in analyze(folder).findings}


@pytest.mark.parametrize(
    ("kind", "cpu_s", "code"),
    [
        ("cpu", 19.0, "loaded"),
        ("cpu", 0.5, "load_missing"),
        ("network", 1.0, "loaded"),
        ("network", 0.0, "load_missing"),
    ],
)
def test_a_load_is_reported_with_what_it_used(tmp_path, sentences, kind, cpu_s, code):
    load = {"kind": kind, "program": "stress-ng", "cpu_s": cpu_s, "elapsed_s": 10.0, "is_running": True}
    found = recorded(tmp_path, load=load)
    assert {"loaded", "load_missing"} & found.keys() == {code}
    assert found[code].groups == (0,)
    sentences(found[code].what)


LATE = {"kind": "cpu", "program": "stress-ng", "cpu_s": 0.2, "elapsed_s": 70.0, "waited_s": 69.0}
"""A load that began when that of the other side had ended."""


@pytest.mark.parametrize("load", [{}, {"program": "", "cpu_s": 0, "elapsed_s": 5}, {"cpu_s": "x"}, [], LATE])
def test_a_recording_that_made_no_load_has_no_finding(tmp_path, load):
    assert not {"loaded", "load_missing"} & recorded(tmp_path, load=load).keys()


def link_samples(late_us):
    rows = [(27.1, 35.8, 0.13), (0, 62.4, 0.81), (12, 68, 0.87)]
    names = ("rate_mbit_s", "delay_ms", "loss_percent")
    return [
        *({"monotonic_ns": 0, "link_now": dict(zip(names, row, strict=True))} for row in rows),
        {
            "link": {"name": "lte-drive", "file": "lte-drive.csv", "sha256": "3f"},
            "forwarder": {"from_ping": {"lateness_p50_us": late_us}, "from_relay": {"lateness_p50_us": None}},
        },
    ]


@pytest.mark.parametrize(("late_us", "is_late"), [(100, False), (357, False), (400, True)])
def test_a_replayed_link_is_reported_and_how_late_it_was(tmp_path, sentences, late_us, is_late):
    found = recorded(tmp_path, host=link_samples(late_us))
    assert ("link_late" in found) is is_late
    replayed = found["link_replayed"].what
    assert "lte-drive.csv" in replayed
    sentences(replayed, *([found["link_late"].what] if is_late else []))


def test_what_a_link_did_is_among_the_host_samples(tmp_path):
    recorded(tmp_path, host=link_samples(100))
    samples = analyze(tmp_path).details.host_samples
    assert samples["link_delay_ms"].drop_nulls().to_list() == [35.8, 62.4, 68]
    assert samples["link_rate_mbit_s"].drop_nulls().to_list() == [27.1, 0, 12]


TIMES = {"first_ns": 12_000_000, "typed_ns": 40_000, "accepted_p50_ns": 900_000, "feedback_p50_ns": 1_100_000}


def findings_of(folder, call):
    messages = trace_files.sound(COUNT)
    described = trace_files.run(planned_messages=COUNT, published=COUNT, extra={"call": call})
    trace_files.write_trace(
        folder / "ping.mcap", trace_files.ping_session(), [described], trace_files.ping_events(messages)
    )
    trace_files.write_trace(folder / "relay.mcap", trace_files.relay_session(), (), trace_files.relay_events(messages))
    return {finding.code: finding.what for finding in analyze(folder).findings}


def test_a_call_is_reported_with_its_first_one_and_its_conversion(tmp_path, sentences):
    found = findings_of(tmp_path, {"timeout_s": 10.0, "timed_out": 0, **TIMES})
    assert "calls_timed_out" not in found
    sentences(found["calls"])


def test_calls_beyond_their_timeout_are_counted(tmp_path, sentences):
    sentences(findings_of(tmp_path, {"timeout_s": 0.5, "timed_out": 3, **TIMES})["calls_timed_out"])


@pytest.mark.parametrize(
    "call", [{}, [], {"first_ns": "x", "timed_out": -1, "typed_ns": True}, "x", {"timed_out": None}]
)
def test_a_description_of_others_is_no_error(tmp_path, call):
    assert not {"calls", "calls_timed_out"} & findings_of(tmp_path, call).keys()


MS = 1_000_000


def messages(number):
    times = [number * 60_000 * MS + s * 100 * MS for s in range(30)]
    return [trace_files.Message(s, t0=t, t1=t, t3=t + MS, t4=t + MS, t2=t + 2 * MS + s) for s, t in enumerate(times)]


def record(folder, number, *, size=33_000, ping=None, relay=None):
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
    second, fields = trace_files.relay_session(session_id=900, relay_id=0xCAFE), {"run_id": 72, "relay_id": 0xCAFE}
    trace_files.write_trace(tmp_path / "2" / "second.mcap", second, (), trace_files.relay_events(messages(2), **fields))
    ping = trace_files.ping_session(session_id=52, host={"kernel": "6.1"})
    described = trace_files.run(run_id=72, planned_messages=30, published=30, extra={"session_id": f"{52:016x}"})
    replies = {Stage.T2: trace_files.ping_events(messages(2), **fields)[Stage.T2]}
    both = trace_files.merged_events([trace_files.ping_events(messages(2), run_id=72), replies])
    trace_files.write_trace(tmp_path / "2" / "ping.mcap", ping, [described], both)
    assert sorted(analyze(tmp_path).summary["setting"].to_list()) == ["", "relays=2"]
