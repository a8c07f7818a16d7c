import json
import re

import pytest
from trace_files import (
    PING_SESSION_ID,
    RELAY_ID,
    RELAY_SESSION_ID,
    RUN_ID,
    WALL_ANCHOR_NS,
    Message,
    event,
    merged_events,
    ping_events,
    ping_session,
    relay_events,
    relay_session,
    run,
    write_pair,
    write_trace,
)
from wording import numbers

from dds_trace.analyzer.model.columns import ROUNDTRIP_COLUMNS, SUMMARY_COLUMNS
from dds_trace.analyzer.model.parameters import PARAMETER_COLUMNS
from dds_trace.analyzer.pipeline import analyze
from dds_trace.base.errors import MissingEventsError
from dds_trace.tracefile.format.descriptions import Qos, Run
from dds_trace.tracefile.format.events import Stage

TWO = [Message(0, t0=0, t1=10, t3=500, t4=520, t2=140), Message(1, t0=1000, t1=1010)]
NO_RELAY_COLUMNS = ("relay_vendor", "relay_backend", "relay_device", "relay_in_ns", "relay_out_ns", "latency_ns")


def rows(analysis):
    return analysis.load_roundtrips().to_dicts()


def values(analysis, *columns):
    return analysis.load_roundtrips().select(columns).rows()


def codes(analysis):
    return {finding.code for finding in analysis.findings}


def test_columns_and_types_are_those_of_the_format(tmp_path):
    write_pair(tmp_path, TWO)
    analysis = analyze(tmp_path)
    assert dict(analysis.load_roundtrips().schema) == {column.name: column.dtype for column in ROUNDTRIP_COLUMNS}
    assert dict(analysis.summary.schema) == {column.name: column.dtype for column in SUMMARY_COLUMNS}


def test_runs_of_two_versions_are_two_results_and_of_one_version_one(tmp_path):
    def write(name, number, versions):
        sides = [
            make(
                session_id=session_id + number,
                vendor="fastdds",
                relay_id=relay_id,
                host={"versions": dict(pair)},
                extra={"session_id": f"{session_id + number:016x}"},
            )
            for make, session_id, relay_id, pair in (
                (ping_session, 10, None, versions[:1]),
                (relay_session, 30, RELAY_ID, versions[-1:]),
            )
        ]
        of_run = run(run_id=number, extra={"session_id": f"{10 + number:016x}"})
        folder = tmp_path / name
        folder.mkdir(exist_ok=True)
        for side, events in zip(
            sides, (ping_events(TWO, run_id=number), relay_events(TWO, run_id=number)), strict=True
        ):
            runs = [of_run] if side.role == "ping" else []
            write_trace(folder / f"{number}.{side.role}.mcap", side, runs, events)

    def settings(name):
        return [re.sub(r"^flows=\d,?", "", text) for text in analyze(tmp_path / name).summary["setting"]]

    jazzy, kilted = [("fastrtps", "2.14.5")], [("fastdds", "3.2.3")]
    for number, versions in enumerate((jazzy, kilted, jazzy, kilted + jazzy), start=1):
        write("both", number, versions)
    assert settings("both") == ["relay.version=2.14.5,version=3.2.3", "version=2.14.5", "version=3.2.3"]
    write("one", 1, jazzy)
    write("one", 2, [("fastdds", "2.14.5")])  # as newer recorders name it
    assert settings("one") == [""]
    for number, version in enumerate(("7.1.6", "7.1.7"), start=1):
        write("package", number, [("rclpy", version)])
    assert settings("package") == ["version=rclpy 7.1.6", "version=rclpy 7.1.7"]


def test_parameters_come_from_run_and_sessions(tmp_path):
    write_pair(
        tmp_path,
        TWO,
        ping=ping_session(connectivity="wired"),
        relay=relay_session(vendor="zenoh", backend="socket", device="gamma", domain_id=12),
        runs=[
            run(
                bridge="builtin",
                relay_domain_id=12,
                data_type="imu",
                payload_bytes=296,
                rate_hz=2.5,
                serialization="typed",
                qos=Qos("best_effort", "transient_local", "keep_all", 3),
            )
        ],
    )
    first = rows(analyze(tmp_path))[0]
    assert {column.name: first[column.name] for column in PARAMETER_COLUMNS} == {
        "vendor": "fastdds",
        "backend": "ros2",
        "rmw": "rmw_fastrtps_cpp",
        "bridge": "builtin",
        "relay_vendor": "zenoh",
        "relay_backend": "socket",
        "ping_domain_id": 5,
        "relay_domain_id": 12,
        "domain_mode": "different",
        "data_type": "imu",
        "payload_bytes": 296,
        "rate_hz": 2.5,
        "reliability": "best_effort",
        "durability": "transient_local",
        "history": "keep_all",
        "depth": 3,
        "serialization": "typed",
        "ping_device": "alpha",
        "relay_device": "gamma",
        "connectivity": "wired",
        "setting": "",
    }
    assert (first["run_id"], first["relay_id"], first["sequence"]) == (RUN_ID, RELAY_ID, 0)


