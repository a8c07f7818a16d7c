import json
import math

import pytest

from dds_trace.reports.text import (
    format_bytes,
    format_bytes_per_s,
    format_count,
    format_hz,
    format_ns,
    format_ratio,
    format_size,
    json_island,
    markdown,
    visible,
)


@pytest.mark.parametrize(
    ("value_ns", "shown"),
    [
        (0, "0 ns"),
        (7, "7 ns"),
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
    assert format_ns(value_ns) == shown


@pytest.mark.parametrize(
    ("payload_bytes", "shown"),
    [
        (0, "0 B"),
        (4, "4 B"),
        (296, "296 B"),
        (1024, "1 KiB"),
        (1405, "1405 B"),
        (33_000, "33 KB"),
        (1_500_000, "1.5 MB"),
        (4_000_000, "4 MB"),
        (4 << 20, "4 MiB"),
        (520_001, "520001 B"),
    ],
)
def test_sizes_are_exact(payload_bytes, shown):
    assert format_size(payload_bytes) == shown


@pytest.mark.parametrize(
    ("ratio", "shown"),
    [
        (1.0, "100 %"),
        (0.999_99, "> 99.99 %"),
        (0.9967, "99.67 %"),
        (0.5, "50 %"),
        (0.000_04, "< 0.01 %"),
        (0.0, "0 %"),
        (None, "-"),
    ],
)
def test_percent_is_whole_only_where_it_is_exact(ratio, shown):
    assert format_ratio(ratio) == shown


def test_other_units():
    assert format_bytes(1_654_321) == "1.65 MB"
    assert format_bytes_per_s(330_000.0) == "330 KB/s"
    assert format_bytes_per_s(None) == "-"
    assert format_hz(10.0) == "10 Hz"
    assert format_hz(0.5) == "0.5 Hz"
    assert format_count(12_000) == "12,000"
    assert format_count(None) == "-"


def test_invisible_characters_are_spelled_out():
    assert visible("\x1b[31mred\x07") == r"\x1b[31mred\x07"
    assert visible("a\u2028b\u202ec\n") == r"a\u2028b\u202ec\x0a"
    assert visible("Zürich → 東京 µs") == "Zürich → 東京 µs"
    assert visible("\ud800") == r"\ud800"


def test_a_label_of_any_length_stays_a_label():
    assert len(visible("x" * 10**6)) == 300


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("plain words, 33 KB (median)", "plain words, 33 KB (median)"),
        ("a|b`c`", "a&#124;b&#96;c&#96;"),
        ("**d**", "&#42;&#42;d&#42;&#42;"),
        ("<script>", "&#60;script&#62;"),
        ("@team #1", "@<!-- -->team #<!-- -->1"),
        ("[x](http://a.invalid)", "&#91;x&#93;(http&#58;//a.invalid)"),
        ("www.a.invalid", "www&#46;a.invalid"),
        ("keep_last 10", "keep&#95;last 10"),
        ("two\nlines", "two&#92;x0alines"),
    ],
)
def test_markdown_reads_no_syntax(text, shown):
    assert markdown(text) == shown


def test_an_island_cannot_end_its_element():
    value = {"a": "</script><!--\u2028&", "b": [None, 1.5, "\ud800"]}
    text = json_island(value)
    assert not set("<>&\u2028\u2029") & set(text)
    assert json.loads(text) == value


def test_an_island_holds_no_nan():
    with pytest.raises(ValueError, match="Out of range"):
        json_island(math.nan)
