"""The ledger of a run: first replies make the round trip, second ones of a relay count as one."""

from __future__ import annotations

from dds_trace.recorder.roles.replies import Replies


def sent(*publish_ns):
    replies = Replies(len(publish_ns))
    for sequence, each_ns in enumerate(publish_ns):
        replies.publish_ns[sequence] = each_ns
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