@pytest.mark.parametrize(
    ("relay_domain", "told", "bridge", "expected"),
    [
        (5, 5, "none", (5, "same")),
        (10, 10, "builtin", (10, "different")),
        (5, 10, "none", (5, "same")),  # the relay knows better than the ping was told
        (None, 10, "builtin", (10, "different")),  # without the relay's trace
        (None, None, "none", (5, "same")),  # nothing between them
        (None, None, "zenoh", (None, "different")),  # a bridge, but to where?
    ],
)
def test_the_relays_own_domain_decides_the_domain_mode(tmp_path, relay_domain, told, bridge, expected):
    ping, relay = write_pair(
        tmp_path, TWO, relay=relay_session(domain_id=relay_domain or 0), runs=[run(relay_domain_id=told, bridge=bridge)]
    )
    if relay_domain is None:
        relay.unlink()
    analysis = analyze(tmp_path)
    first = rows(analysis)[0]
    assert (first["relay_domain_id"], first["domain_mode"]) == expected
    assert first["ping_domain_id"] == 5
    assert ("unlike_domains" in codes(analysis)) == (relay_domain == 5 and told == 10)
    assert ping.exists()


def test_two_relays_give_two_rows_a_message_each_with_its_own_outcome(tmp_path):
    near, far = 0x11, 0x22
    t1 = [event(s, 1000 * s + 10, scheduled_ns=1000 * s) for s in range(2)]
    # The near relay answers both; the far one receives the first only and its answer to that is lost.
    t2 = [event(0, 110, relay_id=near), event(1, 1130, relay_id=near)]
    write_trace(tmp_path / "ping.mcap", ping_session(), [run()], {Stage.T1: t1, Stage.T2: t2})
    for relay_id, stamps in ((near, [(0, 50, 60), (1, 80, 100)]), (far, [(0, 7, 9)])):
        write_trace(
            tmp_path / f"relay_{relay_id}.mcap",
            relay_session(session_id=relay_id, relay_id=relay_id, device=f"pi{relay_id}", monotonic_anchor_ns=10**6),
            (),
            {
                Stage.T3: [event(s, t3, relay_id=relay_id) for s, t3, _ in stamps],
                Stage.T4: [event(s, t4, relay_id=relay_id) for s, _, t4 in stamps],
            },
        )
    analysis = analyze(tmp_path)
    assert values(analysis, "relay_id", "sequence", "outcome", "latency_ns", "relay_device") == [
        (near, 0, "completed", 45, "pi17"),  # (100 - 10) // 2
        (near, 1, "completed", 50, "pi17"),  # (120 - 20) // 2
        (far, 0, "lost_return", None, "pi34"),
        (far, 1, "lost_outbound", None, "pi34"),
    ]
    assert analysis.summary.select("relay_device", "published", "received", "setting").rows() == [
        ("pi17", 2, 2, "relays=2"),
        ("pi34", 2, 0, "relays=2"),
    ]


def test_a_relay_named_by_replies_only_has_rows_without_latency(tmp_path):
    _, relay = write_pair(tmp_path, TWO, runs=[run(relay_domain_id=None)])
    relay.unlink()
    analysis = analyze(tmp_path)
    assert values(analysis, "relay_id", "outcome", "rtt_ns", "response_ns") == [
        (RELAY_ID, "completed", 130, 140),
        (RELAY_ID, "lost_unknown", None, None),
    ]
    assert values(analysis, *NO_RELAY_COLUMNS, "intermediate_ns")[0] == (None,) * 7
    assert "missing_relay_trace" in codes(analysis)
    assert analysis.summary["latency_p50_ns"].to_list() == [None]


def test_a_relay_whose_trace_lacks_the_run_is_found_by_its_id(tmp_path):
    """Its device is known, what became of the messages is not."""
    write_trace(tmp_path / "ping.mcap", ping_session(), [run()], ping_events(TWO))
    write_trace(tmp_path / "relay.mcap", relay_session(), (), {})
    analysis = analyze(tmp_path)
    assert values(analysis, "outcome", "relay_device") == [("completed", "beta"), ("lost_unknown", "beta")]


