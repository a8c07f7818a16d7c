import io
import json
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.table import Table

from dds_trace.base.printable import is_hidden, printable
from dds_trace.base.streams import PlainStream, plain, plain_console, plain_streams, say, wrapped

PIECES = st.lists(
    st.sampled_from(["::", " ", ":", "\n", "\t", "##[", "a", "\x1b[2J", "\u202e", "\r", "\x9b", "\U000e0001", "é"])
)


def is_plain(text):
    commands = [line for line in text.split("\n") if line.lstrip().startswith("::")]
    return not commands and "##[" not in text and not any(is_hidden(c) for c in text if c not in "\n\t")


@given(pieces=PIECES)
def test_no_text_commands_its_reader(pieces):
    whole, apart = io.StringIO(), io.StringIO()
    PlainStream(whole).write("".join(pieces))
    assert is_plain(whole.getvalue())
    stream = PlainStream(apart)
    for piece in pieces:
        stream.write(piece if piece != ":" else "a")
    assert "##[" not in apart.getvalue()
    assert not any(line.lstrip().startswith("::") for line in apart.getvalue().split("\n"))


@given(text=st.text())
def test_json_stays_json(text):
    stream = io.StringIO()
    PlainStream(stream).write(json.dumps({"a": text + "##[\x7f"}, ensure_ascii=False))
    assert json.loads(stream.getvalue(), strict=False) == {"a": text + "##[\x7f"}
    assert is_plain(plain(text))


def test_rich_draws_its_own_escapes_and_nobody_elses(capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    table = Table("a", box=None, header_style="bold")
    table.add_row("[red]\x1b]0;x\x07\n::error::y")
    with plain_streams():
        plain_console(width=80).print(table)
        say("one\nline\x1b")
    out, err = capsys.readouterr()
    assert "\x1b[1m" in out
    assert ("\x1b]" in out, "[red]" in out, "\n::" in out) == (False, True, False)
    assert err == "one\\x0aline\\x1b\n"


@pytest.mark.parametrize(
    ("stream", "program", "code"),
    [("stderr", "dds-record", 0), ("stdout", "dds-record", 0), ("stdout", "dds-trace", 6)],
)
def test_a_full_stream_costs_words(tmp_path, stream, program, code):
    script = (
        "import sys, typer\n"
        "from dds_trace.cli.program import run_command\n"
        "app = typer.Typer()\n"
        "@app.command()\n"
        "def f():\n"
        "    for _ in range(3):\n"
        "        print('a' * 10_000, flush=True); print('b' * 10_000, file=sys.stderr)\n"
        "    open('done', 'w').write('done')\n"
        f"run_command(lambda: app([]), needs_stdout={program != 'dds-record'})\n"
    )
    with Path("/dev/full").open("w") as full:
        outputs = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, stream: full}
        ended = subprocess.run([sys.executable, "-c", script], **outputs, cwd=tmp_path, check=False)
    assert (tmp_path / "done").read_text() == "done"
    assert ended.returncode == code
    assert b"Traceback" not in (ended.stderr or b"")


def test_a_report_made_of_commands_is_written_as_it_is():
    shown = io.StringIO()
    stream = PlainStream(shown)
    stream.write("::warning::of a trace\n")
    stream.write_commands("::warning::of a gate \x1b\n")
    assert shown.getvalue().splitlines() == [":\\u003awarning::of a trace", "::warning::of a gate \\u001b"]


def test_invisible_characters_are_spelled_out():
    assert printable("\x1b[31mred\x07") == r"\x1b[31mred\x07"
    assert printable("a\u2028b\u202ec\n") == r"a\u2028b\u202ec\x0a"
    assert printable("Zürich → 東京 µs") == "Zürich → 東京 µs"
    assert printable("\ud800") == r"\ud800"


def test_a_label_of_any_length_stays_a_label():
    assert len(printable("x" * 10**6)) == 300


@pytest.mark.parametrize(
    "character", ["\n", "\r", "\x00", "\x1b", "\x7f", "\u2028", "\u202e", "\ud800", "\ufffe", "\U0010ffff"]
)
def test_nothing_is_left_that_steers_a_terminal_or_that_xml_forbids(character):
    assert character not in printable(f"a{character}b")
    assert printable(f"a{character}b").startswith("a\\")


def test_a_line_to_a_person_is_as_wide_as_the_terminal_and_one_in_a_log_is_whole(capsys, monkeypatch):
    text = "word " * 40 + "a" * 90
    monkeypatch.setenv("COLUMNS", "60")
    say(text)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    say(text)
    whole, *lines, path = capsys.readouterr().err.splitlines()
    assert (whole, path.strip()) == (text, "a" * 90)
    assert 30 < max(map(len, lines)) <= 60
    first, second, third = wrapped(f"no echo\n  saw: {'word ' * 20}").splitlines()
    assert (first, second[:6], third[:5]) == ("no echo", "  saw:", "    w")
