import json
import math

import pytest

from dds_trace.reports.book.groups import format_count, format_ratio, markdown
from dds_trace.reports.html.page import json_island


@pytest.mark.parametrize(
    ("ratio", "shown"),
    [
        (1.0, "100 %"),
        (0.999_99, "> 99.99 %"),
        (0.9967, "99.67 %"),
        (0.5, "50 %"),
        (0.153_846, "15.4 %"),
        (0.001_234, "0.123 %"),
        (0.000_04, "< 0.01 %"),
        (0.0, "0 %"),
        (None, "-"),
    ],
)
def test_percent_is_whole_only_where_it_is_exact(ratio, shown):
    assert format_ratio(ratio) == shown


def test_counts_have_groups_of_three_digits():
    assert format_count(12_000) == "12,000"
    assert format_count(None) == "-"


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
