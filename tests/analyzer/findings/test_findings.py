"""Each finding by hand: what brings it about, and that a sound recording has none."""

import re
from dataclasses import replace
from importlib import import_module
from pkgutil import iter_modules

import pytest
from trace_files import (
    PING_SESSION_ID,
    RELAY_ID,
    RUN_ID,
    Message,
    event,
    ping_events,
    ping_session,
    relay_events,
    relay_session,
    run,
    sound,
    write_pair,
    write_runs,
    write_trace,
)
from wording import numbers

import dds_trace.analyzer.loading.traces
from dds_trace.analyzer import findings as rooms
from dds_trace.analyzer.findings import table
from dds_trace.analyzer.findings.evidence import Check
from dds_trace.analyzer.model.finding import Severity
from dds_trace.analyzer.model.metrics import METRICS
from dds_trace.analyzer.pipeline import analyze
from dds_trace.reports.book.answer import PointKind
from dds_trace.reports.book.book import Book
from dds_trace.tracefile.format.descriptions import Qos
from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.reading.reader import read_trace_in_pieces

MS = 1_000_000
PERIOD = 100 * MS  # 10 Hz
RESULT = "binary 33000 B at 10 Hz"


def described(messages, **changes):
    return run(planned_messages=len(messages), published=len(messages), **changes)


def write_published(folder, *runs, **session):
    """One message of each run, without a reply."""
    events = {Stage.T1: [event(0, one.run_id, run_id=one.run_id) for one in runs]}
    write_trace(folder / "ping.mcap", ping_session(**session), runs, events)


@pytest.fixture(autouse=True)
def percentiles_of_1000_messages(monkeypatch):
    monkeypatch.setattr(rooms.groups, "PERCENTILES", [one for one in rooms.groups.PERCENTILES if one.needs <= 1000])


def findings(folder):
    return {finding.code: finding for finding in analyze(folder).findings}


def test_a_sound_recording_has_no_finding(tmp_path):
    write_pair(tmp_path, sound())
    assert analyze(tmp_path).findings == ()


def test_every_check_that_is_a_function_is_in_the_table():
    modules = [import_module(f"{rooms.__name__}.{module.name}") for module in iter_modules(rooms.__path__)]
    checks = {value for module in modules for value in vars(module).values() if isinstance(value, Check)}
    assert checks == {check for check in table.CHECKS if check.observe.__module__ != f"{rooms.__name__}.rows"}


def test_of_equal_severity_the_largest_effect_comes_first(tmp_path):
    runs = [run(run_id=n, payload_bytes=1000 * n, planned_messages=10, published=10) for n in (1, 2, 3)]
    messages = [[replace(m, t2=None) if m.sequence < lost else m for m in sound(10)] for lost in (2, 9, 5)]
    write_runs(tmp_path, list(zip(runs, messages, strict=True)))
    losses = [(f.groups, f.effect) for f in analyze(tmp_path).findings if f.code == "loss"]
    assert losses == [((1,), 0.9), ((2,), 0.5), ((0,), 0.2)]


@pytest.mark.parametrize(("never_back", "cure"), [(0, "--depth 42"), (2, "--depth 42"), (3, "")])
def test_a_deeper_history_is_a_cure_only_where_it_keeps_nearly_all_that_was_lost(tmp_path, never_back, cure):
    """10 Hz and depth 10: a standstill of 2.1 s outlives the history; what is lost at the end may have any cause."""
    lost = {*range(50, 70), *range(200 - never_back, 200)}
    write_pair(tmp_path, [m.lost() if m.sequence in lost else m for m in sound(200)])
    (loss,) = (finding for finding in analyze(tmp_path).findings if finding.code == "loss")
    assert cure in loss.cure
    assert bool(loss.cure) == bool(cure)


def test_of_many_findings_of_a_kind_the_rest_are_counted(tmp_path):
    write_published(tmp_path, *(run(run_id=n, published=0, state="started") for n in range(1, 54)))
    unfinished = [f for f in analyze(tmp_path).findings if f.code == "unfinished_run"]
    assert len(unfinished) == 21
    assert unfinished[19].where == "run 0000000000000014 (ping.mcap)"
    assert unfinished[20].where == "run 0000000000000015 (ping.mcap); and 32 more"
    assert unfinished[20].what.startswith("33 more of this kind. ")
    assert [f.count for f in unfinished] == [1] * 20 + [33]


