import struct
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dds_trace.recorder.payloads import data_types
from dds_trace.recorder.payloads.stamp import (
    CALL_STAMP,
    HEADER_STAMP,
    NO_REPLY,
    PROBE_RUN_ID,
    RAW_HEADER_STAMP,
    RAW_STRING_STAMP,
    STAMP_BYTES,
    STRING_STAMP,
    RawStampPlace,
    Stamp,
    parse_stamp,
    stamp_text,
)

UINT64 = st.integers(0, 2**64 - 1)
UINT32 = st.integers(0, 2**32 - 1)
TEXT = b"dt1:0123456789abcdef:0000000000000102:deadbeef"


def header_message(frame_id):
    return b"\0\1\0\0" + struct.pack("<iII", 7, 8, len(frame_id) + 1) + frame_id + b"\0" + b"\x2a"


def test_text_is_what_the_format_page_says():
    assert stamp_text(0x0123456789ABCDEF, 0x102, 0xDEADBEEF) == TEXT
    assert len(TEXT) == STAMP_BYTES == 46
    assert (PROBE_RUN_ID, NO_REPLY) == (0, 0xFFFFFFFF)


@given(UINT64, UINT64, UINT32)
def test_every_stamp_is_46_characters_and_reads_back(run_id, sequence, relay_id):
    text = stamp_text(run_id, sequence, relay_id)
    assert len(text) == 46
    assert parse_stamp(text) == parse_stamp(text.decode()) == Stamp(run_id, sequence, relay_id)


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"map",
        TEXT[:-1],
        TEXT + b"0",
        b"dt2" + TEXT[3:],
        TEXT.replace(b"f", b"g"),
        TEXT.replace(b":0000", b":zzzz"),
    ],
)
def test_text_of_others_is_no_stamp(text):
    assert parse_stamp(text) is None


def write_time(place, message, wall_ns):
    place.write_nanoseconds(message, wall_ns - place.write_second(message, wall_ns - 5))


@pytest.mark.parametrize(
    ("nanoseconds", "written"),
    [(0, (8, 0)), (999_999_999, (8, 999_999_999)), (1_000_000_000, (9, 0)), (2_500_000_001, (10, 500_000_001))],
)
def test_a_second_that_ends_between_its_writing_and_the_stamp(nanoseconds, written):
    raw, header = bytearray(64), SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=77))
    for place, message in ((RAW_HEADER_STAMP, raw), (HEADER_STAMP, SimpleNamespace(header=header))):
        assert place.write_second(message, 8_999_999_999) == 8_000_000_000
        place.write_nanoseconds(message, nanoseconds)
    assert struct.unpack_from("<iI", raw, 4) == written
    assert (header.stamp.sec, header.stamp.nanosec) == written


def test_stamp_and_time_are_written_in_place():
    message = bytearray(header_message(bytes(46)))
    length = len(message)
    RAW_HEADER_STAMP.write(message, 0x0123456789ABCDEF, 0x102)
    write_time(RAW_HEADER_STAMP, message, 1_700_000_000_000_000_042)
    assert len(message) == length
    assert message[4:12] == struct.pack("<iI", 1_700_000_000, 42)
    assert message[16:62] == TEXT[:38] + b"00000000"
    assert RAW_HEADER_STAMP.read(message) == (0x0123456789ABCDEF, 0x102, 0)
    assert message[-1] == 0x2A


@pytest.mark.parametrize(("end", "begin"), [(67, 67), (64, 64), (62, 62)])
def test_the_begin_of_a_message_that_is_like_another(end, begin):
    """From the length of the string that the stamp begins, four bytes before it, to where it is asked for."""
    message = header_message(stamp_text(0x0123456789ABCDEF, 7, 0)) + b"payload"
    next_one = header_message(stamp_text(0x0123456789ABCDEF, 8, 0)) + b"payload"
    assert RAW_HEADER_STAMP.begin_at == 12
    assert RAW_HEADER_STAMP.begin_of(message, 0x0123456789ABCDEF, 8, end) == next_one[12:begin]


@pytest.mark.parametrize("digit", [1, 1 << 60])
def test_runs_that_take_turns_are_told_apart(digit):
    """A place remembers the last run that it read; one digit, the first or the last, is another run."""
    place = RawStampPlace(16, 4)
    for number in range(6):
        run_id = (0x0123456789ABCDEF + digit * (number % 2)) % 2**64
        message = header_message(stamp_text(run_id, 0x102 + number, 0xDEADBEEF))
        for _ in range(2):
            assert place.read(message) == Stamp(run_id, 0x102 + number, 0xDEADBEEF)
        for damaged in (message[:-3], message.replace(b":0000", b":zzzz"), message.replace(b"dt1", b"dt2")):
            assert place.read(damaged) is None


def test_a_reply_differs_in_the_relay_alone():
    received = header_message(TEXT)
    reply = RAW_HEADER_STAMP.reply(received, b"0000002a")
    assert received == header_message(TEXT)
    assert reply == header_message(TEXT[:38] + b"0000002a")
    assert RAW_HEADER_STAMP.reply(received[:62], b"0000002a") == reply[:62]


@pytest.mark.parametrize("message", [b"", b"\0\1\0\0", header_message(b"camera_frame"), header_message(b"x" * 46)])
def test_foreign_messages_are_left_alone(message):
    assert RAW_HEADER_STAMP.read(message) is None
    assert RAW_HEADER_STAMP.reply(message, b"0000002a") is None


def test_a_string_has_the_stamp_before_its_payload():
    message = bytearray(b"\0\1\0\0" + struct.pack("<I", 46 + 5 + 1) + bytes(46) + b"hello\0")
    RAW_STRING_STAMP.write(message, 1, 2)
    write_time(RAW_STRING_STAMP, message, 99)  # a String has none
    assert message[8:] == b"dt1:0000000000000001:0000000000000002:00000000hello\0"
    assert RAW_STRING_STAMP.reply(message, b"00000007")[8:] == (
        b"dt1:0000000000000001:0000000000000002:00000007hello\0"
    )


def test_message_objects_carry_the_same_stamp():
    header = SimpleNamespace(frame_id="", stamp=SimpleNamespace(sec=0, nanosec=0))
    image, text, call = SimpleNamespace(header=header), SimpleNamespace(data="." * 46 + "hello"), SimpleNamespace()
    for place, message in ((HEADER_STAMP, image), (STRING_STAMP, text), (CALL_STAMP, call)):
        place.write(message, 1, 2)
        write_time(place, message, 3_000_000_004)
        assert place.read(message) == (1, 2, 0)
        assert place.reply(message, b"00000007") is message
        assert place.read(message) == (1, 2, 7)
    assert (header.stamp.sec, header.stamp.nanosec) == (3, 4)
    assert text.data.endswith(":00000007hello")
    assert HEADER_STAMP.reply(SimpleNamespace(header=SimpleNamespace(frame_id="map")), b"00000007") is None
    assert STRING_STAMP.reply(SimpleNamespace(data="hi"), b"00000007") is None


def test_every_payload_has_room_for_the_stamp_at_its_place():
    for data_type in data_types().values():
        message = data_type.make(None, 1).messages[0].data
        assert message.find(b"dt1:") == (8 if data_type.name == "string" else 16)
        assert data_type.raw.stamp.read(message) == (0, 0, 0)