def test_a_run_without_a_relay_has_rows_of_losses(tmp_path):
    unanswered = [Message(0, t0=1, t1=10), Message(1, t0=11, t1=20)]
    write_pair(tmp_path, unanswered, relay=relay_session(relay_id=0))
    analysis = analyze(tmp_path)
    assert values(analysis, "relay_id", "sequence", "outcome") == [(0, 0, "lost_unknown"), (0, 1, "lost_unknown")]
    assert values(analysis, *NO_RELAY_COLUMNS, "setting")[0] == (*[None] * 6, "")
    assert {"no_relay", "nothing_received"} <= codes(analysis)


def test_a_relay_that_only_warmup_saw_took_part(tmp_path):
    messages = [Message(0, t0=0, t1=10, t3=500, t4=520, t2=140), Message(1, t0=1000, t1=1010)]
    write_pair(tmp_path, messages, runs=[run(warmup_messages=1)])
    (row,) = rows(analyze(tmp_path))
    assert (row["relay_id"], row["sequence"], row["outcome"]) == (RELAY_ID, 1, "lost_outbound")


def test_two_pings_at_one_relay_keep_their_messages(tmp_path):
    first, second = TWO, [Message(0, t0=5000, t1=5001, t3=600, t4=601, t2=5102)]
    write_trace(tmp_path / "a.mcap", ping_session(), [run()], ping_events(first))
    other = ping_session(session_id=7, device="delta")
    write_trace(tmp_path / "b.mcap", other, [run(run_id=7, extra={})], ping_events(second, run_id=7))
    relayed = merged_events([relay_events(first), relay_events(second, run_id=7)])
    write_trace(tmp_path / "relay.mcap", relay_session(), (), relayed)
    analysis = analyze(tmp_path)
    assert values(analysis, "run_id", "ping_device", "latency_ns") == [
        (RUN_ID, "alpha", 55),
        (RUN_ID, "alpha", None),
        (7, "delta", 50),
    ]
    assert [described.run_id for described in analysis.runs] == [RUN_ID, 7]


def test_several_runs_in_one_file_are_rows_by_group_and_runs_by_start(tmp_path):
    late, early = run(run_id=1, payload_bytes=10), run(run_id=2, payload_bytes=20)
    events = ping_events([Message(0, t0=9000, t1=9000, t2=9100)], run_id=1)
    for stage, of_early in ping_events([Message(0, t0=100, t1=100, t2=300)], run_id=2).items():
        events[stage] = of_early + events[stage]
    write_trace(tmp_path / "ping.mcap", ping_session(), [late, early], events)
    analysis = analyze(tmp_path)
    assert values(analysis, "run_id", "payload_bytes", "rtt_ns") == [(1, 10, 100), (2, 20, 200)]
    assert [described.run_id for described in analysis.runs] == [2, 1]


@pytest.mark.parametrize("began_ns", [1490, 2000])
def test_a_restarted_relay_is_another_relay(tmp_path, began_ns):
    """A new process draws a new relay_id: each has the outcomes of the messages that it could see, by when it began."""
    expected = FIRST_AND_SECOND if began_ns < 1500 else UNKNOWN_BEGINNING
    messages = [
        Message(0, t0=0, t1=10, t3=500, t4=520, t2=140),
        Message(1, t0=1000, t1=1010, t3=1509, t4=1511, t2=1112),
    ]
    ping = ping_events(messages)
    ping[Stage.T2] = [event(0, 140, relay_id=1), event(1, 1112, relay_id=2)]
    write_trace(tmp_path / "ping.mcap", ping_session(), [run()], ping)
    for relay_id, message in zip((1, 2), messages, strict=True):
        session = relay_session(
            session_id=relay_id, relay_id=relay_id, monotonic_anchor_ns=0 if relay_id == 1 else began_ns
        )
        write_trace(tmp_path / f"relay{relay_id}.mcap", session, (), relay_events([message], relay_id=relay_id))
    assert values(analyze(tmp_path), "relay_id", "sequence", "outcome", "latency_ns") == expected


FIRST_AND_SECOND = [(1, 0, "completed", 55), (2, 1, "completed", 50)]
UNKNOWN_BEGINNING = [
    FIRST_AND_SECOND[0],
    (1, 1, "lost_outbound", None),
    (2, 0, "lost_outbound", None),
    FIRST_AND_SECOND[1],
]


