"""No statistic changes unseen: what each said of drawn campaigns when it was written (`tests/support/pinned.py`)."""

from __future__ import annotations

from pinned import assert_pinned


def test_every_statistic_says_of_drawn_campaigns_what_it_said():
    assert_pinned("statistics")