def test_the_most_severe_come_first_and_each_says_what_where_and_what_to_do(tmp_path):
    messages = sound(30)
    messages[3] = replace(messages[3], t2=None)
    write_pair(tmp_path, messages, ping=ping_session(dropped_events=2), runs=[described(messages, rate_hz=50.0)])
    found = analyze(tmp_path).findings
    assert {f.code for f in found} == {"recorder_drops", "loss", "schedule_not_held", "few_samples"}
    severities = [list(Severity).index(finding.severity) for finding in found]
    assert severities == sorted(severities)
    for finding in found:
        assert finding.where
        assert finding.what.endswith(".")
        assert finding.action.endswith(".")


@pytest.mark.parametrize(
    ("ping", "relay", "code", "severity", "words"),
    [
        ({}, {"dropped_events": 17}, "recorder_drops", Severity.ERROR, "17 events"),
        ({}, {"state": "open"}, "unclosed_session", Severity.WARNING, "no clean end"),
        (
            {"extra": {"longest_unsaved_ns": 1_000_000_000}},
            {"extra": {"longest_unsaved_ns": 1_650_000_000}},
            "slow_to_disk",
            Severity.INFO,
            "1.65 s",
        ),
    ],
)
def test_a_recording_that_went_wrong_names_its_session_and_results(tmp_path, ping, relay, code, severity, words):
    write_pair(tmp_path, sound(), ping=ping_session(**ping), relay=relay_session(**relay))
    (finding,) = findings(tmp_path).values()
    assert (finding.code, finding.severity) == (code, severity)
    assert words in finding.what
    assert (finding.where, finding.groups) == ("relay on beta (relay.mcap)", (0,))


def test_a_finding_of_a_recording_has_the_groups_of_that_recording_alone(tmp_path):
    messages = sound(20)
    write_pair(tmp_path / "one", messages, runs=[described(messages)])
    write_pair(
        tmp_path / "two",
        messages,
        ping=ping_session(session_id=0x77, state="open"),
        runs=[described(messages, run_id=2, payload_bytes=50_000, extra={"session_id": f"{0x77:016x}"})],
    )
    found = findings(tmp_path)["unclosed_session"]
    assert found.where == "ping on alpha (two/ping.mcap)"
    sizes = analyze(tmp_path).summary["payload_bytes"].to_list()
    assert [sizes[group] for group in found.groups] == [50_000]


def test_loss_tells_where_messages_were_lost(tmp_path, sentences):
    messages = sound()
    messages[10] = replace(messages[10], t2=None)
    messages[20] = replace(messages[20], t2=None, t4=None)
    messages[30] = replace(messages[30], t2=None, t4=None, t3=None)
    messages[31] = replace(messages[31], t2=None, t4=None, t3=None)
    write_pair(tmp_path, messages)
    finding = findings(tmp_path)["loss"]
    assert numbers(finding.what) == [4, 1000, 0.4, 2, 1, 1]
    assert finding.where == RESULT
    sentences(finding.what)
    assert finding.groups == (0,)


def test_nothing_received(tmp_path, sentences):
    write_pair(tmp_path, [replace(m, t2=None) for m in sound(5)])
    found = findings(tmp_path)
    assert numbers(found["nothing_received"].what) == [5, 5]
    sentences(found["nothing_received"].what)
    assert "loss" not in found


def test_names_of_groups_tell_them_apart(tmp_path):
    write_published(tmp_path, run(run_id=1, serialization="raw"), run(run_id=2, serialization="typed"))
    found = [f for f in analyze(tmp_path).findings if f.code == "nothing_received"]
    assert [(f.where, f.groups) for f in found] == [
        (f"{RESULT}, serialization raw", (0,)),
        (f"{RESULT}, serialization typed", (1,)),
    ]


def test_names_of_groups_leave_out_what_only_follows_something_else(tmp_path):
    write_published(
        tmp_path,
        run(run_id=1, bridge="none", relay_domain_id=5),
        run(run_id=2, bridge="builtin", relay_domain_id=10),
        run(run_id=3, bridge="builtin", relay_domain_id=10, qos=Qos(reliability="best_effort")),
        domain_id=5,
    )
    where = {f.where for f in analyze(tmp_path).findings if f.code == "nothing_received"}
    varying = ("no bridge, reliable", "bridge builtin, reliable", "bridge builtin, best_effort")
    assert where == {f"{RESULT}, {each}" for each in varying}


