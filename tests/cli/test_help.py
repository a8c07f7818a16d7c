"""Commands load what they need and no more: looked up in `sys.modules` of a fresh process."""

import importlib
import json
import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

import dds_trace.cli.analyze
import dds_trace.cli.bridge
import dds_trace.cli.compare
import dds_trace.cli.record.command
import dds_trace.cli.record.status
import dds_trace.cli.sweep.command
import dds_trace.cli.sweep.new
import dds_trace.cli.trace
import dds_trace.cli.watch
from dds_trace.base.version import __version__

HEAVY = (
    *("numpy", "polars", "pyarrow", "scipy", "pandas", "plotly", "jinja2", "rich", "pygments", "markdown_it"),
    *("rclpy", "cyclonedds", "zenoh", "rti", "rosbags", "mcap", "cramjam", "zstandard", "isal", "psutil"),
    *("dask", "distributed", "fsspec", "s3fs", "pydantic", "sqlite3", "asyncio", "ssl"),
)
NOT_FOR_A_TABLE = {
    *("pandas", "plotly", "jinja2", "rclpy", "cyclonedds", "zenoh", "rti", "rosbags", "psutil"),
    *("dask", "distributed", "fsspec", "s3fs", "pydantic", "pygments", "markdown_it"),
}
NOT_FOR_A_PING = {*HEAVY} - {"numpy", "rich", "mcap", "cramjam", "zstandard", "isal", "psutil", "asyncio", "ssl"}
COMMANDS = {
    "dds-trace": ("dds_trace.cli.trace", []),
    "dds-record": ("dds_trace.cli.record", []),
    "dds-record status": ("dds_trace.cli.record", ["status"]),
    "dds-sweep": ("dds_trace.cli.sweep", []),
    "dds-sweep new": ("dds_trace.cli.sweep", ["new"]),
    "dds-bridge": ("dds_trace.cli.bridge", []),
    "dds-analyze": ("dds_trace.cli.analyze", []),
    "dds-analyze compare": ("dds_trace.cli.analyze", ["compare"]),
    "dds-analyze watch": ("dds_trace.cli.analyze", ["watch"]),
}
CALL = """
import importlib, json, sys
module, words, heavy, name = json.loads(sys.argv[1])
sys.argv = [name, *words]
code = 0
try:
    importlib.import_module(module).main()
except SystemExit as end:
    code = end.code
print(json.dumps({"code": code, "loaded": [name for name in heavy if name in sys.modules]}))
"""
SAMPLES = Path(__file__).parents[2] / "sample_traces"