@pytest.mark.parametrize("goes_on", [False, True])
def test_a_late_relay_counts_from_the_first_message_that_it_got_and_replaces_only_one_that_is_silent(tmp_path, goes_on):
    messages = [Message(n, t0=1000 * n, t1=1000 * n + 10, t3=1000 * n + 509, t4=1000 * n + 511) for n in range(3)]
    write_trace(tmp_path / "ping.mcap", ping_session(), [run()], ping_events(messages))
    for relay_id, began_ns, relayed in ((1, 0, messages[:: 2 if goes_on else 3]), (2, 1490, messages[2:])):
        session = relay_session(session_id=relay_id, relay_id=relay_id, monotonic_anchor_ns=began_ns)
        write_trace(tmp_path / f"relay{relay_id}.mcap", session, (), relay_events(relayed, relay_id=relay_id))
    rows = values(analyze(tmp_path), "relay_id", "sequence", "outcome")
    assert rows == [
        (1, 0, "lost_return"),
        (1, 1, "lost_outbound"),
        *[(1, 2, "lost_return")] * goes_on,
        (2, 2, "lost_return"),
    ]


def test_a_relay_restarted_under_its_old_id_gets_the_last_session_before_its_events(tmp_path):
    """Both sessions' events are paired, and a finding says that one of them stands for both."""
    messages = [
        Message(0, t0=0, t1=10, t3=500, t4=520, t2=140),
        Message(1, t0=1000, t1=1010, t3=9000, t4=9002, t2=1112),
    ]
    write_trace(tmp_path / "ping.mcap", ping_session(), [run()], ping_events(messages))
    for part, message in enumerate(messages):
        session = relay_session(session_id=50 + part, wall_anchor_ns=10**18 + part)
        write_trace(tmp_path / f"relay{part}.mcap", session, (), relay_events([message]))
    analysis = analyze(tmp_path)
    assert [r["latency_ns"] for r in rows(analysis)] == [55, 50]
    assert "doubtful_session" in codes(analysis)


@pytest.mark.parametrize(
    ("t3", "t4", "device"), [(900, 1100, "before"), (1000, 1100, "after"), (None, 1100, "after"), (None, 900, "before")]
)
def test_the_first_event_of_a_relay_tells_which_of_its_sessions_it_was(tmp_path, t3, t4, device):
    """The second session starts at 1000 on the relay's clock; where no T3 is kept, the T4 tells."""
    messages = [Message(0, t0=0, t1=10, t3=t3, t4=t4, t2=500)]
    sessions = [
        relay_session(session_id=50, device="before"),
        relay_session(session_id=51, device="after", monotonic_anchor_ns=1000, wall_anchor_ns=WALL_ANCHOR_NS + 1000),
    ]
    write_trace(tmp_path / "ping.mcap", ping_session(), [run()], ping_events(messages))
    write_trace(tmp_path / "relay.mcap", sessions, (), relay_events(messages))
    assert [row["relay_device"] for row in rows(analyze(tmp_path))] == [device]


def test_merged_pings_are_told_apart_by_what_the_run_names(tmp_path):
    sessions = [ping_session(), ping_session(session_id=9, device="omega")]
    runs = [run(), run(run_id=9, extra={"session_id": f"{9:016x}"})]
    events = ping_events(TWO)
    events[Stage.T1] += [event(0, 9000, run_id=9, scheduled_ns=9000)]
    write_trace(tmp_path / "all.mcap", sessions, runs, events)
    analysis = analyze(tmp_path)
    assert values(analysis, "run_id", "ping_device") == [(RUN_ID, "alpha")] * 2 + [(9, "omega")]
    assert "doubtful_session" not in codes(analysis)


def test_merged_pings_without_a_name_are_told_apart_by_their_start(tmp_path):
    sessions = [
        ping_session(),
        ping_session(session_id=9, device="omega", wall_anchor_ns=WALL_ANCHOR_NS + 8000, monotonic_anchor_ns=8000),
    ]
    events = ping_events(TWO)
    events[Stage.T1] += [event(0, 9000, run_id=9, scheduled_ns=9000)]
    write_trace(tmp_path / "all.mcap", sessions, [run(extra={}), run(run_id=9, extra={})], events)
    analysis = analyze(tmp_path)
    assert values(analysis, "run_id", "ping_device") == [(RUN_ID, "alpha")] * 2 + [(9, "omega")]
    assert "doubtful_session" in codes(analysis)


def test_relay_events_without_their_ping_have_no_row_and_a_finding(tmp_path):
    write_pair(tmp_path, TWO)
    stranger = relay_session(session_id=3, relay_id=3)
    write_trace(tmp_path / "other.mcap", stranger, (), relay_events(TWO, run_id=99, relay_id=3))
    analysis = analyze(tmp_path)
    assert set(analysis.load_roundtrips()["run_id"]) == {RUN_ID}
    (finding,) = [f for f in analysis.findings if f.code == "orphan_relay_events"]
    assert "2 events" in finding.what
    assert "0000000000000063" in finding.what
    assert finding.where == "other.mcap, relay 00000003"


