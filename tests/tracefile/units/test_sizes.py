"""Sizes as people write them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dds_trace.tracefile import OptionError
from dds_trace.tracefile.units.sizes import format_size, parse_size


@pytest.mark.parametrize(
    ("text", "size_bytes"),
    [
        ("4", 4),
        ("33KB", 33_000),
        ("4MB", 4_000_000),
        ("1KiB", 1024),
        ("2 MiB", 2 * 1024 * 1024),
        ("1.5kb", 1500),
        ("12B", 12),
        ("1GB", 10**9),
    ],
)
def test_sizes(text, size_bytes):
    assert parse_size(text) == size_bytes


@pytest.mark.parametrize("text", ["", "KB", "3KQ", "-4", "1e3", "0x10", "1.5", "4 MB x", "\u0663KB\n!"])
def test_what_is_no_size_is_named(text):
    with pytest.raises(OptionError, match="size"):
        parse_size(text)


@given(st.integers(0, 2**40))
def test_what_is_formatted_reads_back(size_bytes):
    assert parse_size(format_size(size_bytes).removesuffix("s").removesuffix(" byte")) == size_bytes
