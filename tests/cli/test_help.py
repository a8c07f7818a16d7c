"""Commands load what they need and no more: looked up in `sys.modules` of a fresh process."""

import ast
import importlib
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from bags import imu, write_bag2
from commands import run_trace

from dds_trace.base.version import __version__
from dds_trace.cli import analyze, trace
from dds_trace.cli.record import command as record
from dds_trace.recorder.choices import Role
from dds_trace.recorder.option_table import OPTIONS, key_of, settings_of

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
MODULES = {
    "dds-trace": "dds_trace.cli.trace",
    "dds-record": "dds_trace.cli.dds_record",
    "dds-analyze": "dds_trace.cli.dds_analyze",
}
COMMANDS = [*MODULES, *(f"dds-trace {name}" for name in ("record", "explain", *trace.commands()))]
CALL = """
import importlib, json, sys
module, words, name = json.loads(sys.argv[1])
sys.argv = [name, *words]
code = 0
try:
    importlib.import_module(module).main()
except SystemExit as end:
    code = end.code
print(json.dumps({"code": code, "loaded": [*sys.modules]}))
"""
ROOT = Path(__file__).parents[2]
ROOMS = ("src/dds_trace/base", "tracefile", "recorder", "analyzer", "reports", "cli", "extensions")
SAMPLES = ROOT / "sample_traces"


def called(module, *words, name="command"):
    """Return the lines that a command printed, its exit code and the libraries of `HEAVY` that it loaded."""
    shown, code, loaded = run_once(module, *words, name=name)
    return shown, code, loaded & {*HEAVY}


