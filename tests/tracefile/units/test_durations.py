"""Durations as people write them."""

from __future__ import annotations

import pytest

from dds_trace.tracefile import OptionError
from dds_trace.tracefile.units.durations import format_duration, parse_duration


@pytest.mark.parametrize(
    ("text", "duration_ns"),
    [("20ms", 20_000_000), ("1.5s", 1_500_000_000), ("500 us", 500_000), ("7ns", 7)],
)
def test_a_duration_is_read_and_written(text, duration_ns):
    assert parse_duration(text) == duration_ns
    assert parse_duration(format_duration(duration_ns)) == duration_ns


@pytest.mark.parametrize("text", ["", "20", "0s", "-1s", "1h", "1e3s", "99999999999s"])
def test_no_duration(text):
    with pytest.raises(OptionError, match="is not understood"):
        parse_duration(text)
