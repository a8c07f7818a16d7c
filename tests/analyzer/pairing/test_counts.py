"""Counts of an exchange, drawn by hand."""

from dataclasses import replace

import numpy as np
import pytest
from record_reader import columns
from trace_files import event, run

from dds_trace.analyzer.model.runs import MOST_MESSAGES
from dds_trace.analyzer.pairing.counts import COUNT_SCHEMA, count_all, count_messages
from dds_trace.analyzer.pairing.pair import MISSING, Published, pair_messages, published_messages
from dds_trace.analyzer.pairing.roundtrips import count_unsent, settled
from dds_trace.tracefile.format.events import EventColumns


def count(t1, t2=(), t3=(), t4=(), *, warmup=0, scheduled=True, **more):
    published = published_messages(
        columns(*(event(s, t, scheduled_ns=t - 1 if scheduled else 0) for s, t in t1)), warmup
    )
    others = (columns(*(event(s, t) for s, t in of_stage)) for of_stage in (t2, t3, t4))
    return count_messages(published, pair_messages(published, *others), **more)


def test_every_kind_of_message_is_counted_once():
    counts = count(
        t1=[(s, 1000 + s) for s in range(7)],  # message 0 is warm-up
        t3=[(1, 50), (2, 60), (3, 70), (5, 80)],
        t4=[(1, 55), (2, 68), (5, 80)],
        t2=[(1, 1011), (5, 1205), (5, 1300), (6, 1100), (99, 1), (0, 1)],
        warmup=1,
    )
    assert counts == {
        "published": 6,
        "received": 3,  # 1, 5, 6
        "lost_outbound": 1,  # 4
        "lost_in_relay": 1,  # 3
        "lost_return": 1,  # 2
        "lost_unknown": 0,
        "duplicates": 1,
        "duplicated": 1,
        "second_source": 0,
        "unclear": 1,  # 5: no stamp says who sent its second reply
        "reordered": 1,  # 5 came after 6
        "relay_gaps": 1,  # 6 came back, but the relay never saw it
        "early": 0,
        "unscheduled": 0,
        "negative_rtt": 0,
        "negative_intermediate": 0,
        "negative_latency": 0,
        "publish_span_ns": 5,
        "relay_span_ns": 30,  # first T3 50, last T4 80
        "reply_span_ns": 194,  # 1011 to 1205
        "relayed": 4,
        "sent": 6,
        "reached": 4,
        "replied": 3,
        "orphans": 1,  # 99
        "with_warmup": 7,
        "repeated": 0,
        "least_payload_bytes": 33_000,
        "most_payload_bytes": 33_000,
        "unsent": 0,
        "in_flight": 0,
        "absent": 0,
        "outlived": 0,
        "longest_gap_ns": 0,
    }
    of_sizes = ["resized", "least_reply_bytes", "most_reply_bytes"]
    assert [*counts, *of_sizes] == list(COUNT_SCHEMA)


@pytest.mark.parametrize("held", [0, 1, 2, 5], ids=lambda held: f"{held} in hand")
@pytest.mark.parametrize("stalls", [1, 3])
def test_what_left_while_a_receiver_stood_still_outlived_the_history(stalls, held):
    """Messages that it had in hand as it stopped are stamped as it goes on, so that losses lie between close arrivals."""
    period, kept, lost = 10, 10, 80
    sent = [(sequence, sequence * period) for sequence in range(stalls * (100 + kept + lost) + held)]
    arrivals = {sequence: time + 3 for sequence, time in sent}
    for stall in range(stalls):
        begin = stall * (100 + kept + lost) + 50
        ends = sent[begin + held + lost + kept - 1][1]
        for sequence in range(begin, begin + held + lost + kept):
            arrivals[sequence] = ends
        for sequence in range(begin + held, begin + held + lost):
            del arrivals[sequence]
    counts = count(sent, t3=list(arrivals.items()), history_ns=kept * period)
    assert counts["outlived"] == stalls * lost
    assert counts["longest_gap_ns"] == ends - sent[begin - 1][1] - 3


def test_a_reply_that_the_relay_saw_only_once_is_a_gap():
    """It has no intermediate time either, so none below zero."""
    only_in = count([(0, 100)], [(0, 200)], t3=[(0, 50)])
    only_out = count([(0, 100)], [(0, 200)], t4=[(0, 50)])
    for counts in (only_in, only_out):
        assert counts["relay_gaps"] == 1
        assert (counts["negative_intermediate"], counts["negative_latency"]) == (0, 0)


def test_the_least_and_the_most_payload_are_told():
    published = published_messages(columns(event(0, 10, payload_bytes=3), event(1, 20, payload_bytes=9)), 0)
    counts = count_messages(published, pair_messages(published, columns(), columns(), columns()))
    assert (counts["least_payload_bytes"], counts["most_payload_bytes"]) == (3, 9)


def test_times_below_zero_are_counted():
    # rtt 90 - 100 = -10; intermediate 40 - 50 = -10; latency (200 - 100 - (350 - 50)) // 2 = -100.
    assert count([(0, 100)], [(0, 90)])["negative_rtt"] == 1
    assert count([(0, 100)], [(0, 190)], [(0, 50)], [(0, 40)])["negative_intermediate"] == 1
    assert count([(0, 100)], [(0, 200)], [(0, 50)], [(0, 350)])["negative_latency"] == 1
    fine = count([(0, 100)], [(0, 200)], [(0, 50)], [(0, 150)])  # latency 0
    at_once = count([(0, 100)], [(0, 100)], [(0, 50)], [(0, 50)])  # all three 0
    for counts in (fine, at_once):
        assert [counts[f"negative_{metric}"] for metric in ("rtt", "intermediate", "latency")] == [0, 0, 0]


def test_a_run_that_is_all_warmup_has_zeros_and_no_spans():
    counts = count([(0, 100), (1, 200)], [(1, 300)], warmup=2)
    spans = [name for name in counts if name.endswith("_span_ns")]
    assert [counts[name] for name in spans] == [None] * 3
    assert {counts[name] for name in ("published", "received", "relay_gaps", "unscheduled")} == {0}
    assert counts["with_warmup"] == 2


@pytest.mark.filterwarnings("error")
def test_stamps_that_are_damage_wrap_in_silence():
    far = 2**63 - 1
    assert count([(0, -far), (1, far)])["publish_span_ns"] == -2  # 2 * far, modulo 2 ** 64


def test_without_a_schedule_every_message_is_unscheduled():
    assert count([(0, 100), (1, 200)], scheduled=False)["unscheduled"] == 2


def test_of_a_run_with_every_other_message_pinged_all_messages_count_for_the_throughput():
    t1, t3 = (
        columns(*(event(s, 10 * s) for s in range(1, 8))),
        columns(*(event(s, 1000 + 10 * s) for s in (0, 2, 3, 4, 7))),
    )
    published = published_messages(t1, 2, 2)
    assert published.sequence.tolist() == [2, 4, 6]
    assert published.with_warmup == 7
    assert count_all(t1, t3, 2) == {"sent": 6, "reached": 4, "publish_span_ns": 50, "relay_span_ns": 50}


MS = 1_000_000


def published(count):
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