def test_a_session_of_many_files_names_a_few(tmp_path):
    messages = sound(5)
    for number in range(4):
        write_trace(tmp_path / f"part{number}.mcap", relay_session(dropped_events=1), (), relay_events(messages))
    write_trace(tmp_path / "ping.mcap", ping_session(), [described(messages)], ping_events(messages))
    session, _, files = findings(tmp_path)["recorder_drops"].where.partition(" (")
    assert (session, files) == ("relay on beta", "part0.mcap; part1.mcap; and 2 more)")


def test_few_samples_names_percentiles_and_counts(tmp_path, sentences):
    messages = sound(50)
    write_pair(tmp_path, messages)
    finding = findings(tmp_path)["few_samples"]
    assert finding.severity is Severity.INFO
    what, _, metrics = finding.what.partition(" (of ")
    assert (numbers(what), metrics) == ([100, 1000, 50], f"{', '.join(METRICS)}).")
    sentences(what)
    assert "1000" in finding.action


def test_metrics_with_fewer_samples_are_told_apart(tmp_path, sentences):
    messages = sound(1000)
    messages[:950] = [replace(m, t3=None, t4=None) for m in messages[:950]]
    write_pair(tmp_path, messages)
    found = [f.what for f in analyze(tmp_path).findings if f.code == "few_samples"]
    (what,) = found
    assert numbers(what) == [100, 1000, 50]
    assert "(of intermediate, latency" in what
    assert "rtt" not in what
    gaps = findings(tmp_path)["relay_trace_gaps"].what
    assert numbers(gaps)[:3] == [950, 1000, 95]
    sentences(gaps)


def test_schedule_not_held(tmp_path, sentences):
    write_pair(tmp_path, sound(), runs=[described(sound(), rate_hz=12.0)])
    finding = findings(tmp_path)["schedule_not_held"]
    assert numbers(finding.what) == [10, 12]
    sentences(finding.what)
    write_pair(tmp_path, sound(), runs=[described(sound(), rate_hz=10.1)])  # within 2 %
    assert "schedule_not_held" not in findings(tmp_path)


def sent_late(late_ns, count=1000):
    """A sound recording whose message s leaves `late_ns(s)` after its T0."""
    return [
        replace(m, t1=m.t0 + wait, t3=m.t3 + wait, t4=m.t4 + wait, t2=m.t2 + wait)
        for m in sound(count)
        for wait in [late_ns(m.sequence)]
    ]


def test_one_late_last_message_does_not_break_a_schedule(tmp_path):
    write_pair(tmp_path, sent_late(lambda s: 300 * MS if s == 29 else 50, 30))
    assert set(findings(tmp_path)) == {"few_samples"}
    write_pair(tmp_path, sent_late(lambda s: s * 10 * MS, 30))  # a tenth of a period more each time
    assert numbers(findings(tmp_path)["schedule_not_held"].what) == [9.09, 10]


def test_a_sender_that_is_held_up_again_and_again_sends_late(tmp_path, sentences):
    # Blocked for 300 ms in every two seconds: of twenty messages three leave late, and the rate is held.
    write_pair(tmp_path, sent_late(lambda s: max(300 - 100 * (s % 20), 0) * MS + 50))
    finding = findings(tmp_path)["late_sends"]
    assert numbers(finding.what) == [150, 1000, 15, 5, 300]
    sentences(finding.what)
    assert (finding.groups, finding.effect) == ((0,), 0.15)
    assert "schedule_not_held" not in findings(tmp_path)