def test_relay_events_without_their_ping_that_two_files_hold_are_told_as_copies(tmp_path, sentences):
    write_pair(tmp_path, TWO)
    session = relay_session(session_id=3, relay_id=3)
    for name, sequences in (("first", (0, 1)), ("second", (1, 2))):
        timeline = [Message(s, t3=600 + s, t4=700 + s) for s in sequences]
        write_trace(tmp_path / f"{name}.mcap", session, (), relay_events(timeline, run_id=99, relay_id=3))
    findings = {f.code: f for f in analyze(tmp_path).findings}
    assert "6 events" in findings["orphan_relay_events"].what
    assert findings["overlapping_files"].where == "second.mcap"
    assert numbers(findings["overlapping_files"].what)[0] == 2
    assert "first.mcap" in findings["overlapping_files"].what
    sentences(findings["overlapping_files"].what)


@pytest.mark.parametrize(
    ("runs", "sessions", "code"),
    [([], [ping_session()], "undescribed_run"), ([run(run_id=8, extra={})], [relay_session()], "undescribed_session")],
)
def test_a_run_that_nobody_describes_is_left_out_and_named(tmp_path, runs, sessions, code):
    write_trace(tmp_path / "odd.mcap", sessions, runs, ping_events(TWO, run_id=8))
    with pytest.raises(MissingEventsError, match=r"run 0000000000000008 in odd\.mcap"):
        analyze(tmp_path)
    write_pair(tmp_path, TWO, ping=ping_session(session_id=77), runs=[run(extra={})])
    analysis = analyze(tmp_path)
    assert set(analysis.load_roundtrips()["run_id"]) == {RUN_ID}
    (finding,) = [f for f in analysis.findings if f.code == code]
    assert finding.severity.value == "error"
    assert "odd.mcap" in finding.where


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"payload_bytes": 2**40}, "1099511627776; a size in bytes"),
        ({"payload_bytes": -1}, "-1; a size in bytes"),
        ({"rate_hz": float("nan")}, "nan; a rate in messages"),
        ({"warmup_messages": -1}, "-1; a count"),
        ({"qos": Qos(depth=2**70)}, "an integer of 22 digits"),
    ],
)
def test_an_impossible_description_is_not_used_and_its_field_is_named(tmp_path, values, words, sentences):
    write_trace(tmp_path / "odd.mcap", [ping_session()], [run(run_id=8, **values)], ping_events(TWO, run_id=8))
    with pytest.raises(MissingEventsError, match=r"odd\.mcap") as error:
        analyze(tmp_path)
    assert words in str(error.value)
    write_pair(tmp_path, TWO, ping=ping_session(session_id=77), runs=[run(extra={})])
    analysis = analyze(tmp_path)
    assert set(analysis.load_roundtrips()["run_id"]) == {RUN_ID}
    (finding,) = [f for f in analysis.findings if f.code == "skipped_file"]
    assert finding.where == "odd.mcap"
    assert words in finding.what
    sentences(finding.what)


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("warmup_messages", -1, r"'warmup_messages' .* is -1; a count"),
        ("rate_hz", "fast", "'rate_hz' .* 'fast', not a number"),
        ("qos", {}, "no field 'reliability'"),
    ],
)
def test_a_bad_description_alone_says_what_is_bad_in_it(tmp_path, monkeypatch, field, value, words, sentences):
    described = Run.to_json
    monkeypatch.setattr(Run, "to_json", lambda self: json.dumps({**json.loads(described(self)), field: value}))
    write_pair(tmp_path, TWO)
    with pytest.raises(MissingEventsError, match=words) as error:
        analyze(tmp_path)
    assert "add the trace of the ping" not in str(error.value)
    sentences(str(error.value).replace(str(tmp_path), "FOLDER"))


def test_sessions_are_listed_once_and_by_start(tmp_path):
    write_pair(tmp_path, TWO, relay=relay_session(wall_anchor_ns=5))
    write_trace(tmp_path / "part.mcap", relay_session(wall_anchor_ns=5, state="open"), (), relay_events(TWO[:1]))
    analysis = analyze(tmp_path)
    assert [(s.session_id, s.state) for s in analysis.sessions] == [
        (RELAY_SESSION_ID, "closed"),
        (PING_SESSION_ID, "closed"),
    ]
