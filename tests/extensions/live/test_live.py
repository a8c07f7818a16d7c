import json
import os
import signal
import socket
import struct
import subprocess
import sys
import urllib.error
import urllib.request

import pytest
from browser import violations
from campaigns import write_runs
from waiting import PATIENCE_S

import dds_trace.analyzer.loading.traces
from dds_trace.base.errors import OptionError, OutputError, TraceFormatError
from dds_trace.extensions.campaigns.run.state import SweepState
from dds_trace.extensions.live import live
from dds_trace.extensions.live.live import Watcher, WatchOptions
from dds_trace.extensions.live.local_server import is_own_name
from dds_trace.extensions.topics.live import Health, LiveRow
from dds_trace.extensions.topics.recording import serve_page

# No proxy of the surroundings may stand between the test and its own server.
OPENER = urllib.request.build_opener(urllib.request.ProxyHandler({}))


def fetch(address, **headers):
    return OPENER.open(urllib.request.Request(address, headers=headers), timeout=PATIENCE_S)


def version_of(watcher):
    return fetch(watcher.address + "version").read().decode()


@pytest.fixture
def watcher(tmp_path):
    one = Watcher(WatchOptions(tmp_path))
    with one.serving():
        yield one


def test_the_page_grows_with_the_folder(watcher, tmp_path):
    assert watcher.address.startswith("http://127.0.0.1:")
    assert watcher.refresh() is False
    assert b"No trace can be analyzed yet" in fetch(watcher.address).read()
    write_runs(tmp_path, [1])
    assert watcher.refresh() is True
    first = fetch(watcher.address)
    page = first.read()
    assert b"in 1 run," in page
    assert b"Content-Security-Policy" in page
    assert b"connect-src &#39;self&#39;" in page
    assert watcher.refresh() is False, "nothing changed"
    with pytest.raises(urllib.error.HTTPError) as unchanged:
        fetch(watcher.address, **{"If-None-Match": first.headers["ETag"]})
    assert unchanged.value.code == 304
    unchanged.value.close()
    write_runs(tmp_path, [2])
    assert watcher.refresh() is True
    assert b"in 2 runs," in fetch(watcher.address, **{"If-None-Match": first.headers["ETag"]}).read()


def test_the_version_changes_with_the_page_and_not_otherwise(watcher, tmp_path):
    waiting = version_of(watcher)
    write_runs(tmp_path, [1])
    watcher.refresh()
    one_run = version_of(watcher)
    assert f'<html lang="en" data-version="{one_run}">'.encode() in fetch(watcher.address).read()
    watcher.refresh()
    assert version_of(watcher) == one_run, "what the analysis itself wrote is no change"
    write_runs(tmp_path, [2])
    watcher.refresh()
    assert len({waiting, one_run, version_of(watcher)}) == 3


def test_of_a_folder_that_grew_only_new_traces_are_read(watcher, tmp_path, monkeypatch):
    read = []
    plain = dds_trace.analyzer.loading.traces.read_trace_in_pieces
    monkeypatch.setattr(
        dds_trace.analyzer.loading.traces,
        "read_trace_in_pieces",
        lambda path, take: read.append(path.name) or plain(path, take),
    )
    for number, expected in ((1, ["ping1.mcap", "relay1.mcap"]), (2, ["ping2.mcap", "relay2.mcap"])):
        read.clear()
        write_runs(tmp_path, [number])
        assert watcher.refresh() is True
        assert sorted(read) == expected
    assert (tmp_path / "analysis" / "summary.parquet").is_file()


def test_an_analysis_that_fails_is_shown_above_the_last_report(watcher, tmp_path, monkeypatch, capsys):
    write_runs(tmp_path, [1])
    watcher.refresh()
    before = version_of(watcher)

    def failing(*_, **__):
        raise ZeroDivisionError("<b>division</b>")

    with monkeypatch.context() as broken:
        broken.setattr(live, "analyze", failing)
        write_runs(tmp_path, [2])
        assert watcher.refresh() is False
    page = fetch(watcher.address).read().decode()
    assert "The latest analysis failed: ZeroDivisionError: &lt;b&gt;division&lt;/b&gt;" in page
    assert "in 1 run," in page
    assert version_of(watcher) != before
    assert f'data-version="{version_of(watcher)}"' in page
    assert "ZeroDivisionError" in capsys.readouterr().err
    write_runs(tmp_path, [3])
    assert watcher.refresh() is True
    page = fetch(watcher.address).read().decode()
    assert "The latest analysis failed" not in page
    assert "in 3 runs," in page


def test_a_first_analysis_that_fails_says_why(watcher, tmp_path):
    (tmp_path / "broken.mcap").write_bytes(b"no trace <at all>")
    assert watcher.refresh() is False
    page = fetch(watcher.address).read().decode()
    assert "no trace here: looked at broken.mcap" in page
    assert f'data-version="{version_of(watcher)}"' in page
    assert "fetch(" in page