@pytest.mark.parametrize(
    ("cpu_ns", "relay_percent", "changes", "shown"),
    [
        (950 * MS, 50, {}, [95, 950]),
        (950 * MS, 99, {}, [95, 950]),
        (500 * MS, 50, {}, None),  # it waited for the link
        (500 * MS, 99, {}, [50, 99]),  # for the relay
        ("much", 99, {}, None),
        (950 * MS, 99, {"payload_bytes": 100_000}, None),
        (500 * MS, 99, {"payload_bytes": 100_000}, None),
        (950 * MS, 99, {"rate_hz": 10.0}, None),
    ],
)
def test_a_throughput_is_ours_where_a_side_never_waited(tmp_path, sentences, cpu_ns, relay_percent, changes, shown):
    sender = {"cpu_ns": cpu_ns, "waited_ns": 400 * MS, "elapsed_ns": 1400 * MS}  # others had its processor
    described_run = described(sound(), **{"rate_hz": 0.0, **changes})
    described_run = replace(described_run, extra={**described_run.extra, "sender": sender})
    write_pair(tmp_path, sound(), runs=[described_run])
    load = [{"processes": {"self": {"cpu_percent": percent}}} for percent in (0, relay_percent, relay_percent)]
    write_trace(tmp_path / "relay.mcap", relay_session(), (), relay_events(sound()), host=load)
    analysis = analyze(tmp_path)
    found = [finding for finding in analysis.findings if finding.code == "client_bound"]
    answer = " ".join(text for kind, text in Book(analysis).answer.sentences if kind is PointKind.DOUBT)
    assert ("our ping or relay" in answer) is bool(found) is bool(shown)
    if found:
        assert numbers(found[0].what) == pytest.approx(shown)
        assert found[0].groups == (0,)
        sentences(found[0].what, answer)


def test_a_few_late_sends_are_no_habit(tmp_path):
    write_pair(tmp_path, sent_late(lambda s: 20 * MS if s < 9 else 50))  # of 1000
    assert findings(tmp_path) == {}
    write_pair(tmp_path, sent_late(lambda s: 20 * MS if s < 2 else 50, 20))
    assert "late_sends" not in findings(tmp_path)
    write_pair(tmp_path, sent_late(lambda _: 4 * MS))  # a missed timer tick
    assert findings(tmp_path) == {}


def test_a_ping_that_stood_still_is_a_finding_of_its_own(tmp_path, sentences):
    # From the 30th to the 35th second nothing leaves; what was due then leaves at once: 5 % of all messages.
    write_pair(tmp_path, sent_late(lambda s: 35_000 * MS - s * PERIOD + 10 * s if 300 <= s <= 350 else 50))
    found = findings(tmp_path)
    assert set(found) == {"stood_still"}
    assert numbers(found["stood_still"].what) == [5, 35, 99, 4]
    sentences(found["stood_still"].what)
    assert (found["stood_still"].groups, found["stood_still"].where) == ((0,), f"run {RUN_ID:016x} (ping.mcap)")
    assert found["stood_still"].effect == pytest.approx(5 / 94.95, rel=1e-3)  # to the middle of the last tenth


def test_a_second_without_a_message_that_was_due_is_no_stand_still(tmp_path):
    write_pair(tmp_path, sent_late(lambda s: 850 * MS - (s - 300) * PERIOD + 10 * s if 300 <= s < 309 else 50))
    assert findings(tmp_path) == {}
    slow = [replace(m, t0=m.t0 * 30, t1=m.t1 * 30, t3=m.t3 * 30, t4=m.t4 * 30, t2=m.t2 * 30) for m in sound()]
    write_pair(tmp_path, slow, runs=[described(slow, rate_hz=1 / 3)])  # three seconds between two that are due
    assert "stood_still" not in findings(tmp_path)


STOPPED = [*range(30), *range(36, 40)]


@pytest.mark.parametrize(
    ("seconds", "of_relay", "words"),
    [
        (range(40), [], "of its process went on."),
        (STOPPED, [], "sample of the host was taken."),
        (STOPPED, range(40), "on its machine went on."),
        (STOPPED, [*range(32), *range(36, 40)], "the machine stood still."),
        (range(30), [], "at most 4 s late."),
    ],
    ids=["sender alone", "process", "process beside others", "machine", "no sample behind it"],
)
def test_the_host_tells_what_a_stand_still_was(tmp_path, seconds, of_relay, words, sentences):
    what = stood_still(tmp_path, seconds, of_relay).what
    assert what.endswith(words)
    sentences(what)


