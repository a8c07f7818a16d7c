import json
from dataclasses import replace

import pytest

from dds_trace.extensions.topics.beacon import chrony_words
from dds_trace.extensions.topics.exchange import (
    MOST_DEVICES,
    MOST_LINES,
    MOST_WAITING,
    UNSENT_NOTE,
    ClockNote,
    Exchanges,
    parse_note,
)
from dds_trace.recorder.backends.other_side import Strangers
from dds_trace.tracefile.format.encoding import encode_string

MS = 1_000_000
NOTE = ClockNote("jetson", 7, 3, 9, 500 * MS, 501 * MS, 1000 * MS, "chrony: follows ntp1")


class Mail:
    def publish(self, message):
        self.message = message


def packed(note=NOTE):
    mail = Mail()
    note.publish(mail)
    return mail.message


def test_a_note_arrives_as_it_was_sent():
    assert parse_note(packed()) == NOTE


@pytest.mark.parametrize("reply_first", [True, False])
def test_reply_and_note_make_a_round_trip(reply_first, sentences):
    exchanges = Exchanges(Strangers())
    exchanges.run_ids.add(7)
    exchanges.note_sent(7, 3, 90 * MS)
    steps = [lambda: exchanges.note_reply(7, 3, 9, 101 * MS), lambda: exchanges.take_note(packed())]
    for step in steps if reply_first else reversed(steps):
        step()
    (line,) = exchanges.words(101 * MS, 400 * MS)
    # Other minus own: 400 to 410 ms monotonic, and 600 ms between the wall clocks' offsets.
    sentences(line)
    assert "1005.000 ms +- 5.0" in line


def test_notes_about_others_are_ignored():
    exchanges = Exchanges(Strangers())
    exchanges.take_note(packed())
    assert exchanges.words(0, 0) == []


def exchanged(*notes, forged=()):
    exchanges = Exchanges(Strangers())
    exchanges.run_ids.add(7)
    for note in forged:
        exchanges.take_note(packed(note))
    exchanges.note_sent(7, 3, 90 * MS)
    for note in notes:
        exchanges.take_note(packed(note))
    exchanges.note_reply(7, 3, 9, 101 * MS)
    return exchanges


MOVED = [
    replace(NOTE, wall_offset_ns=11_000 * MS),
    replace(NOTE, relay_in_ns=10_500 * MS, relay_out_ns=10_501 * MS),
    replace(NOTE, device="x"),
]


@pytest.mark.parametrize("moved", MOVED)
@pytest.mark.parametrize("is_late", [False, True])
def test_two_notes_about_one_message_are_somebody_elses(moved, is_late):
    exchanges = exchanged(NOTE, *([] if is_late else [moved]))
    if is_late:
        exchanges.take_note(packed(moved))
    exchanges.note_sent(7, 4, 190 * MS)
    exchanges.take_note(packed(replace(NOTE, sequence=4)))
    exchanges.note_reply(7, 4, 9, 201 * MS)
    (line,) = exchanges.words(201 * MS, 0)
    assert "somebody else" in line
    assert "+-" not in line


def test_a_note_about_a_message_that_was_not_sent_or_answered_counts_nothing():
    assert "+-" in exchanged(NOTE, NOTE).words(101 * MS, 0)[0]
    ahead = exchanged(NOTE, forged=MOVED)
    assert ahead.words(101 * MS, 400 * MS) == exchanged(NOTE).words(101 * MS, 400 * MS)
    assert ahead._strangers.counts == {UNSENT_NOTE: 3}
    invented = [replace(NOTE, relay_id=number, device=f"d{number}") for number in range(100, 5100)]
    assert len(exchanged(NOTE, *invented, NOTE).words(101 * MS, 0)) == 1


def test_memory_and_lines_are_bounded():
    exchanges = Exchanges(Strangers())
    exchanges.run_ids.add(7)
    for number in range(10 * MOST_WAITING):
        exchanges.note_sent(7, number, number)
        exchanges.take_note(packed(ClockNote("d", 7, number, number, 1, 2, 3, "")))
        exchanges.note_reply(7, number, number, number)
    assert len(exchanges.others) == MOST_DEVICES
    assert len(exchanges._sent) == len(exchanges._noted) == MOST_WAITING
    assert len(exchanges.words(0, 0)) == MOST_LINES + 1


TEXT = json.loads(packed()[8:-1])


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        "[" * 1000,
        *(json.dumps({name: value for name, value in TEXT.items() if name != left_out}) for left_out in TEXT),
        *(json.dumps({**TEXT, name: []}) for name in TEXT if name not in ("device", "time_service")),
        json.dumps({**TEXT, "relay_in_ns": 1 << 70}),
        json.dumps({**TEXT, "relay_id": -1}),
        json.dumps({**TEXT, "sequence": True}),
        json.dumps({**TEXT, "device": "x" * 5000}),
    ],
)
def test_what_is_no_note_is_none(text):
    assert parse_note(encode_string(text)) is None


@pytest.mark.parametrize("data", [b"", b"\0\1\0\0", b"\0\1\0\0\xff\xff\xff\xff", bytes(100)])
def test_bytes_that_are_no_string_are_no_note(data):
    assert parse_note(data) is None


def test_a_peer_writes_no_control_characters_on_the_terminal():
    note = parse_note(packed(ClockNote("\x1b[2J", 7, 3, 9, 1, 2, 3, "a\nb")))
    assert "\x1b" not in note.device
    assert "\n" not in note.time_service


@pytest.mark.parametrize(
    ("tracking", "start"),
    [
        (
            "C0A80001,ntp1.lan,3,1700000000.1,0.000123,-0.0001,0.0002,-12.3,0.001,0.01,0.002,0.003,64.2,Normal",
            "chrony: follows ntp1.lan, off by 0.123 ms",
        ),
        ("7F7F0101,,0,0,0,0,0,0,0,0,0,0,0,Not synchronised", "chrony: not synchronized"),
        ("", ""),
        ("506 Cannot talk to daemon", ""),
        (",".join(["x"] * 14), ""),
    ],
)
def test_what_chrony_says(tracking, start):
    words = chrony_words(tracking)
    assert words.startswith(start)
    assert bool(words) == bool(start)
