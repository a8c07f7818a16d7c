"""Sizes: one way to read them, one to write them for people, one to write them into names of files."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dds_trace.base.errors import OptionError
from dds_trace.base.units.sizes import format_size, parse_size, spell_size


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