def stood_still(folder, seconds, of_relay=(), **host):
    """Finding of a ping that stood still from the 30th to the 35th second, with samples of both sides at some seconds."""
    messages = sent_late(lambda s: 35_000 * MS - s * PERIOD + 10 * s if 300 <= s <= 350 else 50)
    boot = {"extra": {"boot_id": "one"}}
    ping, relay = ping_session(**boot), relay_session(**boot)
    described_run = described(messages)
    ping_samples, relay_samples = (
        [
            {
                "monotonic_ns": second * 10**9 - 10,
                "host": {name: before if second <= 30 else after for name, (before, after) in host.items()},
            }
            for second in each
        ]
        for each in (seconds, of_relay)
    )
    write_trace(folder / "ping.mcap", ping, [described_run], ping_events(messages), host=ping_samples)
    write_trace(folder / "relay.mcap", relay, (), relay_events(messages), host=relay_samples)
    return findings(folder)["stood_still"]


def test_stolen_time_and_pressure_stand_beside_a_stand_still(tmp_path, sentences):
    found = stood_still(tmp_path, STOPPED, steal_ns=(10**9, 45 * 10**8), pressure_us=({"cpu": 100}, {"cpu": 5_600_100}))
    # From the sample at 29 s to that at 36 s.
    assert numbers(found.what)[-2:] == [3.5, 80]
    sentences(found.what)


def test_what_a_stand_still_held_up_is_no_late_send(tmp_path):
    # Caught up at the 45th second only: a hundred messages that were due behind its end left late, too.
    catching_up = sent_late(
        lambda s: max(35_000 * MS - s * PERIOD, (450 - s) * 50 * MS) + 10 * s if 300 <= s <= 450 else 50
    )
    write_pair(tmp_path, catching_up)
    assert set(findings(tmp_path)) == {"stood_still"}


@pytest.mark.parametrize(
    ("changes", "code", "said"),
    [
        ({"state": "started", "published": 0}, "unfinished_run", {1000}),
        ({"published": 1000, "planned_messages": 1500}, "unfinished_run", {1000, 1500}),
        ({"published": 1003}, "missing_publications", {3, 1003}),
        ({"payload_bytes": 20}, "unlike_payloads", {20, 33_000}),
        ({"relay_domain_id": 7}, "unlike_domains", {7, 10}),
    ],
)
def test_runs_that_are_not_what_they_say(tmp_path, changes, code, said, sentences):
    messages = sound()
    write_trace(
        tmp_path / "ping.mcap", ping_session(), [replace(described(messages), **changes)], ping_events(messages)
    )
    write_trace(tmp_path / "relay.mcap", relay_session(), (), relay_events(messages))
    found = findings(tmp_path)
    assert set(found) == {code}
    assert said <= {*numbers(found[code].what)}
    sentences(found[code].what)


def test_times_below_zero_are_counted(tmp_path, sentences):
    messages = sound()
    messages[5] = replace(messages[5], t4=messages[5].t3 - 3)  # leaves before it arrives
    messages[6] = replace(messages[6], t4=messages[6].t3 + 5000)  # takes longer than the round trip
    write_pair(tmp_path, messages)
    finding = findings(tmp_path)["negative_times"]
    assert finding.severity is Severity.ERROR
    assert re.findall(r"(\w+) of (\d+) message", finding.what) == [("intermediate", "1"), ("latency", "1")]
    sentences(finding.what)
    assert f"relay {RELAY_ID:08x} on beta" in finding.where


@pytest.mark.parametrize(
    ("labels", "values"),
    [
        (
            [{"tuning": "on", "site": "lab"}, {"tuning": "off", "site": "lab"}, {"site": "lab"}],
            "(tuning: None; off; on)",
        ),
        ([{"pass": str(number), "site": "lab"} for number in (1, 2, 3)], None),
    ],
)
def test_labels_that_differ_within_a_group(tmp_path, labels, values):
    write_published(tmp_path, *(run(run_id=number, labels=one) for number, one in enumerate(labels, 1)))
    found = findings(tmp_path).get("mixed_labels")
    assert values in found.what if values else found is None


def write_second(folder, **session):
    described_run = described(sound(), run_id=9, extra={})
    write_trace(
        folder / "second.mcap", ping_session(session_id=9, **session), [described_run], ping_events(sound(), run_id=9)
    )


