from dataclasses import replace

import pytest
from analyses import EVERY_ANALYSIS, MS, Measured, make_analysis
from campaigns import write_runs

from dds_trace import Source, analyze
from dds_trace.reports.blocks import plain_text
from dds_trace.reports.book.book import Book
from dds_trace.reports.book.groups import groups_info
from dds_trace.reports.book.recording import MOST_ROWS, discovery_words, file_table, recorded_environment, setting_words
from dds_trace.reports.html import page


@pytest.fixture
def analysis():
    return make_analysis(Measured([MS]))


def cells_of(fold):
    return [row.cells for row in fold.blocks[0].rows]


def test_a_column_counts_its_sessions_and_what_they_dropped(analysis):
    ping, relay = analysis.sessions
    again = replace(ping, session_id=1, dropped_events=3, state="open")
    columns, rows = rows_of(replace(analysis, sessions=(ping, relay, again)))
    assert columns == ["pi-one (ping)", "pi-two (relay)"]
    values = [rows["Sessions", name][0] for name in ("sessions", "dropped events", "end")]
    assert values == [("2", "1"), ("3", "0"), ("clean or cut off", "clean")]


def test_what_a_process_was_seen_to_use_is_next_to_its_settings(analysis):
    sockets = [{"protocol": "udp", "receive_buffer_bytes": size} for size in (212_992, 8_000_000)]
    ping, relay = analysis.sessions
    sides = (
        replace(ping, extra={"applied": {"path": "lo", "begin": {"sockets": sockets}}}),
        replace(relay, extra={"applied": {"path": "shm", "begin": {"sockets": []}}}),
    )
    _, rows = rows_of(replace(analysis, sessions=sides))
    assert rows["Seen in use", "payload carried by"] == (("lo", "shared memory"), True)
    assert rows["Seen in use", "UDP receive buffer (bytes)"][0][0] == "8,000,000"


def test_of_many_files_those_that_were_not_read_come_first(analysis):
    sources = [Source(f"{n}.mcap", "read", "", 5) for n in range(MOST_ROWS + 10)]
    sources.append(Source("notes.txt", "skipped", "no trace", 0))
    (files,) = file_table(replace(analysis, sources=tuple(sources)))
    assert tuple(cells_of(files)[0]) == ("notes.txt", "skipped", "0", "no trace")
    assert (files.summary, len(cells_of(files))) == (f"Files ({MOST_ROWS + 11})", MOST_ROWS)
    assert files.blocks[1].words.startswith("11 more rows")
    assert [*file_table(make_analysis())] == []


def test_settings_show_no_xml_and_nothing_empty():
    analysis = EVERY_ANALYSIS["small campaign"]()
    session = analysis.sessions[0]
    settings = {"CYCLONEDDS_URI": "<CycloneDDS/>", "connect": ""}
    shown = replace(session, host={**session.host, "middleware": settings})
    assert "configuration in XML; connect none" in setting_words(replace(analysis, sessions=(shown,)))


def test_what_nodes_send_at_rest_is_one_part_for_each_number_and_version(analysis, sentences):
    def session(number, met_s, version):
        nodes = {"number": number, "met_s": met_s, "packets_per_second": 2 * number, "bytes_per_second": 1500 * number}
        known = analysis.sessions[0]
        return replace(known, vendor="fastdds", host={"versions": {"fastdds": version}}, extra={"nodes": nodes})

    measured = [session(10, met_s, "2.14.5") for met_s in (0.1, 0.9, 0.2)] + [session(50, 2.0, "3.2.3")]
    sentences(discovery_words(measured))
    assert "not all met" in discovery_words([session(50, None, "3.2.3")])
    assert discovery_words(analysis.sessions) == ""


def test_every_run_has_its_beginning_and_what_came_back(tmp_path):
    write_runs(tmp_path, [1, 2])
    analysis = analyze(tmp_path)
    runs = Book(analysis).run_times
    assert [(run.run_id, run.group) for run in runs] == [(8, 0), (9, 0)]
    rows = analysis.load_roundtrips()
    for run in runs:
        own = rows.filter(run_id=run.run_id)
        assert (run.published, run.received) == (own.height, own.filter(outcome="completed").height)
        assert run.origin_ns == own["scheduled_ns"].fill_null(own["publish_ns"]).min()
        assert run.last_ns == own["publish_ns"].max()
        assert run.p50_ns == round(own["latency_ns"].median())
        assert run.max_ns == own["latency_ns"].max()


def rows_of(analysis):
    _, table = recorded_environment(analysis, groups_info(analysis))
    return [column.name for column in table.columns[1:]], {
        (row.part, plain_text(row.cells[0]).removeprefix("≠ ")): (
            tuple(row.cells[1:]),
            plain_text(row.cells[0]).startswith("≠"),
        )
        for row in table.rows
    }


def test_settings_stand_in_rows_and_unlike_ones_are_marked():
    analysis = make_analysis(Measured([MS, 2 * MS]))
    ping, relay = sorted(analysis.sessions[:2], key=lambda one: one.role)
    host = {
        "kernel": "6.1",
        "memory_bytes": 8_000_000_000,
        "kernel_realtime": False,
        "versions": {"rclpy": "7.1.6"},
        "socket_buffers": {"net.core.rmem_max": 212_992},
        "middleware": {"transport": "default"},
        "wifi": {"wlan0": -50},
        "board": None,
    }
    other = {**host, "kernel": "6.6", "socket_buffers": {"net.core.rmem_max": 4_194_304}}
    columns, rows = rows_of(
        replace(
            analysis,
            sessions=(
                replace(ping, device="a", role="ping", host=host),
                replace(ping, device="a", role="ping", host={**host, "versions": {"rclpy": "7.1.7"}}),
                replace(relay, device="b", role="relay", host=other),
            ),
        )
    )
    assert columns == ["a (ping)", "b (relay)"]
    assert rows["Machine", "kernel"] == (("6.1", "6.6"), True)
    assert rows["Machine", "memory (bytes)"] == (("8,000,000,000",) * 2, False)
    assert rows["Machine", "realtime kernel"] == (("no", "no"), False)
    assert rows["Versions", "rclpy"] == (("7.1.6 or 7.1.7", "7.1.6"), True)
    assert rows["Limits of socket buffers (bytes)", "net.core.rmem_max"] == (("212,992", "4,194,304"), True)
    assert rows["Settings of the middleware", "transport"] == (("default", "default"), False)
    assert ("Machine", "board") not in rows
    assert not any("wlan0" in name for _, name in rows)


def test_the_page_marks_them_and_a_campaign_without_sessions_has_no_table():
    analysis = make_analysis(Measured([MS, 2 * MS]))
    assert recorded_environment(replace(analysis, sessions=()), groups_info(analysis)) == ()
    first, *others = analysis.sessions
    unlike = replace(analysis, sessions=(replace(first, host={**first.host, "kernel": "0.1"}), *others))
    shown = page.render(Book(unlike))
    assert '<th scope="row"><span class="unlike">≠ </span>kernel</th>' in shown
    assert "≠ </span>backend" not in shown
