import re
from pathlib import Path

import pytest
from trace_files import (
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

from dds_trace.analyzer.findings import rows
from dds_trace.analyzer.findings.table import all_checks
from dds_trace.analyzer.pipeline import analyze
from dds_trace.tracefile.format.events import Stage

MS = 1_000_000
PERIOD = 100 * MS


def name_of(check):
    """Its function's name; of a rule the code, or the title where several rules or functions share the code."""
    if check.observe.__module__ != rows.__name__:
        return check.observe.__name__
    return check.code if [other.code for other in all_checks()].count(check.code) == 1 else check.title


TRIED_WITH_MIDDLEWARE = {
    "losses": (
        "test_a_deeper_history_keeps_what_a_stalled_relay_cannot_take",
        "test_without_the_lifespan_late_messages_are_delivered",
        "test_zenoh_waits_for_a_full_link_when_it_is_reliable",
    ),
    "late_relays": ("test_a_ping_that_waits_for_both_relays_has_no_late_one",),
    "udp_buffer_overflow": (
        "test_tuned_sockets_drop_less",
        "test_tuned_receive_buffers_help_on_a_link_slower_than_the_burst",
    ),
    "retransmission_storms": ("test_tuned_receive_buffers_end_a_storm_of_repeats",),
    "A host dropped IP fragments before they were sent": (
        "test_without_a_larger_send_buffer_the_own_queue_takes_the_burst",
    ),
    "several_networks": ("test_a_message_crosses_one_network_if_one_is_named",),
}
"""Check -> tests of `test_tried_cures.py`."""

NO_CURE = {
    # what the numbers mean, and to repeat the run
    *(
        "failed_bridges",
        "shared_cores",
        "ended_by_error",
        "recording_stopped",
        "A run has no end",
        "A run was stopped before its plan",
        "A run published nothing",
    ),
    *(
        "A run that may be going on has published nothing",
        "stand_stills",
        "clock_step",
        "suspend",
        "rising_latency",
        "two_modes",
        "impossible_times",
    ),
    *("falls_with_size", "jumps_with_size", "unlike_environments", "unlike_group_environments", "truncated_file"),
    *("nothing_received", "unreached", "settings_not_applied", "reader_note", "overlapping_pings", "unlike_versions"),
    # what to look for
    *(
        "forged_or_foreign",
        "other_sizes",
        "unnamed_relay",
        "doubtful_replies",
        "too_many_relays",
        "strangers",
        "duplicates",
        "reordering",
        "outage",
        "unlike_domains",
    ),
    *(
        "missing_publications",
        "orphan_events",
        "repeated_publications",
        "unreadable_messages",
        "An .mcap file was not used",
    ),
    # nothing to do, or the whole of a trace
    *(
        "skipped_files",
        "ring_recovered",
        "duplicate_file",
        "overlapping_files",
        "relay_trace_gaps",
        "The relay's trace lacks runs",
    ),
    *("undescribed_run", "undescribed_session", "undescribed_relay", "missing_files", "doubtful_sessions"),
    *("unclosed_session", "restarted_relays", "unrequested_relays", "groups_in_parts", "cases_not_compared"),
    *("loaded", "load_missing", "link_replayed", "calls"),
}


def messages(count=20, way_ns=MS):
    return [
        Message(s, t0=s * PERIOD, t1=s * PERIOD + 50, t3=s * PERIOD + way_ns, t4=s * PERIOD + way_ns + 20,
                t2=s * PERIOD + 2 * way_ns + 20 + s % 7)
        for s in range(count)
    ]  # fmt: skip


def described(sent, **changes):
    return run(planned_messages=len(sent), published=len(sent), **changes)


def pair(folder, sent=None, ping=None, relay=None, **changes):
    sent = messages() if sent is None else sent
    return write_pair(folder, sent, ping=ping or ping_session(), relay=relay or relay_session(),
                      runs=[described(sent, **changes)])  # fmt: skip


def few_samples(folder, cure=None):
    pair(folder, messages(20 if cure is None else int(cure[1].replace(",", ""))))


def short_warm_up(folder, cure=None):
    slow = [
        Message(m.sequence, t0=m.t0, t1=m.t1, t3=m.t3 + slow_ns, t4=m.t4 + slow_ns, t2=m.t2 + 2 * slow_ns)
        for m in messages(1000)
        for slow_ns in [(9 if m.sequence < 40 else 0) * MS + (m.sequence * 7919 % 1000) * 100]
    ]
    warmup = 0 if cure is None else int(cure[1])
    pair(folder, slow, warmup_messages=warmup)


def all_warm_up(folder, cure=None):
    pair(folder, messages(20), warmup_messages=20 if cure is None else 5)


def without_ping(folder, cure=None):
    pair(folder)
    other = {"run_id": 77, "relay_id": 9}
    write_trace(folder / "other.mcap", relay_session(session_id=9, relay_id=9), (), relay_events(messages(), **other))
    if cure is not None:
        of_ping = described(messages(), run_id=77, extra={"session_id": f"{8:016x}"})
        write_trace(folder / "its_ping.mcap", ping_session(session_id=8), [of_ping], ping_events(messages(), **other))


def without_relay_trace(folder, cure=None):
    _, relay = pair(folder)
    if cure is None:
        relay.unlink()


def without_relay(folder, cure=None):
    sent = messages()
    if cure is None:
        only = {Stage.T1: ping_events(sent)[Stage.T1]}
        write_trace(folder / "ping.mcap", ping_session(), [described(sent)], only)
    else:
        pair(folder, sent)


def without_schedule(folder, cure=None):
    sent = messages() if cure else [Message(m.sequence, t0=0, t1=m.t1, t3=m.t3, t4=m.t4, t2=m.t2) for m in messages()]
    pair(folder, sent)


def other_sizes(folder, cure=None):
    ping = ping_events(messages())
    if cure is None:
        ping[Stage.T1] = [
            event(m.sequence, m.t1, scheduled_ns=m.t0, payload_bytes=33_000 + m.sequence) for m in messages()
        ]
    write_trace(folder / "ping.mcap", ping_session(), [described(messages())], ping)
    write_trace(folder / "relay.mcap", relay_session(), (), relay_events(messages()))


def called_wireless(folder, cure=None):
    sessions = {
        "connectivity": "wireless" if cure is None else "loopback",
        "device": "alpha",
        "extra": {"boot_id": "one"},
    }
    pair(folder, ping=ping_session(**sessions), relay=relay_session(**sessions))


SITUATIONS = {
    "few_samples": (few_samples, r"at least ([\d,]+) messages"),
    "short_warm_up": (short_warm_up, r"-o warmup=(\d+)"),
    "nothing_counted": (all_warm_up, "more messages than warm-up"),
    "orphan_relay_events": (without_ping, "Copy the ping's trace"),
    "The relay's trace is missing": (without_relay_trace, "Copy the relay's trace"),
    "no_relay": (without_relay, "Start the relay first"),
    "missing_schedule": (without_schedule, "Record T0"),
    "unlike_payloads": (other_sizes, "each size a run of its own"),
    "wireless_on_one_machine": (called_wireless, "-o connectivity=loopback"),
}
"""Check -> what makes the situation, and the cured one for a match of the cure; and the cure in its words."""


@pytest.mark.parametrize("name", SITUATIONS)
def test_a_cure_that_takes_no_middleware_helps(tmp_path, name):
    make, words = SITUATIONS[name]
    (check,) = [check for check in all_checks() if name_of(check) == name]
    (tmp_path / "before").mkdir()
    (tmp_path / "after").mkdir()
    make(tmp_path / "before")
    (finding, *_) = [found for found in analyze(tmp_path / "before").findings if found.code == check.code]
    cure = re.search(words, finding.action)
    assert cure, finding.action
    make(tmp_path / "after", cure)
    assert check.code not in {found.code for found in analyze(tmp_path / "after").findings}


def test_an_analysis_without_a_sketch_has_exact_percentiles(tmp_path):
    pair(tmp_path)
    (finding,) = [found for found in analyze(tmp_path, sketch=True).findings if found.code == "sketched"]
    assert "without --sketch" in finding.action
    assert "sketched" not in {found.code for found in analyze(tmp_path).findings}


TRIED_HERE = {*SITUATIONS, "sketched"}
TRIED_ELSEWHERE = {
    "recorded_in_sequence": "tests/analyzer/verdicts/test_answers.py",
    "mixed_labels": "tests/analyzer/findings/test_findings.py",
    "stale_rows": "tests/analyzer/test_details.py",
}


@pytest.mark.parametrize("check", [*all_checks()], ids=lambda check: f"{check.code}-{name_of(check)}")
def test_every_cure_was_tried_or_says_that_it_may_help(check):
    name = name_of(check)
    is_tried = name in TRIED_HERE or name in TRIED_ELSEWHERE or name in TRIED_WITH_MIDDLEWARE
    assert is_tried + ("may help" in check.action) + (name in NO_CURE) == 1


def test_the_tests_of_cures_exist():
    text = Path(__file__).with_name("test_tried_cures.py").read_text()
    names = [name for tests in TRIED_WITH_MIDDLEWARE.values() for name in tests]
    assert [name for name in names if f"def {name}(" not in text] == []
    assert {name_of(check) for check in all_checks()} >= {
        *NO_CURE,
        *TRIED_HERE,
        *TRIED_ELSEWHERE,
        *TRIED_WITH_MIDDLEWARE,
    }