def difference(finding):
    return finding.what.split()[0], re.findall(r"(\S+) on (\w+)", finding.what)


def test_unlike_environments(tmp_path, sentences):
    host = {"kernel": "6.1", "wifi": {"wlan0": {"signal_dbm": -60}}, "socket_buffers": {"net.core.rmem_max": 212992}}
    other = {"kernel": "6.6", "wifi": {"wlan0": {"signal_dbm": -70}}, "socket_buffers": {"net.core.rmem_max": 212992}}
    write_pair(tmp_path, sound(), ping=ping_session(host=host), relay=relay_session(host=other))
    assert "unlike_environments" not in findings(tmp_path)  # a ping is not compared with a relay
    write_second(tmp_path, device="omega", host=other)
    finding = findings(tmp_path)["unlike_environments"]
    assert difference(finding) == ("kernel", [('"6.1"', "alpha"), ('"6.6"', "omega")])
    sentences(finding.what)
    assert finding.where == "ping sessions"


def test_versions_are_compared_within_a_vendor(tmp_path):
    def second(vendor):
        write_second(tmp_path, vendor=vendor, rmw=f"rmw_{vendor}", host={"versions": {"rmw": "2"}})
        return [difference(f) for f in analyze(tmp_path).findings if f.code == "unlike_environments"]

    write_pair(tmp_path, sound(), ping=ping_session(host={"versions": {"rmw": "1"}}))
    assert second("cyclonedds") == []
    assert second("fastdds") == [
        ("rmw", [('"rmw_fastdds"', "alpha"), ('"rmw_fastrtps_cpp"', "alpha")]),
        ("versions.rmw", [('"1"', "alpha"), ('"2"', "alpha")]),
    ]


def test_a_setting_made_in_one_session_only_is_a_difference(tmp_path):
    tuned = {"settings": {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}, "mtu": {"eth0": 1500}}
    plain = {"settings": {}, "mtu": {"wlan0": 1400}}
    write_pair(tmp_path, sound(), ping=ping_session(host=tuned))
    write_second(tmp_path, host=plain)
    assert [difference(f) for f in analyze(tmp_path).findings if f.code == "unlike_environments"] == [
        ("settings.FASTDDS_BUILTIN_TRANSPORTS", [('"UDPv4"', "alpha"), ("null", "alpha")])
    ]


def test_events_without_a_publication(tmp_path):
    messages = sound()
    messages[4] = replace(messages[4], t1=None)
    write_pair(tmp_path, messages, runs=[run(published=999, planned_messages=999)])
    finding = findings(tmp_path)["orphan_events"]
    assert finding.what.startswith("3 T2, T3 or T4 events")


def test_repeated_publications(tmp_path):
    events = ping_events(sound())
    events[Stage.T1].append(event(7, 5 * MS, scheduled_ns=7 * PERIOD))
    write_trace(tmp_path / "ping.mcap", ping_session(), [described(sound())], events)
    assert findings(tmp_path)["repeated_publications"].what.startswith("1 T1 event repeats")


def test_what_the_reader_noticed(tmp_path, monkeypatch):
    write_pair(tmp_path, sound())

    def noticing(path, take):
        return replace(
            read_trace_in_pieces(path, take),
            ring_events=3,
            unreadable_messages=2,
            notes=("odd",),
            truncated="at byte 9",
        )

    monkeypatch.setattr(dds_trace.analyzer.loading.traces, "read_trace_in_pieces", noticing)
    found = findings(tmp_path)
    assert set(found) == {"truncated_file", "ring_recovered", "unreadable_messages", "reader_note"}
    assert "at byte 9" in found["truncated_file"].what
    assert "3 events" in found["ring_recovered"].what
    assert "2 messages" in found["unreadable_messages"].what
    assert found["reader_note"].what == "odd"


def test_the_session_named_by_the_run_is_not_in_doubt(tmp_path):
    named = described(sound(), extra={"session_id": f"{PING_SESSION_ID:016x}"})
    write_pair(tmp_path, sound(), ping=[ping_session(), ping_session(session_id=2)], runs=[named])
    assert findings(tmp_path) == {}


