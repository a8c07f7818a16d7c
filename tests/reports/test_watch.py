"""`dds-analyze watch` over a real loopback server and a folder that grows."""

import signal
import subprocess
import sys
import urllib.error
import urllib.request

import pytest
from campaigns import write_runs

from cli.watch import Watcher
from tracefile.errors import OutputError

# No proxy of the surroundings may stand between the test and its own server.
OPENER = urllib.request.build_opener(urllib.request.ProxyHandler({}))


def fetch(address, **headers):
    return OPENER.open(urllib.request.Request(address, headers=headers), timeout=30)


@pytest.fixture
def watcher(tmp_path):
    one = Watcher(tmp_path)
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
    assert b"location.reload()" in page
    assert watcher.refresh() is False, "nothing changed"
    with pytest.raises(urllib.error.HTTPError) as unchanged:
        fetch(watcher.address, **{"If-None-Match": first.headers["ETag"]})
    assert unchanged.value.code == 304
    unchanged.value.close()
    write_runs(tmp_path, [2])
    assert watcher.refresh() is True
    assert b"in 2 runs," in fetch(watcher.address, **{"If-None-Match": first.headers["ETag"]}).read()


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
        Watcher(tmp_path, port=port)


def test_the_command_ends_with_ctrl_c(tmp_path):
    write_runs(tmp_path, [1])
    command = [sys.executable, "-m", "cli.analyze", "watch", str(tmp_path), "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        line = process.stdout.readline()
        assert line.startswith("Serving http://127.0.0.1:")
        fetch(line.split()[1]).close()
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (0, "Stopped\n", "")
