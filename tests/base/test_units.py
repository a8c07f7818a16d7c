import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dds_trace.base.errors import OptionError
from dds_trace.base.units import (
    by_number,
    counted,
    format_duration,
    format_rate,
    format_size,
    parse_duration,
    parse_rate,
    parse_size,
    spell_duration,
    spell_size,
)


@pytest.mark.parametrize(("count", "text"), [(0, "0 messages"), (1, "1 message"), (16_000, "16,000 messages")])
def test_a_noun_takes_an_s_unless_the_count_is_one(count, text):
    assert counted(count, "message") == text


@pytest.mark.parametrize(("count", "text"), [(1, "1 reply is late"), (3, "3 replies are late")])
def test_a_noun_with_a_plural_of_its_own_brings_its_verb(count, text):
    assert counted(count, "reply is late", "replies are late") == text


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
    [(815_000, "ms", "0.815 ms"), (1_230_000_000, "ms", "1230 ms"), (30, "µs", "0.03 µs"), (None, "ms", "-")],
)
def test_a_column_may_keep_to_one_unit(value_ns, unit, shown):
    assert format_duration(value_ns, unit) == shown


@pytest.mark.parametrize(("text", "rate_hz"), [("20", 20.0), ("2.5Hz", 2.5), ("1 kHz", 1000.0), (".5hz", 0.5)])
def test_rates(text, rate_hz):
    assert parse_rate(text) == rate_hz


@pytest.mark.parametrize("text", ["", "0", "-1", "20ms", "1e3", "Hz"])
def test_what_is_no_rate_is_named(text):
    with pytest.raises(OptionError, match=f"rate '{text}' is not understood"):
        parse_rate(text)


@pytest.mark.parametrize(("rate_hz", "shown"), [(10.0, "10 Hz"), (0.5, "0.5 Hz"), (1500.0, "1500 Hz"), (None, "-")])
def test_rates_have_three_digits(rate_hz, shown):
    assert format_rate(rate_hz) == shown


@pytest.mark.parametrize(
    ("text", "size_bytes"),
    [
        ("4", 4),
        ("33KB", 33_000),
        ("4MB", 4_000_000),
        ("1KiB", 1024),
        ("2 MiB", 2 * 1024 * 1024),
        ("1.5kb", 1500),
        (".5KB", 500),
        ("12B", 12),
        ("1GB", 10**9),
    ],
)
def test_sizes(text, size_bytes):
    assert parse_size(text) == size_bytes


@pytest.mark.parametrize(
    "text", ["", "KB", "3KQ", "-4", "1e3", "0x10", "1.5", "4 MB x", "\u0663KB\n!", "4%", "9" * 400]
)
def test_what_is_no_size_is_named(text):
    with pytest.raises(OptionError, match="size"):
        parse_size(text)


@given(st.integers(0, 2**40))
def test_what_is_written_reads_back(size_bytes):
    assert parse_size(format_size(size_bytes)) == size_bytes
    assert parse_size(spell_size(size_bytes)) == size_bytes


@pytest.mark.parametrize(
    ("payload_bytes", "shown", "spelled"),
    [
        (0, "0 B", "0B"),
        (4, "4 B", "4B"),
        (296, "296 B", "296B"),
        (1024, "1 KiB", "1024B"),
        (1405, "1405 B", "1405B"),
        (33_000, "33 KB", "33KB"),
        (123_400, "123.4 KB", "123400B"),
        (1_500_000, "1.5 MB", "1500KB"),
        (4_000_000, "4 MB", "4MB"),
        (4 << 20, "4 MiB", "4194304B"),
        (520_001, "520001 B", "520001B"),
    ],
)
def test_sizes_are_exact(payload_bytes, shown, spelled):
    assert format_size(payload_bytes) == shown
    assert spell_size(payload_bytes) == spelled


def test_numbers_within_texts_sort_as_numbers():
    texts = ["", "link=lte", "link=lte,outage=0.3s", "link=lte,outage=2s", "link=lte,outage=12s", "robot 9", "robot 10"]
    assert sorted(set(texts), key=by_number) == texts
