"""Pairing, drawn by hand: every outcome, duplicates, order, warm-up, and numbers that no ping would send."""

import numpy as np
import pytest
from record_reader import columns
from trace_files import event

from dds_trace.analyzer.pairing.pair import MISSING, OUTCOMES, Outcome, pair_messages, published_messages


def pair(t1, t2=(), t3=(), t4=(), warmup=0):
    published = published_messages(columns(*(event(s, t, scheduled_ns=t) for s, t in t1)), warmup)
    return published, pair_messages(published, *(columns(*(event(s, t) for s, t in e)) for e in (t2, t3, t4)))


def outcomes(paired):
    return [OUTCOMES[code] for code in paired.outcome.tolist()]


def test_every_outcome_follows_from_where_a_message_was_seen_last():
    published, paired = pair(
        t1=[(0, 1000), (1, 2000), (2, 3000), (3, 4000)],
        t3=[(0, 50), (2, 70), (3, 80)],
        t4=[(0, 55), (3, 88)],
        t2=[(0, 1200)],
    )
    assert published.sequence.tolist() == [0, 1, 2, 3]
    assert outcomes(paired) == [Outcome.COMPLETED, Outcome.LOST_OUTBOUND, Outcome.LOST_IN_RELAY, Outcome.LOST_RETURN]
    assert paired.receive_ns.tolist() == [1200, MISSING, MISSING, MISSING]
    assert paired.relay_in_ns.tolist() == [50, MISSING, 70, 80]
    assert paired.relay_out_ns.tolist() == [55, MISSING, MISSING, 88]
    assert paired.duplicates.tolist() == [0, 0, 0, 0]
    assert paired.orphans == 0


def test_a_loss_is_unknown_only_without_any_event_of_the_relay():
    _, without = pair(t1=[(0, 10), (1, 20)], t2=[(0, 15)])
    assert outcomes(without) == [Outcome.COMPLETED, Outcome.LOST_UNKNOWN]
    # The relay's trace is there, though all it holds of this run is a warm-up message.
    _, with_warmup = pair(t1=[(0, 10), (1, 20), (2, 30)], t2=[(1, 25)], t3=[(0, 1)], t4=[(0, 2)], warmup=1)
    assert outcomes(with_warmup) == [Outcome.COMPLETED, Outcome.LOST_OUTBOUND]
    for only in ("t3", "t4"):  # one event of it is enough
        _, one = pair(t1=[(0, 10), (1, 20)], warmup=1, **{only: [(0, 1)]})
        assert outcomes(one) == [Outcome.LOST_OUTBOUND]


def test_a_departure_without_arrival_was_not_lost_on_the_way_out():
    _, paired = pair(t1=[(0, 10)], t4=[(0, 7)])
    assert outcomes(paired) == [Outcome.LOST_RETURN]


def test_warmup_messages_have_no_row_and_are_no_orphans():
    published, paired = pair(t1=[(0, 10), (1, 20), (2, 30), (3, 40)], t2=[(0, 11), (1, 21), (2, 31), (3, 41)], warmup=2)
    assert published.sequence.tolist() == [2, 3]
    assert published.publish_ns.tolist() == [30, 40]
    assert paired.receive_ns.tolist() == [31, 41]
    assert paired.orphans == 0


def test_the_first_number_behind_the_warmup_is_an_orphan_without_its_t1():
    published, paired = pair(t1=[(0, 10), (3, 40)], t2=[(0, 11), (1, 21), (2, 31)], warmup=2)
    assert published.sequence.tolist() == [3]
    assert paired.orphans == 1


def test_a_run_of_warmup_only_has_no_rows():
    published, paired = pair(t1=[(0, 10), (1, 20)], t2=[(0, 11)], warmup=5)
    assert len(published) == 0
    assert published.rows(np.array([0, 5], np.uint64)).tolist() == [-1, -1]
    assert paired.receive_ns.tolist() == []
    assert paired.reordered.tolist() == []


@pytest.mark.parametrize(
    ("sizes", "told"), [((), (2**32 - 1, 0)), ((0,), (0, 0)), ((7, 3, 9), (3, 9)), ((2**32 - 1,), (2**32 - 1,) * 2)]
)
def test_the_range_of_payloads_is_that_of_all_publications(sizes, told):
    t1 = columns(*(event(s, 10 * s, payload_bytes=size) for s, size in enumerate(sizes)))
    assert published_messages(t1, 1).payload_range_bytes == told


@pytest.mark.parametrize("sequences", [(3, 4, 5, 6), (3, 4, 6), (3, 4, 7), (3, 5, 9), (3, 5, 7, 9), (3,), (2, 2**63)])
def test_each_message_has_the_row_that_a_search_finds_and_no_other_number_has_one(sequences):
    """Also where one, two or three T1 are missing, and the numbers are not those of the rows."""
    published, _ = pair(t1=[(each, 10 + row) for row, each in enumerate(sequences)], warmup=1)
    asked = sorted({0, 1, 2, *(each + apart for each in sequences for apart in (-1, 0, 1)), 2**64 - 1})
    expected = [sequences.index(each) if each in sequences else -1 for each in asked]
    assert published.rows(np.array(asked, np.uint64)).tolist() == expected


def test_the_earliest_of_several_replies_counts():
    _, paired = pair(t1=[(0, 10), (1, 20), (2, 30)], t2=[(1, 29), (0, 18), (1, 25), (1, 27), (2, 34)])
    assert paired.receive_ns.tolist() == [18, 25, 34]
    assert paired.duplicates.tolist() == [0, 2, 0]


