import ast
import re
from dataclasses import replace
from itertools import cycle
from pathlib import Path

import numpy as np
import pytest
from trace_files import (
    RELAY_ID,
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
    write_runs,
    write_trace,
)
from wording import numbers

import dds_trace.analyzer.findings
from dds_trace.analyzer.model.finding import Severity
from dds_trace.analyzer.pipeline import analyze
from dds_trace.base.units import parse_duration
from dds_trace.reports.book.answer import PointKind
from dds_trace.reports.book.book import Book
from dds_trace.tracefile.format.events import Stage

MS = 1_000_000
PERIOD = 100 * MS
BOOT = {"boot_id": "one"}


def drawn(way=MS, count=200, ahead=0, drift=0.0, first=0):
    messages = []
    for s in range(first, first + count):
        t = s * PERIOD
        there = t + way + ahead + round(drift * t)
        messages.append(Message(s, t0=t, t1=t, t3=there, t4=there, t2=t + 2 * way))
    return messages


def findings(folder, **options):
    return {finding.code: finding for finding in analyze(folder, **options).findings}


def test_clock_step(tmp_path):
    stepped = drawn(count=100) + drawn(count=100, first=100, ahead=500 * MS)
    write_pair(tmp_path, stepped)
    found = findings(tmp_path)["clock_step"]
    assert found.where == "beta against alpha"
    size = float(re.search(r"jumped by ([\d.]+) ms", found.what)[1])
    assert abs(size - 500) < 5
    assert "clock_step" not in findings(tmp_path, details=False)


def test_a_suspended_relay_is_named_as_such(tmp_path):
    # Its clock stands still for 20 s between two messages of one run, and the same relay goes on.
    slept = drawn(count=100) + drawn(count=100, first=100, ahead=-20_000 * MS)
    write_pair(tmp_path, slept)
    found = findings(tmp_path)
    assert "clock_step" not in found
    assert found["suspend"].where == "beta (beta against alpha)"
    stood_ns, within_ns = map(
        parse_duration, re.search(r"for (\S+ \S+) \(within (\S+ \S+)\)", found["suspend"].what).groups()
    )
    assert abs(stood_ns - 20 * 10**9) <= within_ns < 10**8
    assert "suspend" not in findings(tmp_path, details=False)


def test_a_suspended_ping_shows_as_a_relay_clock_that_gets_ahead(tmp_path):
    write_pair(tmp_path, drawn(count=100) + drawn(count=100, first=100, ahead=5_000 * MS))
    assert findings(tmp_path)["suspend"].where == "alpha (beta against alpha)"


def test_a_restarted_relay_is_not_a_suspend(tmp_path, sentences):
    write_restarted_relay(tmp_path, drawn(count=100), drawn(count=100, first=100, ahead=-20_000 * MS))
    found = findings(tmp_path)
    assert "clock_step" in found
    assert "suspend" not in found
    restarted = found["relay_restarted"].what
    assert numbers(restarted)[0] == 2
    assert "(00000002; 0000beef)" in restarted
    sentences(restarted)


def test_messages_lost_while_a_relay_restarts_are_one_outage_that_ends_and_no_fan_out(tmp_path):
    sent = [m.lost() if 90 <= m.sequence < 110 else m for m in drawn()]
    write_restarted_relay(tmp_path, sent[:110], sent[110:], monotonic_anchor_ns=sent[110].t1)
    details = analyze(tmp_path).details
    assert details.outages.select("first_sequence", "messages").rows() == [(90, 20)]
    assert details.outages["end_ns"].to_list() == [sent[110].t2]
    assert details.freshness["messages"].to_list() == [200]
    assert details.fan_out.is_empty()


def test_messages_that_ended_at_the_relay_and_did_not_reach_it_are_named(tmp_path):
    to_come = {False: {"t2": None, "t4": None}, True: {"t2": None, "t3": None, "t4": None}}
    sent = [m if m.sequence % 4 == 0 else replace(m, t0=0, **to_come[m.sequence >= 20]) for m in drawn(count=40)]
    extra = {**run().extra, "ping_every": 4}
    write_pair(tmp_path, sent, runs=[run(planned_messages=40, published=40, rate_hz=0.0, extra=extra)])
    analysis = analyze(tmp_path)
    (found,) = [finding for finding in analysis.findings if finding.code == "unreached"]
    assert numbers(found.what) == [25, 40, 62.5, 10]
    answer = Book(analysis).answer
    assert any("62.5" in text for _, text in answer.sentences)
    assert not any("Every message" in text for text in answer.remarks)