@pytest.mark.browser
def test_a_phone_in_the_dark_waits_for_the_first_trace_without_loading_again(read_with, watcher):
    one = read_with(color_scheme="dark", viewport={"width": 390, "height": 800})
    one.tab.goto(watcher.address)
    assert one.tab.evaluate("document.documentElement.dataset.theme") == "dark"
    assert (
        one.tab.evaluate("lookForNewer().then(() => performance.getEntriesByType('navigation')[0].type)") == "navigate"
    )
    assert one.tab.evaluate("document.documentElement.scrollWidth") == 390
    assert violations(one.tab, "document") == []
    assert one.complaints == []


@pytest.mark.parametrize(
    ("asked", "bound", "is_own"),
    [
        ("127.0.0.1:8765", "127.0.0.1", True),
        ("localhost:8765", "127.0.0.1", True),
        ("LOCALHOST", "127.0.0.1", True),
        ("127.8.8.8", "127.0.0.1", True),
        ("[::1]:8765", "127.0.0.1", True),
        ("evil.example:8765", "127.0.0.1", False),
        ("localhost.evil.example", "127.0.0.1", False),
        ("192.168.1.5:8765", "127.0.0.1", False),
        ("", "127.0.0.1", False),
        ("192.168.1.5:8765", "192.168.1.5", True),
        ("192.168.1.6:8765", "192.168.1.5", False),
        ("pi.local:8765", "pi.local", True),
        ("192.168.1.5:8765", "0.0.0.0", True),
        ("[fe80::1]:8765", "::", True),
        ("evil.example", "0.0.0.0", False),
    ],
)
def test_names_of_the_server(asked, bound, is_own):
    assert is_own_name(asked, bound) is is_own


def test_a_page_under_a_name_of_somebody_else_is_refused(watcher):
    for path in ("", "version"):
        with pytest.raises(urllib.error.HTTPError) as refused:
            fetch(watcher.address + path, Host="evil.example")
        assert refused.value.code == 421
        refused.value.close()


def test_nothing_but_the_page_is_served(watcher, tmp_path):
    (tmp_path / "secret.txt").write_text("x")
    for path in ("secret.txt", "../secret.txt", "%2e%2e/secret.txt"):
        with pytest.raises(urllib.error.HTTPError) as refused:
            fetch(watcher.address + path)
        assert refused.value.code == 404
        refused.value.close()


def test_a_taken_port_is_an_output_error(watcher, tmp_path):
    port = int(watcher.address.rstrip("/").rsplit(":", 1)[1])
    with pytest.raises(OutputError, match="choose another --port"):
        Watcher(WatchOptions(tmp_path), port=port)


def test_the_command_ends_with_ctrl_c(tmp_path):
    write_runs(tmp_path, [1])
    command = [sys.executable, "-m", "dds_trace.cli.dds_analyze", "watch", str(tmp_path), "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        line = process.stdout.readline()
        assert line.startswith("Serving http://127.0.0.1:")
        fetch(line.split()[1]).close()
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, out, err) == (0, "Stopped\n", "")


def test_a_tab_that_is_closed_while_it_is_answered_is_no_error(tmp_path, capfd):
    one = Watcher(WatchOptions(tmp_path))
    one._server.daemon_threads = False  # so that the answers have ended when `serving` does
    one.shown = live.Shown(b"x" * (64 << 20), "1")  # more than the kernel's buffers hold
    with one.serving(), socket.create_connection(one._server.server_address) as tab:
        tab.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # closed by a reset
        tab.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert tab.recv(1)
    assert capfd.readouterr().err == ""


def test_the_status_tells_how_far_the_sweeps_are(watcher, tmp_path):
    def status():
        return json.loads(fetch(watcher.address + "status").read())

    assert status() == {"version": "", "words": "", "done": 0, "planned": 0, "age_s": None, "left_s": 0.0}
    cells = {"a": {"status": "complete"}, "b": {"status": "recorded"}, "c": {"status": "running"}}
    for name, left_s in (("one", 600), ("two", 60)):
        (tmp_path / name).mkdir()
        state = {"cells": cells, "planned": 5, "left_s": left_s}
        (tmp_path / name / "state.json").write_text(json.dumps(state))
    (tmp_path / "state.json").write_text("[]")
    (tmp_path / "pipe").mkdir()
    os.mkfifo(tmp_path / "pipe" / "state.json")
    told = status()
    assert (told["done"], told["planned"]) == (4, 10)
    assert 0 <= told["age_s"] < 60
    assert 540 <= told["left_s"] <= 660
    assert live.SweepStatus(4, 10, 3.0, 370.0).words.split(", ")[1:] == ["3 s ago", "about 6 min left"]
    assert live.SweepStatus(10, 10, 3.0).words == "10 of 10, complete"


def test_an_update_travels_without_plotly(watcher, tmp_path):
    write_runs(tmp_path, [1])
    watcher.refresh()
    whole, update = (fetch(watcher.address + path).read() for path in ("", "update"))
    assert len(update) < len(whole) - 1_900_000
    assert b'data-packed="data"' in update


