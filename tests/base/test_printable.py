from __future__ import annotations

import pytest

from dds_trace.base.printable import printable


def test_invisible_characters_are_spelled_out():
    assert printable("\x1b[31mred\x07") == r"\x1b[31mred\x07"
    assert printable("a\u2028b\u202ec\n") == r"a\u2028b\u202ec\x0a"
    assert printable("Zürich → 東京 µs") == "Zürich → 東京 µs"
    assert printable("\ud800") == r"\ud800"


def test_a_label_of_any_length_stays_a_label():
    assert len(printable("x" * 10**6)) == 300


@pytest.mark.parametrize(
    "character", ["\n", "\r", "\x00", "\x1b", "\x7f", "\u2028", "\u202e", "\ud800", "\ufffe", "\U0010ffff"]
)
def test_nothing_is_left_that_steers_a_terminal_or_that_xml_forbids(character):
    assert character not in printable(f"a{character}b")
    assert printable(f"a{character}b").startswith("a\\")
