from dataclasses import replace

import pytest
from analyses import EVERY_ANALYSIS, MS, Measured, make_analysis

from dds_trace import Source
from dds_trace.reports.book.recording import MOST_ROWS, record_tables, setting_words


@pytest.fixture
def analysis():
    return make_analysis(Measured([MS]))


def test_sessions_that_are_alike_are_one_row(analysis):
    ping, relay = analysis.sessions
    again = [
        replace(ping, session_id=n, dropped_events=n, host={**ping.host, "wifi": {"wlan0": {"signal_dbm": -n}}})
        for n in (1, 2)
    ]
    elsewhere = replace(ping, session_id=3, host={**ping.host, "kernel": "6.8"}, state="open")
    sessions, _ = record_tables(replace(analysis, sessions=(ping, relay, *again, elsewhere)))
    assert (sessions.title, sessions.count, sessions.left_out) == ("Recording sessions", 5, 0)
    shown = [(row[0], row[1], *row[7:10]) for row in sessions.rows]
    assert shown == [
        ("pi-one", "ping", "3", "3", "clean"),
        ("pi-two", "relay", "1", "0", "clean"),
        ("pi-one", "ping", "1", "0", "cut off"),
    ]
    assert sessions.rows[2][-1].endswith("kernel 6.8")


def test_what_a_process_was_seen_to_use_stands_beside_its_host(analysis, sentences):
    sockets = [{"protocol": "udp", "receive_buffer_bytes": size} for size in (212_992, 8_000_000)]
    applied = {"path": "lo", "begin": {"sockets": sockets}}
    ping, relay = analysis.sessions
    sessions, _ = record_tables(
        replace(
            analysis,
            sessions=(
                replace(ping, extra={"applied": applied}),
                replace(relay, extra={"applied": {"path": "shm", "begin": {"sockets": []}}}),
            ),
        )
    )
    of_ping, of_relay = (row[-1] for row in sessions.rows)
    assert "carried by lo" in of_ping
    assert of_ping.endswith(" 8,000,000 B")
    assert of_relay.endswith("payload carried by shared memory")
    sentences(of_ping, of_relay)


def test_of_many_files_those_that_were_not_read_come_first(analysis):
    sources = [Source(f"{n}.mcap", "read", "", 5) for n in range(MOST_ROWS + 10)]
    sources.append(Source("notes.txt", "skipped", "no trace", 0))
    _, files = record_tables(replace(analysis, sources=tuple(sources)))
    assert files.rows[0] == ("notes.txt", "skipped", "0", "no trace")
    assert (files.count, len(files.rows), files.left_out) == (MOST_ROWS + 11, MOST_ROWS, 11)


def test_nothing_recorded_has_no_table():
    assert record_tables(make_analysis()) == ()


def test_settings_show_no_xml_and_nothing_empty():
    analysis = EVERY_ANALYSIS["small campaign"]()
    session = analysis.sessions[0]
    settings = {"CYCLONEDDS_URI": "<CycloneDDS/>", "connect": ""}
    shown = replace(session, host={**session.host, "middleware": settings})
    assert "configuration in XML; connect none" in setting_words(replace(analysis, sessions=(shown,)))
