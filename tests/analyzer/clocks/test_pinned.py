"""No fit changes unseen: what each said of drawn clocks when it was written (`tests/support/pinned.py`)."""

from __future__ import annotations

from pinned import assert_pinned


def test_fits_say_of_drawn_clocks_what_they_said():
    assert_pinned("clocks", "clocks")