def test_what_is_lost_with_a_killed_relay_needs_no_deeper_history(tmp_path):
    sent = [m.lost() if m.sequence >= 120 else m for m in drawn()]
    write_pair(tmp_path, sent, relay=relay_session(state="open"))
    loss = findings(tmp_path)["loss"]
    assert "80 of them" in loss.what
    assert "see what stopped then" in loss.action
    assert "depth" not in loss.action


def write_restarted_relay(folder, first, second, **session):
    ping = merged_events([ping_events(first), ping_events(second, relay_id=2)])
    write_trace(folder / "ping.mcap", ping_session(), [run(planned_messages=200, published=200)], ping)
    write_trace(folder / "one.mcap", relay_session(), (), relay_events(first))
    restarted = relay_session(session_id=9, relay_id=2, **session)
    write_trace(folder / "two.mcap", restarted, (), relay_events(second, relay_id=2))


def test_a_slew_is_one_finding_and_not_a_step_for_each_second(tmp_path):
    # The relay's clock gains 5000 ppm from the 20th to the 80th second, ten times what the fit takes for a drift.
    slewed = [
        replace(m, t3=m.t3 + gain, t4=m.t4 + gain)
        for m in drawn(count=1000)
        for gain in [min(max(m.t1 - 200 * PERIOD, 0), 600 * PERIOD) // 200]
    ]
    write_pair(tmp_path, slewed)
    found = [f for f in analyze(tmp_path).findings if f.code in {"slewed", "clock_step", "suspend"}]
    assert [(f.code, f.where) for f in found] == [("slewed", "beta against alpha")]
    rate_ppm, within_ppm = map(float, re.search(r"at (\d+) ppm \(within ([\d.]+)\)", found[0].what).groups())
    assert abs(rate_ppm - 5000) <= within_ppm < 500
    assert "slewed" not in findings(tmp_path, details=False)


@pytest.mark.parametrize(("ppm", "way"), [(550, MS // 10), (600, MS), (1000, 5 * MS), (1200, MS)])
def test_a_slew_is_one_finding_on_either_side_of_the_fits_limit(tmp_path, ppm, way):
    # Below 1100 ppm it leaves no step, above steps that are farther apart than a window.
    noise = np.random.default_rng(1).exponential(0.3, (1200, 2))
    slewed = [
        Message(m.sequence, t0=m.t0, t1=m.t1, t3=arrived + gain, t4=arrived + gain, t2=arrived + back)
        for m, (there, back_again) in zip(drawn(count=1200), noise, strict=True)
        for arrived, back in [(m.t1 + int(way * (1 + there)), int(way * (1 + back_again)))]
        for gain in [min(max(m.t1 - 200 * PERIOD, 0), 600 * PERIOD) * ppm // 10**6]
    ]
    write_pair(tmp_path, slewed)
    found = [f for f in analyze(tmp_path).findings if f.code.startswith(("slewed", "clock", "suspend"))]
    assert [(f.code, f.where) for f in found] == [("slewed", "beta against alpha")]
    rate_ppm = float(re.search(r"at (\d+) ppm", found[0].what)[1])
    assert abs(rate_ppm - ppm) <= 0.05 * ppm


def sampled(raw_ppm):
    """Host samples of two minutes; RAW falls behind by `raw_ppm` of each second, 1 us of noise on every reading."""
    raw_ns, samples = 0, []
    for second in range(120):
        noise_ns = 1000 * (-1) ** second
        samples.append({"monotonic_ns": second * 10**9, "monotonic_raw_ns": raw_ns + noise_ns})
        raw_ns += round(10**9 * (1 - raw_ppm(second) / 1e6))
    return samples


@pytest.mark.parametrize(
    ("raw_ppm", "words"),
    [
        (lambda _second: 30, None),  # the frequency that NTP holds
        (lambda second: 30 + second / 120, None),  # which moves by 1 ppm
        (lambda second: 430 if 40 <= second < 60 else 30, "slewed at 430 ppm"),
        (lambda second: -170 if second == 70 else 30, "slewed at 10 ppm"),  # 0.2 ms within ten seconds
        (lambda _second: 500, "slewed at 500 ppm"),
    ],
)
def test_a_slow_slew_shows_against_the_raw_clock(tmp_path, raw_ppm, words):
    write_pair(tmp_path, drawn(), host=sampled(raw_ppm))
    found = findings(tmp_path)
    assert ("slewed" in found) is (words is not None)
    if words is not None:
        assert found["slewed"].where == "alpha"
        assert words in found["slewed"].what


def test_clock_drift(tmp_path):
    write_pair(tmp_path, drawn(count=600, drift=300e-6))
    assert "ppm" in findings(tmp_path)["clock_drift"].what
    write_pair(tmp_path / "sound", drawn(count=600, drift=20e-6))
    assert "clock_drift" not in findings(tmp_path / "sound")


@pytest.mark.parametrize(
    ("busy", "processors", "process", "is_found"),
    [
        (3, [60.0, 100.0], 0.0, True),
        (1, [60.0, 100.0], 0.0, False),
        (3, [2.0] * 63 + [100.0], 0.0, False),  # any busy one of 64 is none of ours
        (3, [2.0] * 63 + [100.0], 99.0, True),
    ],
)
def test_cpu_saturation_in_more_than_a_tenth_of_the_samples(tmp_path, busy, processors, process, is_found):
    host = [
        {
            "host": {"cpu_percent_each": processors if second < busy else [30.0]},
            "processes": {"self": {"cpu_percent": process if second < busy else 10.0}},
            "udp": {"RcvbufErrors": second},
        }
        for second in range(10)
    ]
    write_pair(tmp_path, drawn(), host=host)
    found = findings(tmp_path)
    assert ("cpu_saturated" in found) is is_found
    if is_found:
        assert "In 3 of 10 seconds" in found["cpu_saturated"].what
    assert "udp_buffer_overflow" not in found  # the host's counter holds other programs' datagrams as well


def write_sizes(folder, ways, repeats=3, spread=0.0, **sessions):
    """Some runs for each size, with this way there and back; the runs of a size differ by `spread` of it."""
    recorded = []
    cells = [(size, way, n) for size, way in ways.items() for n in range(repeats)]
    for number, (size, way, repeat) in enumerate(cells, 1):
        messages = [
            Message(m.sequence, *(t + number * 300 * PERIOD for t in (m.t0, m.t1, m.t3, m.t4, m.t2)))
            for m in drawn(way=round(way * (1 + spread * (repeat - (repeats - 1) / 2))))
        ]
        fields = {"payload_bytes": size, "planned_messages": 200, "published": 200}
        recorded.append((run(run_id=number, **fields), messages))
    write_runs(folder, recorded, **sessions)


OF_SIZES = {"latency_falls_with_size", "latency_jumps_with_size"}


def test_two_sizes_of_a_run_each_say_nothing_of_size(tmp_path):
    write_sizes(tmp_path, {33_000: 5 * MS, 145_000: MS}, repeats=2)
    assert not OF_SIZES & set(findings(tmp_path))


def test_runs_that_differ_more_than_the_sizes_do_say_nothing_of_size(tmp_path):
    write_sizes(tmp_path, {33_000: 5 * MS, 145_000: 4 * MS}, spread=0.3)
    assert not OF_SIZES & set(findings(tmp_path))
    write_sizes(tmp_path, {33_000: 5 * MS, 145_000: 4 * MS}, spread=0.01)
    assert "latency_falls_with_size" in findings(tmp_path)


def test_latency_that_falls_with_size_beyond_the_segment_of_one_machine(tmp_path, sentences):
    write_sizes(tmp_path, {502_000: 8 * MS, 1_000_000: 3 * MS}, relay=relay_session(device="alpha"))
    found = findings(tmp_path)["latency_falls_with_size"]
    assert found.severity is Severity.INFO
    assert re.findall(r"(\d+) ms at (\d+ .B)", found.what) == [("8", "502 KB"), ("3", "1 MB")]
    assert "shared-memory segment of 512 KiB" in found.what
    sentences(found.what)


def test_latency_that_jumps_beyond_the_socket_buffer(tmp_path, sentences):
    host = {"socket_buffers": {"rmem_default": 212_992}}
    write_sizes(tmp_path, {145_000: MS, 290_000: 10 * MS}, relay=relay_session(host=host))
    found = findings(tmp_path)["latency_jumps_with_size"]
    assert "beta (net.core.rmem_default 208 KiB)" in found.what
    sentences(found.what)


def test_latency_that_grows_with_size_is_no_finding(tmp_path):
    write_sizes(tmp_path, {33_000: MS, 145_000: 3 * MS})
    assert not {"latency_falls_with_size", "latency_jumps_with_size"} & set(findings(tmp_path))


def test_without_a_cause_it_says_so(tmp_path):
    write_sizes(tmp_path, {33_000: 5 * MS, 145_000: MS})
    assert "no cause" in findings(tmp_path)["latency_falls_with_size"].what


def test_outage(tmp_path, sentences):
    messages = drawn()
    for s in (50, 51, 52, 53):
        messages[s] = replace(messages[s], t2=None)
    write_pair(tmp_path, messages)
    # From message 50, planned at 5 s, to the reply to 54 at 5.402 s.
    what = findings(tmp_path)["outage"].what
    assert numbers(what) == [1, 4, 402]
    sentences(what)


def write_waiting(folder, waits, every=1):
    """A pair whose relay takes each `every`th message `waits` ns after its middleware received it, 1 ms after T1."""
    waited = {m.sequence: waits if m.sequence % every == 0 else MS // 10 for m in drawn()}
    messages = [
        replace(m, t3=m.t3 + waited[m.sequence], t4=m.t4 + waited[m.sequence], t2=m.t2 + waited[m.sequence])
        for m in drawn()
    ]
    ping, relay = ping_events(messages), relay_events(messages)
    for events, stage in ((ping, Stage.T2), (relay, Stage.T3)):
        events[stage] = [
            event(
                sequence,
                at_ns,
                relay_id=relay_id,
                received_ns=WALL_ANCHOR_NS + at_ns - (waited[sequence] if stage is Stage.T3 else MS // 10),
            )
            for _, sequence, at_ns, *_, relay_id in events[stage]
        ]
    write_trace(folder / "ping.mcap", ping_session(), [run(planned_messages=200, published=200)], ping)
    write_trace(folder / "relay.mcap", relay_session(), (), relay)


def test_messages_that_wait_in_a_reader_for_later_ones(tmp_path, sentences):
    write_waiting(tmp_path, waits=6 * PERIOD)
    found = findings(tmp_path)["waits_in_reader"]
    assert numbers(found.what) == [600, 6]
    sentences(found.what)
    assert (found.where, found.groups, found.effect) == ("binary 33000 B at 10 Hz", (0,), 0.5)


def test_a_tail_that_waits_in_a_reader(tmp_path, sentences):
    write_waiting(tmp_path, waits=5 * PERIOD, every=20)
    what = findings(tmp_path)["waits_in_reader"].what
    assert numbers(what)[0] == 500
    sentences(what)


def test_a_callback_that_keeps_up_waits_for_nothing(tmp_path):
    write_waiting(tmp_path, waits=PERIOD // 2)
    assert "waits_in_reader" not in findings(tmp_path)


@pytest.mark.parametrize(("state", "words"), [("died", "ended by itself"), ("never_ready", "never carried")])
def test_failed_bridge(tmp_path, state, words, sentences):
    bridge = {
        "bridge": "builtin",
        "state": state,
        "failure": "exit code 3",
        "programs": [{"log_tail": "up\nlost its way\n"}],
    }
    write_pair(tmp_path, drawn(), ping=ping_session(extra={"bridge": bridge}))
    found = findings(tmp_path)["bridge_failed"]
    assert found.severity is Severity.ERROR
    assert words in found.what
    assert "exit code 3" in found.what
    assert found.what.endswith(": lost its way.")
    sentences(found.what)


def test_a_bridge_that_went_well_is_no_finding(tmp_path):
    write_pair(tmp_path, drawn(), ping=ping_session(extra={"bridge": {"state": "stopped"}}))
    assert "bridge_failed" not in findings(tmp_path)


def test_a_run_that_an_error_ended(tmp_path, sentences):
    error = "the relay of binary_image is lost: no reply to the last 40 messages (4.0 s); look at the link to it"
    write_pair(tmp_path, drawn(), ping=ping_session(extra={"error": error}))
    found = findings(tmp_path)["ended_by_error"]
    assert found.severity is Severity.ERROR
    assert found.where == "ping on alpha (ping.mcap)"
    assert found.what.endswith(f": {error}.")
    sentences(found.what)


@pytest.mark.parametrize(
    "extra",
    [
        {},
        {"error": None},
        {"error": ""},
        {"error": 5},
        {"error": "the bridge died", "bridge": {"bridge": "builtin", "state": "died"}},
    ],
    ids=["old", "regular end", "empty", "no text", "told by bridge_failed"],
)
def test_a_run_without_an_error_of_its_own_is_no_finding(tmp_path, extra):
    write_pair(tmp_path, drawn(), ping=ping_session(extra=extra))
    assert "ended_by_error" not in findings(tmp_path)


@pytest.mark.parametrize(
    ("extra", "expected"),
    [({"strangers": {"a": 3, "b": 1}}, "3 x a; 1 x b"), ({"strangers": {}}, None), ({"strangers": 5}, None)],
)
def test_what_strangers_sent_is_a_warning(tmp_path, extra, expected):
    write_pair(tmp_path, drawn(), ping=ping_session(extra=extra))
    finding = findings(tmp_path).get("strangers")
    assert (finding is not None) == (expected is not None)
    if finding is not None:
        assert expected in finding.what
        assert finding.severity is Severity.WARNING


def test_replies_that_the_relays_whole_trace_does_not_know_are_forged_or_foreign(tmp_path, sentences):
    messages = drawn(count=100)
    messages[7] = replace(messages[7], t3=None, t4=None)
    write_pair(tmp_path, messages)
    finding = findings(tmp_path)["forged_or_foreign"]
    assert finding.severity is Severity.ERROR
    assert "1 not in" in finding.what
    sentences(finding.what)
    write_pair(tmp_path, messages, relay=relay_session(dropped_events=2))  # its recorder may have dropped them
    assert "forged_or_foreign" not in findings(tmp_path)
    write_pair(tmp_path, drawn(count=100))
    assert "forged_or_foreign" not in findings(tmp_path)


def test_replies_before_the_relay_sent_them_are_forged_on_one_clock(tmp_path):
    messages = drawn(count=100)
    messages[7] = replace(messages[7], t2=messages[7].t4 - 1)
    write_pair(tmp_path, messages, ping=ping_session(extra=BOOT), relay=relay_session(extra=BOOT))
    assert "1 sooner" in findings(tmp_path)["forged_or_foreign"].what
    analysis = analyze(tmp_path)
    (kind, _), *others = Book(analysis).answer.sentences
    assert (kind, analysis.details.answers) == (PointKind.FORGED, ())
    assert not [text for _, text in others if "median" in text]


@pytest.mark.parametrize(
    ("sources_ns", "sent", "changes", "expected"),
    [
        ((5, 9), 1, {}, "forged_or_foreign"),
        ((0, 9), 1, {}, "forged_or_foreign"),
        ((5, 9), 1, {"dropped_events": 2}, "doubtful_replies"),
        ((5, 9), 0, {}, "doubtful_replies"),
        ((0, 0), 1, {}, "doubtful_replies"),  # zenoh has no stamps
        ((5, 5), 1, {}, None),  # one sample, delivered twice
        ((5, 9), 2, {}, None),  # the message itself came twice
        ((0, 0), 1, {"backend": "socket"}, None),  # the network may copy a datagram
        ((5, 9), 1, {"domain_id": 5}, None),  # a second bridge
    ],
)
def test_a_reply_between_that_of_the_relay_and_its_arrival(tmp_path, sources_ns, sent, changes, expected):
    *others, chosen = drawn(count=100)
    ping, relay = ping_events([*others, chosen]), relay_events(others)
    true = ping[Stage.T2].pop()
    arrivals_ns = (chosen.t2 - MS // 2, chosen.t2)  # T4 < forged T2 < true T2
    for at_ns, source_ns in zip(arrivals_ns, sources_ns, strict=True):
        ping[Stage.T2].append((*true[:2], at_ns, 0, source_ns, *true[5:]))
    for number in range(sent):
        sent_ns = chosen.t4 + number
        relay = merged_events([relay, relay_events([replace(chosen, t3=sent_ns, t4=sent_ns)])])
    described = run(planned_messages=100, bridge="builtin" if "domain_id" in changes else "none", relay_domain_id=None)
    backend = changes.get("backend", "ros2")
    write_trace(tmp_path / "ping.mcap", ping_session(domain_id=10, backend=backend), [described], ping)
    if sent:
        write_trace(tmp_path / "relay.mcap", relay_session(**{"domain_id": 10, **changes}), (), relay)
    analysis = analyze(tmp_path)
    codes = {finding.code for finding in analysis.findings}
    assert codes & {"forged_or_foreign", "doubtful_replies", "duplicates"} == {expected or "duplicates", "duplicates"}
    (kind, text), *_ = Book(analysis).answer.sentences
    assert (kind is PointKind.FORGED) == (expected is not None)
    assert ("Doubtful" in text) == (expected == "doubtful_replies")


@pytest.mark.parametrize(
    ("sizes", "replies", "run_changes", "expected"),
    [
        ([33_000], [33_000], {}, 0),
        ([33_000], [0], {}, 100),
        ([33_000], [33_000, 3_000_000], {}, 50),
        ([33_000, 200], [33_000, 200], {}, 0),  # files of several sizes
        ([33_000, 200], [200, 33_000], {}, 100),
        ([33_000], [2000], {"reply_bytes": 2000}, 0),  # responses to calls, of a size of their own
        ([33_000], [33_000, 2000], {"reply_bytes": 2000}, 50),
    ],
)
def test_a_result_with_replies_of_another_size_is_in_no_answer(
    tmp_path, sizes, replies, run_changes, expected, sentences
):
    messages = drawn(count=100)
    events = ping_events(messages)
    for stage, sizes_of_stage in ((Stage.T1, sizes), (Stage.T2, replies)):
        events[stage] = [
            (*one[:6], size, one[7]) for one, size in zip(events[stage], cycle(sizes_of_stage), strict=False)
        ]
    described = run(planned_messages=100, published=100, extra=run_changes)
    write_trace(tmp_path / "ping.mcap", ping_session(), [described], events)
    write_trace(tmp_path / "relay.mcap", relay_session(), (), relay_events(messages))
    analysis = analyze(tmp_path)
    found = [finding for finding in analysis.findings if finding.code == "reply_size"]
    assert [finding.effect for finding in found] == [expected / 100] * bool(expected)
    (kind, text), *others = Book(analysis).answer.sentences
    assert (kind is PointKind.FORGED) == bool(expected)
    if expected:
        assert found[0].severity is Severity.ERROR
        assert f"{expected} " in text
        assert analysis.unusable_groups == {0}
        assert analysis.details.answers == ()
        assert not [text for _, text in others if "median" in text]
        sentences(found[0].what)


@pytest.mark.parametrize("relay_ids", [(0,), (0xFFFFFFFF,), (0, 0xFFFFFFFF)])
@pytest.mark.parametrize("others", [True, False])
def test_events_of_an_id_that_names_no_relay_are_left_out(tmp_path, relay_ids, others):
    messages = drawn(count=100)
    ids = [*relay_ids, RELAY_ID] if others else relay_ids
    events = merged_events(
        [ping_events(messages), *({Stage.T2: ping_events(messages, relay_id=r)[Stage.T2]} for r in ids)]
    )
    events[Stage.T2] = [one for one in events[Stage.T2] if one[7] in ids]
    write_trace(tmp_path / "ping.mcap", ping_session(), [run(planned_messages=100, published=100)], events)
    analysis = analyze(tmp_path)
    assert f"{100 * len(relay_ids)} events" in {f.code: f for f in analysis.findings}["unnamed_relay"].what
    (group,) = analysis.summary.to_dicts()
    assert (group["published"], group["received"]) == (100, 100 if others else 0)


@pytest.mark.parametrize("offset_ns", [1_000_000 * MS, 5 * MS])
def test_a_relay_in_another_time_namespace_is_nobody_else(tmp_path, offset_ns):
    messages = [replace(one, t3=one.t3 + offset_ns, t4=one.t4 + offset_ns) for one in drawn(count=100)]
    write_pair(tmp_path, messages, ping=ping_session(extra=BOOT), relay=relay_session(extra=BOOT))
    for details in (True, False):
        assert "forged_or_foreign" not in {finding.code for finding in analyze(tmp_path, details=details).findings}


def test_a_clock_set_between_two_recordings_is_found(tmp_path):
    first = ping_session(extra=BOOT)
    write_pair(tmp_path, drawn(count=10), ping=first)
    times = {
        "monotonic_anchor_ns": first.monotonic_anchor_ns + 1,
        "wall_anchor_ns": first.wall_anchor_ns + 3_600_000 * MS,
    }
    write_trace(tmp_path / "later.mcap", [replace(first, session_id=5, **times)])
    assert "forward by 1 h" in findings(tmp_path)["clock_set"].what


def test_restarted_relay(tmp_path):
    write_restarted_relay(tmp_path, drawn(count=100), drawn(count=100, first=100))
    assert "relay_restarted" in findings(tmp_path)


def test_three_relays_on_purpose_are_no_restart(tmp_path):
    ping = {Stage.T1: [], Stage.T2: []}
    for relay_id in (1, 2, 3):
        of_relay = ping_events(drawn(), relay_id=relay_id)
        ping[Stage.T1] = of_relay[Stage.T1]
        ping[Stage.T2] += of_relay[Stage.T2]
        session = relay_session(session_id=relay_id, relay_id=relay_id)
        write_trace(tmp_path / f"relay{relay_id}.mcap", session, (), relay_events(drawn(), relay_id=relay_id))
    write_trace(tmp_path / "ping.mcap", ping_session(), [run(planned_messages=200, published=200)], ping)
    analysis = analyze(tmp_path)
    assert {"relays=3"} == set(analysis.load_roundtrips()["setting"])
    assert "relay_restarted" not in {finding.code for finding in analysis.findings}


@pytest.mark.parametrize(
    ("boot_ids", "codes"),
    [(("one", "two"), set()), (("one", "one"), {"clock_step"}), ((None, None), {"clock_step"})],
    ids=["rebooted", "same boot", "older recorder"],
)
def test_a_relays_reboot_between_two_runs_is_no_step(tmp_path, boot_ids, codes):
    # The relay's clock counts from its boot: 100 s of difference between the runs, in an order that a boot alone explains.
    parts, runs = [], []
    for number, (boot_id, ahead) in enumerate(zip(boot_ids, (0, -100_000 * MS), strict=True), 1):
        first = (number - 1) * 300
        moved = [replace(m, sequence=m.sequence - first) for m in drawn(ahead=ahead, first=first)]
        parts.append(ping_events(moved, run_id=number, relay_id=number))
        runs.append(run(run_id=number, planned_messages=200, published=200))
        extra = {} if boot_id is None else {"boot_id": boot_id}
        relay = relay_session(session_id=number, relay_id=number, extra=extra)
        events = relay_events(moved, run_id=number, relay_id=number)
        write_trace(tmp_path / f"relay{number}.mcap", relay, (), events)
    write_trace(tmp_path / "ping.mcap", ping_session(extra={"boot_id": "other"}), runs, merged_events(parts))
    found = {f.code for f in analyze(tmp_path).findings}
    assert {code for code in found if code.startswith(("clock", "suspend", "slew"))} == codes


def thresholds():
    room = Path(dds_trace.analyzer.findings.__file__).parent
    others = [room.parent / name for name in ("clocks/slews.py", "groups/sending.py", "groups/shapes.py")]
    for path in [*room.glob("*.py"), *others]:
        body = ast.parse(path.read_text()).body
        for statement, after in zip(body, [*body[1:], None], strict=True):
            if isinstance(statement, ast.Assign) and any(
                isinstance(node, ast.Constant) and isinstance(node.value, int | float)
                for node in ast.walk(statement.value)
            ):
                is_text = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
                yield f"{path.name}: {ast.unparse(statement)}", after.value.value if is_text else ""


def test_every_threshold_of_a_check_stands_with_its_reason():
    told = dict(thresholds())
    assert len(told) > 20
    assert [name for name, reason in told.items() if len(str(reason).split()) < 8] == []


@pytest.mark.parametrize(("step_ns", "is_found"), [(40, False), (10_000, False), (4_000_000, True), ("4 ms", False)])
def test_a_clock_of_coarse_steps(tmp_path, step_ns, is_found):
    clock = {"clock": {"resolution_ns": step_ns}}
    write_pair(tmp_path, drawn(), ping=ping_session(extra=clock), runs=[run(planned_messages=200, published=200)])
    found = findings(tmp_path)
    assert ("coarse_clock" in found) is is_found
    assert not is_found or "steps of 4 ms" in found["coarse_clock"].what
