"""Counts with their nouns."""

from __future__ import annotations

import pytest

from dds_trace.base.units.counts import counted


@pytest.mark.parametrize(("count", "text"), [(0, "0 messages"), (1, "1 message"), (2, "2 messages")])
def test_a_noun_takes_an_s_unless_the_count_is_one(count, text):
    assert counted(count, "message") == text


@pytest.mark.parametrize(
    ("count", "text"),
    [(1, "1 reply is late"), (3, "3 replies are late")],
)
def test_a_noun_with_a_plural_of_its_own_brings_its_verb(count, text):
    assert counted(count, "reply is late", "replies are late") == text


def test_a_count_that_is_already_formatted_is_printed_as_it_is():
    assert counted(16_000, "event", text="16,000") == "16,000 events"
    assert counted(1, "event", text="1") == "1 event"