def test_the_earliest_of_several_replies_counts_where_most_messages_have_none():
    _, paired = pair(t1=[(s, 10 * s) for s in range(9)], t2=[(3, 35), (3, 38)])
    assert paired.receive_ns.tolist() == [MISSING] * 3 + [35] + [MISSING] * 5
    assert paired.duplicates.tolist() == [0, 0, 0, 1, 0, 0, 0, 0, 0]


def test_the_same_reply_recorded_twice_is_one_reply():
    _, paired = pair(t1=[(0, 10)], t2=[(0, 18), (0, 18)])
    assert paired.receive_ns.tolist() == [18]
    assert paired.duplicates.tolist() == [0]


def test_duplicates_stop_at_what_the_column_holds():
    _, paired = pair(t1=[(0, 10)], t2=[(0, 18 + n) for n in range(70_000)])
    assert paired.duplicates.tolist() == [65_535]


def test_repeated_arrivals_and_departures_count_once():
    _, paired = pair(t1=[(0, 10)], t2=[(0, 90)], t3=[(0, 40), (0, 44)], t4=[(0, 46), (0, 42)])
    assert paired.relay_in_ns.tolist() == [40]
    assert paired.relay_out_ns.tolist() == [42]
    assert paired.duplicates.tolist() == [0]


def test_reordered_is_who_came_after_a_later_one():
    #  sequence  0    1    2    3    4        1 came after 2; 3 was lost; 4 came after nobody later
    _, paired = pair(t1=[(0, 0), (1, 10), (2, 20), (3, 30), (4, 40)], t2=[(0, 100), (2, 110), (1, 115), (4, 120)])
    assert paired.reordered.tolist() == [False, True, False, False, False]
    # 0 came last of all: only it is late, the others are in order among themselves.
    _, paired = pair(t1=[(0, 0), (1, 10), (2, 20)], t2=[(1, 50), (2, 60), (0, 70)])
    assert paired.reordered.tolist() == [True, False, False]
    # At the same instant is not after.
    _, paired = pair(t1=[(0, 0), (1, 10)], t2=[(0, 50), (1, 50)])
    assert paired.reordered.tolist() == [False, False]
    # The first one was lost, those behind it came back in turn.
    _, paired = pair(t1=[(0, 0), (1, 10), (2, 20)], t2=[(1, 50), (2, 60)])
    assert outcomes(paired) == [Outcome.LOST_UNKNOWN, Outcome.COMPLETED, Outcome.COMPLETED]
    assert paired.reordered.tolist() == [False] * 3


def test_events_of_messages_never_published_are_orphans():
    published, paired = pair(t1=[(0, 10), (2, 30)], t2=[(0, 15), (1, 25), (7, 80)], t3=[(1, 3)], t4=[(1, 4)])
    assert published.sequence.tolist() == [0, 2]
    assert paired.receive_ns.tolist() == [15, MISSING]
    assert paired.orphans == 4
    assert outcomes(paired) == [Outcome.COMPLETED, Outcome.LOST_OUTBOUND]


def test_messages_out_of_order_in_the_file_are_sorted():
    published, paired = pair(t1=[(2, 30), (0, 10), (1, 20)], t2=[(1, 26), (0, 16), (2, 36)])
    assert published.sequence.tolist() == [0, 1, 2]
    assert published.publish_ns.tolist() == [10, 20, 30]
    assert published.scheduled_ns.tolist() == [10, 20, 30]
    assert paired.receive_ns.tolist() == [16, 26, 36]


def test_a_message_published_twice_counts_from_the_first():
    published, paired = pair(t1=[(0, 10), (1, 22), (1, 20)], t2=[(1, 26)])
    assert published.publish_ns.tolist() == [10, 20]
    assert published.repeated == 1
    assert paired.receive_ns.tolist() == [MISSING, 26]


@pytest.mark.parametrize(
    "sequences",
    [
        [0, 1, 2**64 - 1],
        [2**63, 5, 2**40],
        [2**64 - 2, 2**64 - 1, 0],  # wrapped
        [2**64 - 3, 2**64 - 2, 2**64 - 1],
    ],
)
def test_absurd_sequence_numbers_cost_no_memory(sequences):
    published, paired = pair(
        t1=[(s, 10 * i) for i, s in enumerate(sequences)],
        t2=[(s, 10 * i + 1) for i, s in enumerate(sequences)] + [(77, 5)],
    )
    assert published.sequence.tolist() == sorted(sequences)
    assert (paired.receive_ns - published.publish_ns).tolist() == [1, 1, 1]
    assert paired.orphans == 1


def test_sequence_numbers_below_the_first_one_are_orphans():
    published, paired = pair(t1=[(5, 50), (6, 60)], t2=[(4, 1), (5, 55), (6, 66), (7, 77), (2**64 - 1, 3)])
    assert published.sequence.tolist() == [5, 6]
    assert paired.receive_ns.tolist() == [55, 66]
    assert paired.orphans == 3


def test_no_schedule_is_no_schedule_at_boot():
    published = published_messages(columns(event(0, 10), event(1, 20)), 0)
    assert published.scheduled_ns.tolist() == [MISSING, MISSING]
    # One zero among others is an instant like any other, and so is that of a single message.
    published = published_messages(columns(event(0, 10), event(1, 20, scheduled_ns=15)), 0)
    assert published.scheduled_ns.tolist() == [0, 15]
    assert published_messages(columns(event(0, 10)), 0).scheduled_ns.tolist() == [0]
