"""Rates: one way to read them, one to write them."""

from __future__ import annotations

import pytest

from dds_trace.base.errors import OptionError
from dds_trace.base.units.rates import format_rate, parse_rate


@pytest.mark.parametrize(
    ("text", "rate_hz"), [("20", 20.0), ("2.5Hz", 2.5), ("1 kHz", 1000.0), (".5hz", 0.5)]
)
def test_rates(text, rate_hz):
    assert parse_rate(text) == rate_hz


@pytest.mark.parametrize("text", ["", "0", "-1", "20ms", "1e3", "Hz"])
def test_what_is_no_rate_is_named(text):
    with pytest.raises(OptionError, match=f"rate '{text}' is not understood"):
        parse_rate(text)


@pytest.mark.parametrize(
    ("rate_hz", "shown"), [(10.0, "10 Hz"), (0.5, "0.5 Hz"), (1500.0, "1500 Hz"), (None, "-")]
)
def test_rates_have_three_digits(rate_hz, shown):
    assert format_rate(rate_hz) == shown