def test_what_a_sweep_is_recording_is_no_warning(watcher, tmp_path):
    write_runs(tmp_path, [1])
    (tmp_path / ".parts").mkdir()
    write_runs(tmp_path / "other", [3])
    cut = (tmp_path / "other" / "ping3.mcap").read_bytes()
    for path in (tmp_path / "other").iterdir():
        path.unlink()
    (tmp_path / ".parts" / "b.ping.mcap").write_bytes(cut[: len(cut) // 2])
    watcher.refresh()
    assert b".parts/b.ping.mcap" in fetch(watcher.address).read().partition(b'id="recording-title"')[0]
    (tmp_path / "state.json").write_text(json.dumps({"cells": {}, "planned": 2, "left_s": 9}))
    write_runs(tmp_path, [2])
    watcher.refresh()
    assert b".parts/b.ping.mcap" not in fetch(watcher.address).read().partition(b'id="recording-title"')[0]


TOPICS = [
    LiveRow(
        "/robot_1/front_left_camera/image_raw/compressed", Health.OK, 29.9, 30.0, 12_000_000, 31_000_000, 3, 10_000_000
    ),
    LiveRow("/lidar", Health.STALE, 0.0, None, None, None, 0, None),
    LiveRow("/imu", Health.SLOW, 80.0, 100.0, 1_000_000, 2_000_000, 0, 9_000_000),
]


@pytest.mark.browser
@pytest.mark.parametrize(("scheme", "width"), [("light", 1000), ("dark", 390)])
def test_the_live_page_of_a_tap_is_read_on_a_phone_and_in_the_dark(read_with, scheme, width):
    with serve_page(0, lambda: TOPICS, "rover <7>") as address:
        one = read_with(color_scheme=scheme, viewport={"width": width, "height": 800})
        one.tab.goto(address)
        one.tab.wait_for_selector("tbody tr")
        assert one.tab.locator("h1").inner_text() == "Topics of rover <7>"
        assert [cell.inner_text() for cell in one.tab.locator("tbody th").all()] == [row.topic for row in TOPICS]
        assert one.tab.evaluate("document.documentElement.scrollWidth") == width
        assert one.tab.locator("tbody polyline").count() == len(TOPICS)
        one.tab.wait_for_function("document.querySelector('polyline').points.length > 1")
        assert one.tab.locator("thead th").count() == one.tab.locator("tbody tr").first.locator("th, td").count()
        assert violations(one.tab, "document") == []
        assert one.complaints == []
    one.tab.wait_for_selector("text=does not answer")


@pytest.mark.parametrize(
    "text",
    [
        '{"cells": {}, "planned": 1e400, "left_s": 9}',
        '{"cells": {}, "planned": 2, "left_s": 1e400}',
        '{"cells": {}, "planned": 2, "left_s": 1e308}',
        '{"cells": {}, "planned": -2, "left_s": 1}',
        '{"cells": {}, "planned": NaN, "left_s": 1}',
        '{"cells": {}, "planned": 2, "left_s": NaN}',
        '{"cells": ' + 100_000 * "[",
        '{"cells": ' + 5000 * '{"a":' + "1" + 5000 * "}" + ', "planned": 2, "left_s": 1}',
        '{"cells": {}, "planned": ' + 5000 * "9" + ', "left_s": 1}',
        '{"cells": {"a": 1}, "planned": 2, "left_s": 1}',
    ],
)
def test_a_state_that_no_sweep_wrote_has_an_answer(watcher, tmp_path, text):
    (tmp_path / "strange").mkdir()
    (tmp_path / "strange" / "state.json").write_text(text)
    (tmp_path / "state.json").write_text(json.dumps({"cells": {}, "planned": 2, "left_s": 9}))
    answer = json.loads(fetch(watcher.address + "status").read(), parse_constant=pytest.fail)
    assert answer["planned"] == 2
    with pytest.raises((TraceFormatError, OptionError)):
        SweepState(tmp_path / "strange" / "state.json", "strange", "0")


def test_a_watch_answers_to_the_names_of_its_machine(tmp_path, monkeypatch):
    monkeypatch.setattr("socket.gethostname", lambda: "Robot7.lab.example")
    one = Watcher(WatchOptions(tmp_path), "0.0.0.0", names=["desk.example"])
    address = one.address.replace("0.0.0.0", "127.0.0.1")
    with one.serving():
        for name in ("robot7", "robot7.lab.example:80", "Robot7.local", "robot7.local.", "desk.example", "192.168.1.5"):
            assert fetch(address + "version", Host=name).status == 200
        for name in ("robot8", "robot7.evil.example", "lab.example", ""):
            with pytest.raises(urllib.error.HTTPError) as refused:
                fetch(address + "version", Host=name)
            assert (refused.value.code, b"--name" in refused.value.read()) == (421, True)
            refused.value.close()
