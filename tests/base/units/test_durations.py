"""Durations: one way to read them, one to write them for people, one to write them for the command line."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dds_trace.base.errors import OptionError
from dds_trace.base.units.durations import format_duration, format_ms, parse_duration, spell_duration


@pytest.mark.parametrize(
    ("text", "duration_ns"),
    [
        ("20ms", 20_000_000),
        ("1.5s", 1_500_000_000),
        ("500 us", 500_000),
        ("500 µs", 500_000),
        ("7ns", 7),
        (".5MS", 500_000),
    ],
)
def test_a_duration_is_read(text, duration_ns):
    assert parse_duration(text) == duration_ns


@pytest.mark.parametrize("text", ["", "20", "0s", "-1s", "1h", "1e3s", "99999999999s"])
def test_what_is_no_duration_is_named(text):
    with pytest.raises(OptionError, match=rf"--deadline '{text}' is not understood"):
        parse_duration(text, "--deadline")


def test_what_is_far_too_long_is_named_in_one_short_line():
    with pytest.raises(OptionError, match=r"--deadline '9{78}… is not understood"):
        parse_duration("9" * 400 + "s", "--deadline")


@given(st.integers(1, 10**15))
def test_a_spelled_duration_is_read_back(duration_ns):
    assert parse_duration(spell_duration(duration_ns)) == duration_ns


def test_a_duration_is_spelled_in_the_largest_unit_that_it_fills():
    assert [spell_duration(ns) for ns in (7, 20_000_000, 1_500_000_000)] == ["7ns", "20ms", "1.5s"]


@pytest.mark.parametrize(
    ("value_ns", "shown"),
    [
        (0, "0 ns"),
        (812, "812 ns"),
        (1_000, "1 µs"),
        (999_400, "999 µs"),
        (999_600, "1 ms"),
        (1_254_000, "1.25 ms"),
        (12_540_000, "12.5 ms"),
        (125_400_000, "125 ms"),
        (61_000_000_000, "61 s"),
        (-383_000, "-383 µs"),
        (None, "-"),
        (math.nan, "-"),
        (math.inf, "-"),
    ],
)
def test_durations_have_three_digits_and_a_unit(value_ns, shown):
    assert format_duration(value_ns) == shown


@pytest.mark.parametrize(
    ("value_ns", "unit", "shown"),
    [(815_000, "ms", "0.815 ms"), (1_230_000_000, "ms", "1230 ms"), (30, "us", "0.03 us"), (None, "ms", "-")],
)
def test_a_column_may_keep_to_one_unit(value_ns, unit, shown):
    assert format_duration(value_ns, unit) == shown


def test_milliseconds_have_three_decimals():
    assert [format_ms(ns) for ns in (1_250_000, 0, -499, 1.5e9)] == ["1.250", "0.000", "-0.000", "1500.000"]
