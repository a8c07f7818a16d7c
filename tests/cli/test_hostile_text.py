import csv
import json
import socket
from dataclasses import fields, replace
from xml.etree import ElementTree as ET

import pytest
from commands import run_main
from trace_files import TWELVE, ping_session, relay_session, run, write_pair

from dds_trace.base.printable import is_hidden
from dds_trace.base.streams import plain_streams
from dds_trace.cli.record.run import TerminalWatch
from dds_trace.extensions.campaigns.run.state import CellState, Status, SweepState
from dds_trace.extensions.service.command import _lines
from dds_trace.extensions.service.running import Entry, Listed, State
from dds_trace.extensions.service.upkeep import ServiceManager

HOSTILE = (
    "=HYPERLINK(1)\x1b]0;p\x07\x1b[2J\u202e\x9b31m\u2028\n::set-output name=a::b\r\n ::stop-commands::c\n##[error]d"
    "<script>alert(1)</script>[e](http://evil/f)![g](http://evil/h)\n- @i\x7f\ufeff"
)
KEPT = {"role", "state", "session_id", "run_id"}


def made_hostile(record, text=HOSTILE):
    """The record with every text field hostile that a trace may have as it likes."""
    for field in fields(record):
        if field.name not in KEPT and isinstance(getattr(record, field.name), str):
            changed = replace(record, **{field.name: text})
            try:
                type(record).from_json(changed.to_json(), "x")
            except Exception:  # noqa: BLE001 - a field with values of its own
                continue
            record = changed
    return record


@pytest.fixture
def hostile(tmp_path):
    extra = {
        "error": HOSTILE,
        "labels": {HOSTILE: HOSTILE},
        "settings": {HOSTILE: HOSTILE},
        "host": {HOSTILE: HOSTILE, "kernel": HOSTILE},
        "not_applied": [{"setting": "transport", "asked": HOSTILE, "applied": HOSTILE, "words": HOSTILE}],
    }
    for side, published in (("a", 12), ("b", 12)):
        described = made_hostile(run(planned_messages=12, published=published))
        write_pair(
            tmp_path / side,
            TWELVE,
            ping=made_hostile(ping_session(extra=extra)),
            relay=made_hostile(relay_session(extra=extra)),
            runs=[replace(described, extra={**described.extra, "bridge": HOSTILE, "labels": {HOSTILE: HOSTILE}})],
        )
    return tmp_path


def check_plain(text, *, is_shown=True):
    assert [c for c in text if c not in "\n\t" and is_hidden(c)] == []
    assert [line for line in text.split("\n") if line.lstrip().startswith("::")] == []
    assert "##[" not in text or not is_shown


def check_file(path):
    if path.suffix in (".parquet", ".arrow", ".mcap"):
        return
    text = path.read_bytes().decode()
    if path.suffix == ".html":
        assert "<script>alert" not in text
        assert [text[max(text.index(c) - 80, 0) :][:160] for c in "\x1b\x07\x9b\u202e" if c in text] == []
        return
    check_plain(text, is_shown=path.suffix in (".md", ".txt"))
    if path.suffix == ".json":
        json.loads(text)
    elif path.suffix == ".md":
        assert ("<script" in text, "](http" in text, "@i" in text) == (False, False, False)
    elif path.suffix == ".xml":
        ET.fromstring(text)
    elif path.suffix == ".csv":
        cells = {cell for row in csv.reader(text.splitlines()) for cell in row if cell[:1] in ("=", "+", "-", "@")}
        assert [cell for cell in cells if not cell.lstrip("-").replace(".", "").replace("e-", "").isdigit()] == []


def test_no_format_of_an_analysis_passes_a_command_on(hostile, capsys):
    kinds = [word for kind in ("html", "md", "json", "terminal") for word in ("--report", kind)]
    out = hostile / "o"
    assert run_main(hostile / "a", "--out", out, *kinds, "--export", "csv", "--derived-mcap") == 0
    check_plain("".join(capsys.readouterr()))
    files = [path for path in out.iterdir() if path.is_file()]
    assert {".html", ".md", ".json", ".csv"} <= {path.suffix for path in files}
    for path in files:
        check_file(path)


@pytest.mark.parametrize("kind", ["terminal", "md", "json", "junit", "html"])
def test_no_format_of_a_comparison_passes_a_command_on(hostile, capsys, kind):
    suffix = {"junit": "xml", "terminal": "txt"}.get(kind, kind)
    for words in ((), ("--out", hostile / f"r.{suffix}")):
        run_main("compare", hostile / "a", hostile / "b", "--fail-if", "default", "--report", kind, *words)
        out, err = capsys.readouterr()
        check_plain(err)
        if kind != "html":
            check_plain(out)
    check_file(hostile / f"r.{suffix}")


def test_what_devices_and_peers_say_is_one_plain_line(tmp_path, capsys):
    with plain_streams(), TerminalWatch() as watch:
        watch.note(HOSTILE)
    out, err = capsys.readouterr()
    check_plain(out + err)
    assert err.count("\n") == 1
    state = SweepState(tmp_path / "state.json", "plan", "0" * 16)
    state["cell"] = CellState(Status.FAILED, reason=HOSTILE)
    (saved,) = json.loads((tmp_path / "state.json").read_text())["cells"].values()
    check_plain(saved["reason"], is_shown=False)
    values = {field.name: HOSTILE if field.type == "str" else 1 for field in fields(Entry)}
    with plain_streams() as stdout:
        stdout.write("\n".join(_lines(Listed(Entry(**{**values, "stopped": HOSTILE}), State.RUNNING))))
    check_plain(capsys.readouterr().out)


def test_the_manager_gets_one_status(tmp_path):
    address = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(address)
        service = ServiceManager({"NOTIFY_SOCKET": address})
        service.notify("into x\nMAINPID=1")
        assert manager.recv(4096).decode().splitlines() == ["READY=1", "STATUS=into x\\x0aMAINPID=1"]
        service.close()