def test_a_relay_that_nobody_describes(tmp_path):
    write_trace(tmp_path / "ping.mcap", ping_session(), [described(sound())], ping_events(sound()))
    write_trace(tmp_path / "relay.mcap", (), (), relay_events(sound()))
    analysis = analyze(tmp_path)
    assert [finding.code for finding in analysis.findings] == ["undescribed_relay"]
    assert set(analysis.load_roundtrips()["relay_vendor"]) == {None}
    assert analysis.summary["latency_p50_ns"].null_count() == 0


def test_a_relay_without_its_events(tmp_path):
    write_trace(tmp_path / "ping.mcap", ping_session(), [described(sound())], ping_events(sound()))
    assert "Copy the relay's trace" in findings(tmp_path)["missing_relay_trace"].action
    write_trace(tmp_path / "relay.mcap", relay_session(), (), {})
    assert "does not have these runs" in findings(tmp_path)["missing_relay_trace"].action


def side_by_side(folder, shift_ns, **second):
    """Two runs of one ping device, the second `shift_ns` after the first, with other fields."""
    sessions = ping_session(), ping_session(session_id=9, **second)
    for number, (session, shift) in enumerate(zip(sessions, (0, shift_ns), strict=True), 1):
        moved = [Message(m.sequence, *(t + shift for t in (m.t0, m.t1, m.t3, m.t4, m.t2))) for m in sound(100)]
        described_run = described(
            moved, run_id=number, payload_bytes=1000 * number, extra={"session_id": f"{session.session_id:016x}"}
        )
        fields = {"run_id": number, "payload_bytes": 1000 * number}
        write_trace(folder / f"ping{number}.mcap", session, [described_run], ping_events(moved, **fields))
    return {f.code: f for f in analyze(folder).findings}


def test_unlike_pings_at_the_same_time_on_a_device(tmp_path, sentences):
    found = side_by_side(tmp_path, 5 * 10**9)["overlapping_pings"]  # of ten seconds each
    assert found.groups == (0, 1)
    assert numbers(found.what) == [1, 1, 2, 49.5]
    sentences(found.what)
    assert found.effect == pytest.approx(4.9 / 9.9, rel=1e-3)


@pytest.mark.parametrize(
    ("shift_ns", "second"),
    [(10 * 10**9, {}), (9_500 * MS, {}), (5 * 10**9, {"device": "gamma"})],
    ids=["one after the other", "within a second", "another device"],
)
def test_pings_that_do_not_disturb_each_other(tmp_path, shift_ns, second):
    assert "overlapping_pings" not in side_by_side(tmp_path, shift_ns, **second)


@pytest.mark.parametrize(
    ("spans_s", "settings", "groups"),
    [
        ([(0, 10), (1, 11), (20, 30)], ["flows=2", "flows=2", ""], []),  # the setting says it
        ([(0, 10), (8, 18)], ["", ""], [(0,)]),  # the finding says it: two seconds of each were under load
        ([(0, 10), (1, 3)], ["", "flows=2"], [(0, 1)]),  # counted for one of them alone
        ([(0, 10), (9.5, 19)], ["", ""], []),  # half a second, in the middle of neither
        ([(0, 0.6), (0.2, 0.8)], ["flows=2", "flows=2"], []),
        ([(0, 10), (10.1, 20)], ["", ""], []),
    ],
)
def test_runs_at_the_same_time_are_flows_of_the_setting_or_a_finding(tmp_path, spans_s, settings, groups):
    sent, runs = {Stage.T1: []}, []
    for number, (begin_s, end_s) in enumerate(spans_s, 1):
        times = range(round(begin_s * 10), round(end_s * 10) + 1)
        sent[Stage.T1] += [event(s, tick * PERIOD, run_id=number) for s, tick in enumerate(times)]
        runs.append(run(run_id=number, planned_messages=len(times), published=len(times)))
    write_trace(tmp_path / "ping.mcap", ping_session(), runs, sent)
    analysis = analyze(tmp_path)
    assert analysis.load_roundtrips().unique("run_id").sort("run_id")["setting"].to_list() == settings
    assert [found.groups for found in analysis.findings if found.code == "overlapping_pings"] == groups


