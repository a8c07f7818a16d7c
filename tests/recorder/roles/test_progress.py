from __future__ import annotations

import pytest

from dds_trace.recorder.roles.progress import Replies, Silence


def sent(*publish_ns):
    replies = Replies(len(publish_ns))
    for sequence, t1_ns in enumerate(publish_ns):
        replies.publish_ns[sequence] = t1_ns
    return replies


def test_before_any_reply():
    replies = sent(1000, 2000)
    assert (replies.received, replies.highest, replies.last_ns, replies.longest_rtt_ns) == (0, -1, 0, 0)
    assert replies.percentiles_ns() == (None, None)
    assert not replies.are_complete(2)
    assert replies.are_complete(0)  # nothing was sent, nothing is missing


def test_the_first_reply_to_a_message_makes_its_round_trip():
    replies = sent(1000, 2000, 3000)
    replies.note(2, 7, 3400)
    replies.note(0, 7, 3500)
    replies.note(0, 8, 9000)  # of another relay, later
    assert (replies.received, replies.highest) == (2, 2)
    assert (replies.last_ns, replies.longest_rtt_ns) == (9000, 2500)
    assert replies.percentiles_ns() == (400, 2500)


def test_it_is_complete_when_every_relay_that_answered_has_answered_all():
    replies = sent(1000, 2000)
    replies.note(0, 7, 1100)
    replies.note(0, 7, 1200)  # once more: one answer still
    assert not replies.are_complete(2)
    replies.note(1, 7, 2100)
    assert replies.are_complete(2)
    replies.note(1, 8, 2200)
    assert not replies.are_complete(2)


SECOND_NS = 1_000_000_000


@pytest.mark.parametrize(
    ("messages", "seconds", "before", "answered", "is_lasting"),
    [
        (0, 60, 100, 100, False),  # the last message was answered
        (100, 2.9, 100, 100, False),  # too short
        (4, 4, 100, 100, True),  # not one of 100 was lost before
        (2, 4, 100, 100, False),  # two in a row may be chance
        (10, 10, 100, 10, False),  # 90 % lost: ten in a row are nothing special
        (150, 10, 100, 10, True),
        (10, 10, 0, 0, False),  # nothing was answered, and not much was sent
        (20, 10, 0, 0, True),
    ],
)
def test_a_silence_is_lasting_if_the_losses_before_it_do_not_explain_it(
    messages, seconds, before, answered, is_lasting
):
    assert Silence(messages, int(seconds * SECOND_NS), before, answered).is_lasting is is_lasting


def test_a_round_trip_within_a_step_of_the_clock_counts_once():
    replies = sent(1000, 2000)
    replies.note(0, 7, 1000)
    replies.note(0, 8, 1004)
    assert (replies.received, replies.received_before(1), replies.percentiles_ns()) == (1, 1, (0, 0))
