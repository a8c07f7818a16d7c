from dataclasses import replace

from analyses import MS, Measured, make_analysis

from dds_trace.reports.book.book import Book
from dds_trace.reports.html import page


def rows_of(analysis):
    environment = Book(analysis).environment
    return environment.columns, {
        (section, row.name): (row.values, row.unlike) for section, rows in environment.sections for row in rows
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
    assert columns == ("a (ping)", "b (relay)")
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
    assert Book(replace(analysis, sessions=())).environment is None
    first, *others = analysis.sessions
    unlike = replace(analysis, sessions=(replace(first, host={**first.host, "kernel": "0.1"}), *others))
    shown = page.render(Book(unlike))
    assert '<tr class="unlike"><th scope="row"><span aria-label="differs">≠</span> kernel</th>' in shown
    assert "≠</span> backend" not in shown