def test_two_names_of_one_boot_are_one_device(tmp_path):
    boot = {"extra": {"boot_id": "one"}}
    events = {Stage.T1: [event(s, s * PERIOD, run_id=1) for s in range(100)]}
    write_trace(tmp_path / "a.mcap", ping_session(**boot), [described(sound(100), run_id=1)], events)
    other = {Stage.T1: [event(s, s * PERIOD, run_id=2, payload_bytes=9) for s in range(100)]}
    second = ping_session(session_id=9, device="gamma", **boot)
    run_of_second = described(sound(100), run_id=2, payload_bytes=9, extra={"session_id": f"{9:016x}"})
    write_trace(tmp_path / "b.mcap", second, [run_of_second], other)
    assert "overlapping_pings" in findings(tmp_path)


def fast_dds_side(make, package, version, is_own=True, boot="b", path="lo"):
    memory = [{"name": "x", "middleware": "fastdds", "is_own": is_own, "is_deleted": False}]
    counted = (
        {"interfaces": {"lo": {"sent_bytes": 0}}, "memory": memory},
        {"interfaces": {"lo": {"sent_bytes": 450_000_000}}, "memory": memory},
    )
    applied = {"begin": counted[0], "end": counted[1], "path": path}
    return make(vendor="fastdds", host={"versions": {package: version}}, extra={"boot_id": boot, "applied": applied})


def test_two_generations_of_fast_dds_on_one_machine_share_no_memory(tmp_path, sentences):
    old = fast_dds_side(ping_session, "fastrtps", "2.14.5")
    new = fast_dds_side(relay_session, "fastdds", "3.2.3")
    write_pair(tmp_path, sound(), ping=old, relay=new)
    found = findings(tmp_path)
    sentences(found["mixed_versions"].what)
    assert "Fast DDS 2.14.5 and 3.2.3" in found["mixed_versions"].what
    assert "fastdds 2.14.5 and 3.2.3" in found["unlike_versions"].what
    for other in (
        fast_dds_side(relay_session, "fastdds", "2.14.6"),  # as newer recorders name it
        fast_dds_side(relay_session, "fastdds", "3.2.3", is_own=False),
        fast_dds_side(relay_session, "fastdds", "3.2.3", boot="another"),
    ):
        write_pair(tmp_path, sound(), ping=old, relay=other)
        assert "mixed_versions" not in findings(tmp_path)


def test_a_ping_and_a_relay_of_unlike_versions(tmp_path, sentences):
    old = {"host": {"versions": {"rmw_fastrtps_cpp": "8.4.1", "rclpy": "7"}}, "extra": {"recorder_version": "0.1.0"}}
    new = {"host": {"versions": {"rmw_fastrtps_cpp": "8.4.2", "rclpy": "7"}}, "extra": {"recorder_version": "0.2.0"}}
    write_pair(tmp_path, sound(), ping=ping_session(**old), relay=relay_session(**new))
    found = findings(tmp_path)["unlike_versions"]
    assert re.findall(r"\d+\.\d+\.\d+", found.what) == ["0.1.0", "0.2.0", "8.4.1", "8.4.2"]
    sentences(found.what)
    assert (found.where, found.groups) == ("ping on alpha, relay on beta", (0,))
    write_pair(tmp_path, sound(), ping=ping_session(**old), relay=relay_session(**old))
    assert "unlike_versions" not in findings(tmp_path)
    write_pair(tmp_path, sound(), ping=ping_session(**old))  # an older recorder tells nothing
    assert "unlike_versions" not in findings(tmp_path)


@pytest.mark.parametrize(
    ("relay", "connectivity", "is_found"),
    [
        ({"extra": {"boot_id": "one"}}, "wireless", True),
        ({"extra": {"boot_id": "two"}}, "wireless", False),
        ({"extra": {"boot_id": "one"}}, "loopback", False),
        ({"device": "alpha"}, "wireless", True),
        ({}, "wireless", False),
    ],
)
def test_wireless_on_one_machine(tmp_path, relay, connectivity, is_found):
    ping = ping_session(connectivity=connectivity, extra={"boot_id": "one"} if "extra" in relay else {})
    of_one_clock = [replace(m, t3=m.t3 + 500, t4=m.t4 + 500) for m in sound()]
    write_pair(tmp_path, of_one_clock, ping=ping, relay=relay_session(connectivity=connectivity, **relay))
    assert ("wireless_on_one_machine" in findings(tmp_path)) is is_found
