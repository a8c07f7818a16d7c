"""The one codec of `std_msgs/msg/String`."""

from __future__ import annotations

import pytest

from dds_trace.tracefile.format.encoding import decode_string, encode_string


def test_a_text_is_little_endian_with_a_nul():
    assert encode_string("ab") == b"\x00\x01\x00\x00\x03\x00\x00\x00ab\x00"
    assert decode_string(encode_string("Zürich")) == "Zürich"
    assert decode_string(encode_string("")) == ""


def test_either_byte_order_is_read_and_padding_ignored():
    assert decode_string(b"\x00\x00\x00\x00\x00\x00\x00\x03ab\x00") == "ab"
    assert decode_string(memoryview(encode_string("ab") + b"\0\0")) == "ab"


@pytest.mark.parametrize(
    "data",
    [b"", b"\x00\x01\x00\x00\x01", encode_string("")[:-1], b"\x00\x07" + encode_string("a")[2:], bytes(9)],
)
def test_what_is_no_string_is_an_error(data):
    with pytest.raises(ValueError, match="no serialized std_msgs/msg/String"):
        decode_string(data)


def test_what_is_no_utf8_is_an_error():
    with pytest.raises(ValueError, match="no UTF-8 text"):
        decode_string(encode_string("ab").replace(b"a", b"\xff"))