def called(module, *words, name="command"):
    """Return the lines that a command printed, its exit code and the libraries of `HEAVY` that it loaded."""
    arguments = json.dumps([module, [*map(str, words)], HEAVY, name])
    ran = subprocess.run([sys.executable, "-c", CALL, arguments], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    *shown, said = ran.stdout.splitlines()
    state = json.loads(said)
    return shown, state["code"], set(state["loaded"])


APPS = {
    "dds-trace": dds_trace.cli.trace.app,
    "dds-record": dds_trace.cli.record.command.app,
    "dds-record status": dds_trace.cli.record.status.app,
    "dds-sweep": dds_trace.cli.sweep.command.app,
    "dds-sweep new": dds_trace.cli.sweep.new.app,
    "dds-bridge": dds_trace.cli.bridge.app,
    "dds-analyze": dds_trace.cli.analyze.app,
    "dds-analyze compare": dds_trace.cli.compare.app,
    "dds-analyze watch": dds_trace.cli.watch.app,
}
PROGRAMS = [name for name in COMMANDS if " " not in name]


@pytest.mark.parametrize("command", COMMANDS)
def test_help_loads_no_heavy_library_and_reads_well_at_80_columns(command, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    module, words = COMMANDS[command]
    shown, code, loaded = called(module, *words, "--help", name=command.split()[0])
    assert (code, loaded) == (0, set())
    check_usage(shown[0], command)
    assert max(map(len, shown)) <= 80
    whole = " ".join(" ".join(shown).split())
    assert re.findall(r"<[a-z_|]+>", whole) == []  # values are named by what they mean, not <int> or <a|b>
    said = typer.main.get_command(APPS[command])
    for text in (said.help, *(parameter.help for parameter in said.params)):
        assert " ".join(text.split()) in whole  # no word is cut
    for line in re.findall(r"^ {4,}(dds-.*)$", said.help, re.MULTILINE):
        assert f"      {line}" in shown  # a command line to copy is one line
    for line, following in pairwise(shown):
        if goes_on(line, following):  # no line is broken before it is full
            assert len(line) + 1 + len(following.split()[0]) > 78, line
    is_program = command in PROGRAMS
    for option in ("--version", "--install-completion", "--show-completion"):
        assert (option in whole) is is_program


def check_usage(line, command):
    assert re.fullmatch(rf"Usage: {command} \[OPTIONS\]( \[?[A-Z]+(\.toml)?\]?(\.\.\.)?)*", line)


def goes_on(line, following):
    """Whether a line of help goes on in the next one: within a paragraph, or in the column of what options mean."""
    if not line.strip() or not following.strip() or not line.startswith("  "):
        return False
    indent, next_indent = (len(each) - len(each.lstrip()) for each in (line, following))
    is_row = "  " in line.strip()
    is_paragraph = (
        indent == next_indent == 2
        and not is_row
        and not line.strip().startswith(("-", "[", *"ABCDEFGHIJKLMNOPQRSTUVWXYZ"))
    )
    return next_indent > 2 or (is_paragraph and not following.strip().startswith("-"))


@pytest.mark.parametrize("program", PROGRAMS)
def test_every_program_tells_its_version(program):
    module, _ = COMMANDS[program]
    shown, code, loaded = called(module, "--version", name=program)
    assert (shown, code, loaded) == ([f"{program} {__version__}"], 0, set())


@pytest.mark.parametrize(
    ("program", "line", "completions"),
    [
        ("dds-record", "--transp", {"--transport"}),
        ("dds-sweep", "plan.toml --against", {"--against"}),
        ("dds-bridge", "--half ", {"ping", "relay"}),
        ("dds-analyze", "--derived", {"--derived-mcap"}),
        ("dds-analyze", "comp", {"compare"}),
        ("dds-analyze", "compare --report j", {"json", "junit"}),
        ("dds-analyze", "watch --ho", {"--host"}),
        ("dds-record", "--backend ", {"cyclonedds", "socket"}),
        ("dds-record", "--bridge zen", {"zenoh-bridge-dds"}),
        ("dds-bridge", "built", {"builtin", "builtin-zenoh"}),
        ("dds-trace", "", {"record", "sweep", "bridge", "analyze", "compare", "watch"}),
        ("dds-trace", "record ", {"ping", "relay", "status"}),
        ("dds-trace", "record ping --backend zen", {"zenoh"}),
        ("dds-trace", "record ping --si", {"--size"}),
        ("dds-trace", "record status --j", {"--json"}),
        ("dds-trace", "bridge built", {"builtin", "builtin-zenoh"}),
        ("dds-trace", "analyze --derived", {"--derived-mcap"}),
        ("dds-trace", "compare --report j", {"json", "junit"}),
        ("dds-trace", "watch --ho", {"--host"}),
    ],
)
def test_the_shell_is_told_how_a_line_may_go_on(program, line, completions, monkeypatch, capsys):
    words = f"{program} {line}"
    asked = f"_{program.upper().replace('-', '_')}_COMPLETE"
    main = importlib.import_module(COMMANDS[program][0]).main
    bash = {"COMP_WORDS": words.replace(" ", "\n"), "COMP_CWORD": str(words.count(" "))}
    for shell, told in (("bash", bash), ("zsh", {"_TYPER_COMPLETE_ARGS": words})):
        with monkeypatch.context() as told_so:
            told_so.setattr(sys, "argv", [program])
            for name, value in {**told, asked: f"complete_{shell}"}.items():
                told_so.setenv(name, value)
            with pytest.raises(SystemExit) as ended:
                main()
        assert ended.value.code == 0
        assert completions <= set(re.findall(r"[\w-]+", capsys.readouterr().out))


ONE_PROGRAM = {
    "record": ("dds-record", []),
    "record ping": ("dds-record", ["--role", "ping"]),
    "record relay": ("dds-record", ["--role", "relay"]),
    "record status": ("dds-record", ["status"]),
    "sweep": ("dds-sweep", []),
    "sweep new": ("dds-sweep", ["new"]),
    "bridge": ("dds-bridge", []),
    "analyze": ("dds-analyze", []),
    "analyze compare": ("dds-analyze", ["compare"]),
    "compare": ("dds-analyze", ["compare"]),
    "watch": ("dds-analyze", ["watch"]),
}
"""Command of `dds-trace` -> the program that it is, and its words."""


@pytest.mark.parametrize("command", ONE_PROGRAM)
def test_a_command_of_the_one_program_has_the_options_of_the_program_that_it_is(command, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    program, words = ONE_PROGRAM[command]
    shown, code, loaded = called("dds_trace.cli.trace", *command.split(), "--help", name="dds-trace")
    assert (code, loaded) == (0, set())
    check_usage(shown[0], f"dds-trace {command}")
    assert max(map(len, shown)) <= 80
    name = " ".join([program, *words])
    app, more = (APPS[name], []) if name in APPS else (APPS[program], words)
    other = CliRunner().invoke(app, [*more, "--help"]).stdout.splitlines()
    options, others = (
        set(re.findall(r"^  (-[\w-]+)(?=[, ]|$)", "\n".join(lines), re.MULTILINE)) for lines in (shown, other)
    )
    not_here = {"--install-completion", "--show-completion"} | ({"--role"} if "p" in command[6:] else set())
    assert not re.search(r"dds-(record|sweep|bridge|analyze)\b", " ".join(shown))
    if command in ("record ping", "record relay"):
        of_other = {"record ping": {"--relay-id", "--rotate"}, "record relay": {"--rate", "--bridge"}}[command]
        assert options < others - not_here
        assert not of_other & options
    else:
        assert options - {"--config", "--print-config"} == others - not_here - {"--config", "--print-config"}


def test_the_15_common_options_of_a_ping_come_first():
    shown, _, _ = called("dds_trace.cli.trace", "record", "ping", "--help", name="dds-trace")
    panels = re.split(r"^(\w.*):$", "\n".join(shown), flags=re.MULTILINE)
    assert panels[1] == "Common options"
    assert len(re.findall(r"^  --", panels[2], re.MULTILINE)) == 15
    assert re.findall(r"^  (--[a-z]+)", panels[2], re.MULTILINE)[:4] == ["--out", "--data", "--size", "--rate"]


def test_one_program_runs_what_the_four_run(tmp_path, monkeypatch, capsys, sentences):
    def ends(*words):
        monkeypatch.setattr(sys, "argv", ["dds-trace", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            dds_trace.cli.trace.main()
        return ended.value.code, *capsys.readouterr()

    code, out, _ = ends("analyze", SAMPLES / "losses", "--out", tmp_path)
    assert (code, (tmp_path / "summary.parquet").is_file()) == (0, True)
    assert f"Wrote {tmp_path / 'summary.parquet'}" in out
    same = ends("compare", SAMPLES / "losses", SAMPLES / "losses")
    assert same == ends("analyze", "compare", SAMPLES / "losses", SAMPLES / "losses")
    assert same[0] == 0
    assert ends("record", "ping", "--rotate", "1GB", "--out", tmp_path / "x.mcap")[0] == 2
    refused = [ends("record", "ping"), ends("compair", "a")]
    assert [code for code, _, _ in refused] == [2, 2]
    sentences(*(said for _, _, said in refused))
    assert ends("bridge", "builtin", "--print-config")[1].startswith("--list")
    assert "domain" in ends("bridge", "builtin", "--config")[1]
    assert ends()[1] == ends("--help")[1]


def test_python_m_is_the_one_program():
    ran = subprocess.run([sys.executable, "-m", "dds_trace", "compair"], capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr.split(":")[0]) == (2, "dds-trace")


def test_a_usage_error_loads_no_heavy_library():
    _, code, loaded = called("dds_trace.cli.sweep", "--unknown")
    assert (code, loaded) == (2, set())


def test_a_table_of_a_small_folder_loads_neither_figures_nor_middleware_nor_cluster(tmp_path):
    shown, code, loaded = called("dds_trace.cli.analyze", SAMPLES / "losses", "--out", tmp_path)
    assert code == 0
    assert f"Wrote {tmp_path / 'summary.parquet'}" in shown
    assert "polars" in loaded
    assert loaded & NOT_FOR_A_TABLE == set()


def test_a_ping_over_sockets_loads_nothing_of_the_analyzer_nor_of_another_middleware(tmp_path):
    ping = ["--role", "ping", "--backend", "socket", "--discovery", "localhost", "--wait", "0.1"]
    _, code, loaded = called("dds_trace.cli.record", *ping, "--out", tmp_path / "ping.mcap")
    assert code != 0  # no relay answers
    assert "numpy" in loaded
    assert loaded & NOT_FOR_A_PING == set()


@pytest.mark.parametrize("columns", [60, 80, 200])
def test_help_keeps_names_whole_and_lines_narrow(columns, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(columns))
    shown, _, _ = called("dds_trace.cli.record", "--help")
    assert max(map(len, shown)) <= min(columns, 120)
    assert "zenoh-bridge-ros2dds," in " ".join(shown).split()
    assert "\x1b" not in "".join(shown)  # a pipe gets plain text


def test_a_process_that_ends_leaves_no_object_to_its_collector():
    """Python looks at all of them several times before it ends: most of the time of an end. Before that it looks seldom."""
    script = (
        "import atexit, gc, sys\n"
        "atexit.register(lambda: print(gc.get_freeze_count() > 1_000, len(gc.get_objects()) < 100, gc.get_threshold()[0] >= 10_000))\n"  # the last to be called
        "from dds_trace.cli.analyze import main\n"
        "main(['--version'])\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "True True True"
