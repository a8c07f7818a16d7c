from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from trace_files import run

from dds_trace.analyzer.model.runs import MOST_MESSAGES
from dds_trace.analyzer.pairing.pair import MISSING, Published
from dds_trace.analyzer.pairing.roundtrips import count_unsent, settled
from dds_trace.tracefile.format.events import EventColumns

MS = 1_000_000


def published(count):
    """Messages 0, 1, 2 ... sent on time, one each 100 ms."""
    at_ns = np.arange(count, dtype=np.int64) * 100 * MS
    return Published(np.arange(count, dtype=np.uint64), at_ns, at_ns, 0, count, 0, (1, 1))


def replies(*at_ns):
    zeros = np.zeros(len(at_ns), np.int64)
    return EventColumns(
        run_id=zeros.astype(np.uint64),
        sequence=np.array([sequence for sequence, _ in at_ns], np.uint64),
        monotonic_ns=np.array([ns for _, ns in at_ns], np.int64),
        scheduled_ns=zeros,
        source_ns=zeros,
        received_ns=zeros,
        payload_bytes=zeros.astype(np.uint32),
        relay_id=zeros.astype(np.uint32),
    )


@pytest.mark.parametrize(
    ("ended_ns", "planned", "unsent"),
    [
        (450 * MS, 100, 0),  # T0 of 0 ... 4 had passed, and all five left
        (1250 * MS, 100, 8),  # T0 of 5 ... 12 had passed as well
        (1250 * MS, 7, 2),  # the plan ends at 6
    ],
)
def test_messages_that_were_due_when_the_run_ended(ended_ns, planned, unsent):
    described = run(
        rate_hz=10.0, planned_messages=planned, warmup_messages=0, published=5, extra={"ended_ns": ended_ns}
    )
    assert count_unsent(described, published(5), replies()) == unsent


def test_what_a_live_topic_skipped_never_left():
    assert count_unsent(run(extra={"skipped_messages": 3}), published(5), replies()) == 3


def test_a_killed_ping_does_not_know_the_fate_of_its_last_messages():
    # Replies to 0, 1, 3 after 150 ms at most; the last event is T2 of 3 at 450 ms. 2 (200 ms) is lost, 4 (400 ms) is open.
    t2 = replies((0, 150 * MS), (1, 150 * MS), (3, 450 * MS))
    killed = run(state="started")
    assert settled(killed, published(5), t2).tolist() == [True, True, True, True, False]
    assert settled(run(), published(5), t2).all()


def test_the_last_message_of_a_killed_ping_may_never_have_left():
    # T2 of 3 comes 200 ms behind T1 of 4, longer than any reply took: 4 would count as lost, were it not the last.
    t2 = replies((0, 150 * MS), (1, 250 * MS), (2, 350 * MS), (3, 450 * MS), (3, 600 * MS))
    assert settled(run(state="started"), published(5), t2).tolist() == [True, True, True, True, False]
    t2 = replies((0, 150 * MS), (4, 500 * MS))  # answered, so it left; 1, 2 and 3 are lost
    assert settled(run(state="started"), published(5), t2).tolist() == [True, True, True, True, True]


def late(count, *, by_ns):
    """`published`, so much later on the clock."""
    whole = published(count)
    return replace(whole, scheduled_ns=whole.scheduled_ns + by_ns, publish_ns=whole.publish_ns + by_ns)


@pytest.mark.parametrize(("skipped", "unsent"), [(0, 0), (-3, 0), (2**60, MOST_MESSAGES)])
def test_skipped_messages_are_counted_within_reason(skipped, unsent):
    assert count_unsent(run(extra={"skipped_messages": skipped}), published(5), replies()) == unsent


def test_without_a_plan_nothing_was_due():
    ten_s = {"rate_hz": 10.0, "planned_messages": 100, "warmup_messages": 0, "published": 5}
    ended = {"ended_ns": 10_000 * MS}
    assert count_unsent(run(**ten_s, extra=ended), published(5), replies()) == 95
    assert count_unsent(run(**ten_s, extra=ended), published(0), replies()) == 0
    assert count_unsent(run(**{**ten_s, "rate_hz": 0.0}, extra=ended), published(5), replies()) == 0
    assert count_unsent(run(**{**ten_s, "rate_hz": 1.0}, extra=ended), published(5), replies()) == 6
    assert count_unsent(run(**ten_s, extra={**ended, "data_source": "topic:/a"}), published(5), replies()) == 0
    unknown = replace(published(5), scheduled_ns=np.full(5, MISSING))
    assert count_unsent(run(**ten_s, extra=ended), unknown, replies()) == 0
    # 40 s after boot: from T0 of the first, not from zero; the run ended at its last T1 if it does not tell.
    shifted = late(5, by_ns=40_000 * MS)
    assert count_unsent(run(**ten_s, extra={"ended_ns": 41_250 * MS}), shifted, replies()) == 8
    assert count_unsent(run(**ten_s), shifted, replies()) == 0
    assert count_unsent(run(**ten_s), shifted, replies((0, 41_250 * MS))) == 8


def test_a_ping_that_died_does_not_say_how_many_left():
    died = run(rate_hz=10.0, planned_messages=100, warmup_messages=0, published=0, extra={"ended_ns": 1250 * MS})
    assert count_unsent(died, published(5), replies()) == 8


def test_a_killed_ping_without_a_reply_waited_two_seconds():
    # 0 ... 30 in three seconds: those of the first one would have been given up.
    known = settled(run(state="started"), published(31), replies())
    assert known.tolist() == [True] * 11 + [False] * 20