def run_once(module, *words, name="command"):
    """Return the lines that a command printed, its exit code and all modules that it loaded."""
    arguments = json.dumps([module, [*map(str, words)], name])
    ran = subprocess.run([sys.executable, "-c", CALL, arguments], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    *shown, said = ran.stdout.splitlines()
    state = json.loads(said)
    return shown, state["code"], set(state["loaded"])


def command_of(name):
    """Return the command with its options and help."""
    if name != "dds-trace" and name in MODULES:
        return typer.main.get_command({"dds-record": record, "dds-analyze": analyze}[name].app)
    words = name.split()[1:]
    command = typer.main.get_command(trace.build(words))
    for word in words:
        command = command.commands[word]
    return command


@pytest.mark.keeps(6)
@pytest.mark.parametrize("command", COMMANDS)
def test_help_is_whole_or_short_and_loads_no_heavy_library(command, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    program, *words = command.split()
    shown, code, loaded = called(MODULES[program], *words, "--help", name=program)
    assert (code, loaded) == (0, set())
    check_usage(shown[0], command)
    assert max(map(len, shown)) <= 80
    whole = " ".join(" ".join(shown).split())
    assert re.findall(r"<[a-z_|]+>", whole) == []  # values are named by what they mean, not <int> or <a|b>
    declared = command_of(command)
    for text in (declared.help, *(parameter.help for parameter in declared.params if not parameter.hidden)):
        assert "".join(text.split()) in "".join(whole.split())  # no word is cut
    assert [line for line in shown[1:] if line.endswith("...")] == []  # the first sentence fits a list of commands
    for line in re.findall(r"^ *(dds-.*)$", declared.help, re.MULTILINE):
        assert f"      {line}" in shown  # a command line to copy is one line
    for option in ("--version", "--install-completion", "--show-completion"):
        assert (option in whole) is (command in MODULES or (option, command) == ("--version", "dds-trace analyze"))
    short, code, loaded = called(MODULES[program], *words, "-h", name=program)
    assert (code, loaded, short[0]) == (0, set(), shown[0])
    assert len(short) <= MOST_SHORT_LINES
    assert max(map(len, short)) <= 80


MOST_SHORT_LINES = 31


def check_usage(line, command):
    assert re.fullmatch(rf"Usage: {command} \[OPTIONS\]( [\[{{]?[A-Z]+(\.toml|\.\.\.)?[\]}}]?(\.\.\.)?)*", line)


@pytest.mark.parametrize("program", MODULES)
def test_every_program_tells_its_version(program):
    shown, code, loaded = called(MODULES[program], "--version", name=program)
    assert (shown, code, loaded) == ([f"{program} {__version__}"], 0, set())


@pytest.mark.parametrize(
    ("program", "line", "completions"),
    [
        ("dds-record", "--reliab", {"--reliability"}),
        ("dds-trace", "record ping -o transp", {"transport"}),
        ("dds-trace", "sweep plan.toml --against", {"--against"}),
        ("dds-trace", "sweep new --se", {"--send"}),
        ("dds-trace", "explain ", {"rates", "size"}),
        ("dds-trace", "bridge --half ", {"ping", "relay"}),
        ("dds-analyze", "--derived", {"--derived-mcap"}),
        ("dds-record", "--backend ", {"cyclonedds", "socket"}),
        ("dds-record", "--bridge zen", {"zenoh-bridge-dds"}),
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
    main = importlib.import_module(MODULES[program]).main
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


def test_a_recording_has_the_options_of_its_role():
    parameters = {role: command_of(f"dds-trace record {role}").params for role in ("ping", "relay", "tap", "beacon")}
    options = {role: {option for row in rows for option in row.opts} for role, rows in parameters.items()}
    shown = {role: sum(not row.hidden for row in rows) + 1 for role, rows in parameters.items()}  # and --help
    assert shown == {"ping": 25, "relay": 20, "tap": 15, "beacon": 15}
    assert {"--rate", "--bridge"} <= options["ping"]
    assert {"--topics", "--live"} <= options["tap"]
    assert not {"--rate", "--bridge", "--topics", "--role"} & options["relay"]
    assert "--bridge" not in options["tap"] | options["beacon"]
    assert not {"--topics", "--relay-id", "--rotate", "--role"} & options["ping"]
    assert not {"--flow", "--serialization", "--deadline", "--history"} & options["tap"]


def test_a_recording_by_the_names_of_the_card_is_the_same(tmp_path, monkeypatch, capsys):
    taken = []
    monkeypatch.setattr("dds_trace.cli.record.run.record_until_stopped", lambda options, **_: taken.append(options))
    for program, words in (("dds-record", ["--role", "relay"]), ("dds-trace", ["record", "relay"])):
        with pytest.raises(SystemExit) as ended:
            importlib.import_module(MODULES[program]).main([*words, "--domain", "7", "--out", str(tmp_path / "r.mcap")])
        assert ended.value.code == 0, capsys.readouterr().err
    assert taken[0] == taken[1]


@pytest.mark.parametrize(("words", "now"), [(moved.split(), now) for moved, now in trace.MOVED.items()])
def test_an_option_that_went_names_the_command_that_does_it(words, now, capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["dds-trace"])
    monkeypatch.setattr("dds_trace.cli.doctor.all_checks", lambda _: [])
    code = run_trace(*words, "x")
    said = f"{words[1]} went; use `dds-trace {now}`\n"
    if " ".join(words) in trace.FOLLOWED:
        assert capsys.readouterr().err.startswith(said)  # then what that command says of x
        assert trace.follow_moved([words[0], "a", words[1], "b"]) == [now.split()[0], "a", "b"]
    else:
        assert (code, capsys.readouterr().err) == (2, f"dds-trace: {said}")
    assert " ".join(now.split()[:2]) in trace.commands() or now.split()[0] in {*trace.commands(), "record"}


def test_what_is_rarely_used_is_a_setting(tmp_path, monkeypatch, capsys):
    taken = []
    take = "dds_trace.cli.record.run.record_until_stopped"
    monkeypatch.setattr(take, lambda options, **_: (options.check(), taken.append(options)))

    def ends(*words):
        code = run_trace("record", *words, "--backend", "socket", "--out", tmp_path / "x.mcap")
        return code, *capsys.readouterr()

    assert ends("ping", "-o", "buffer=1MB", "-o", "own_cost=false")[0] == 0
    assert (taken[0].node.buffer_bytes, taken[0].own_cost) == (1_000_000, False)
    keys = {line.partition("=")[0] for line in ends("relay", "-o", "help")[1].splitlines()}
    assert {"buffer", "congestion_control", "relay_id"} <= keys
    assert not {"clients", "executor", "when_full", "bridge", "tuned"} & keys  # of a ping, of other middlewares, shown
    code, _, err = ends("ping", "--no-own-cost", "--buffer", "2MB", "--fsync")
    assert (code, "-o own_cost=false" in err, "-o fsync=true" in err) == (0, True, True)
    assert (taken[1].node.buffer_bytes, taken[1].destination.fsync) == (2_000_000, True)
    for words, said in (
        (("-o", "bufer=1MB"), "did you mean 'buffer'"),
        (("-o", "relay_id=5"), "-o relay_id cannot be given to a ping, only to a relay; remove it"),
        (("-o", "own_cost=no"), "one of true, false"),
        (("-o", "buffer=x"), "-o buffer 'x' is not"),
        (("-o", "executor=sngle"), "-o executor 'sngle': did you mean 'single'"),
        (("-o", "wake=soon"), "-o wake 'soon': write a number"),
    ):
        code, _, err = ends("ping", *words)
        assert (code, said in err) == (2, True), err
    limited = [(role, row) for role in Role for row in settings_of(role).values() if row.metavar and row.limit]
    assert len(limited) > 30
    for role, row in limited:
        bad = {str: "\udcff", float: "1e400"}.get(row.kind, "9" * 30)
        topics = ["--topics", "/a"] if role is Role.TAP else []
        code, _, err = ends(role.value, *topics, "-o", f"{key_of(row)}={bad}")
        assert (code, f"-o {key_of(row)}" in err, row.name in err) == (2, True, False), err


DEFINED = re.compile(r"--[a-z-]+(?: [A-Z][A-Z:=]*)?")


def strings_of(text):
    nodes = list(ast.walk(ast.parse(text)))
    docstrings = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    strings = [node for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)]
    return [node.value for node in strings if id(node) not in docstrings and not DEFINED.fullmatch(node.value)]


def test_a_sentence_and_a_page_name_no_option_that_is_a_setting_or_went():
    commands = map(command_of, ["dds-record", "dds-analyze", *(f"dds-trace {name}" for name in trace.commands())])
    shown = {option for command in commands for row in command.params if not row.hidden for option in row.opts}
    gone = {*(row.name for row in OPTIONS.values()), *(moved.split()[1] for moved in trace.MOVED)} - shown
    assert {"--buffer", "--rotate", "--no-own-cost", "--explain-rates"} <= gone
    modules = [path for room in ROOMS for path in (ROOT / room).rglob("*.py") if path.name != "trace.py"]
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "benchmarks").glob("*.md")]
    texts = [(path, text) for path in modules for text in strings_of(path.read_text())]
    texts += [(path, path.read_text()) for path in pages]
    assert len(texts) > 10_000
    named = [(path.name, option) for path, text in texts for option in re.findall(r"(?<![\w-])--[a-z][a-z-]+", text)]
    assert [one for one in named if one[1] in gone] == []


def test_typer_is_used_by_its_public_interface():
    """No private module or attribute of it or of click, and no class of commands."""
    text = "\n".join(path.read_text() for path in Path(trace.__file__).parent.rglob("*.py"))
    assert set(re.findall(r"(?:from|import) (typer\S*|click\S*)", text)) == {"typer", "typer.models"}
    assert re.findall(r"typer\.(?:_\w+|core)|cls=|\(Typer\w+\):", text) == []


def test_one_program_runs_what_the_others_ran(tmp_path, monkeypatch, capsys, sentences):
    def ends(*words):
        monkeypatch.setattr(sys, "argv", ["dds-trace", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            trace.main()
        return ended.value.code, *capsys.readouterr()

    code, out, _ = ends("analyze", SAMPLES / "losses", "--out", tmp_path)
    assert (code, (tmp_path / "summary.parquet").is_file()) == (0, True)
    assert f"Wrote {tmp_path / 'summary.parquet'}" in out
    same = ends("compare", SAMPLES / "losses", SAMPLES / "losses")
    assert same[0] == 0
    assert ends("record", "ping", "--rotate", "1GB", "--out", tmp_path / "x.mcap")[0] == 2
    refused = [ends("record", "ping"), ends("compair", "a")]
    assert [code for code, _, _ in refused] == [2, 2]
    sentences(*(said for _, _, said in refused))
    assert "domain" in ends("bridge", "builtin", "--config")[1]
    assert ends()[1] == ends("--help")[1]


def test_python_m_is_the_one_program_and_a_usage_error_loads_no_heavy_library():
    ran = subprocess.run([sys.executable, "-m", "dds_trace", "compair"], capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr.split()[:2]) == (2, ["Usage:", "dds-trace"])
    assert called("dds_trace.cli.trace", "sweep", "--unknown")[1:] == (2, set())
    for against in ((), ("--against", "SAME")):
        assert (
            "polars" not in called("dds_trace.cli.trace", "sweep", ROOT / "plans/quick.toml", "--dry-run", *against)[2]
        )


def test_a_table_of_a_small_folder_loads_neither_figures_nor_middleware_nor_cluster(tmp_path):
    shown, code, loaded = called("dds_trace.cli.dds_analyze", SAMPLES / "losses", "--out", tmp_path)
    assert code == 0
    assert f"Wrote {tmp_path / 'summary.parquet'}" in shown
    assert "polars" in loaded
    assert loaded & NOT_FOR_A_TABLE == set()


@pytest.mark.parametrize(
    ("words", "most", "never"),
    [
        (["--help"], 64, ()),
        (["record", "ping", "--help"], 45, ()),
        (["bag", "BAG", "--out", "OUT"], 90, ("campaigns",)),
        (["analyze", "TRACES", "--out", "OUT"], 162, ("wire", "gates", "bags", "campaigns")),
    ],
    ids=["help", "ping", "bag", "analyze"],
)
def test_a_command_loads_few_of_our_modules_and_no_extension_that_it_does_not_ask(words, most, never, tmp_path):
    files = {"OUT": tmp_path / "out", "TRACES": SAMPLES / "losses"}
    files["BAG"] = write_bag2(tmp_path / "drive", {"/imu": [imu(0.1)] * 50})
    _, code, loaded = run_once("dds_trace.cli.trace", *(files.get(word, word) for word in words), name="dds-trace")
    ours = {name for name in loaded if name.partition(".")[0] == "dds_trace"}
    assert (code, len(ours)) == (0, min(len(ours), most))
    assert "dds_trace.base.extension" in ours
    packages = tuple(f"dds_trace.extensions.{name}." for name in never)
    assert [name for name in ours if name.startswith(packages)] == []


def test_a_ping_over_sockets_loads_nothing_of_the_analyzer_nor_of_another_middleware(tmp_path):
    ping = ["--role", "ping", "--backend", "socket", "--discovery", "localhost", "--wait", "0.1"]
    _, code, loaded = called("dds_trace.cli.dds_record", *ping, "--out", tmp_path / "ping.mcap")
    assert code != 0  # no relay answers
    assert "numpy" in loaded
    assert loaded & NOT_FOR_A_PING == set()


@pytest.mark.parametrize("columns", [60, 80, 200])
def test_help_keeps_lines_narrow(columns, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(columns))
    shown, _, _ = called("dds_trace.cli.dds_record", "--help")
    assert max(map(len, shown)) <= min(columns, 120)
    assert "\x1b" not in "".join(shown)  # a pipe gets plain text


def test_a_process_that_ends_leaves_no_object_to_its_collector():
    """Python looks at all of them several times before it ends: most of the time of an end. Before that it looks seldom."""
    script = (
        "import atexit, gc, sys\n"
        "atexit.register(lambda: print(gc.get_freeze_count() > 1_000, len(gc.get_objects()) < 100, gc.get_threshold()[0] >= 10_000))\n"  # the last to be called
        "from dds_trace.cli.dds_analyze import main\n"
        "main(['--version'])\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "True True True"
