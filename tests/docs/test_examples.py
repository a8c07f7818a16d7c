import csv
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tarfile
from contextlib import ExitStack
from importlib.metadata import entry_points
from pathlib import Path

import pytest
import typer
from doc_examples import DOCS, PAGES, command_lines, examples, lines_in_text
from processes import RunningCommand
from trace_files import SAMPLES, copy_sample

from dds_trace.cli import analyze, trace
from dds_trace.cli.record import command as record
from dds_trace.cli.record.command import words_of_role
from dds_trace.extensions.campaigns.plan.plan_file import parse_plan

SMALL_PLAN = """
[run]
messages = 5
warmup = 1
settle_seconds = 0
domain = {domain}
[axes]
backend = "socket"
[[matrix]]
size = "1KB"
rate = [100, 200]
"""
"""In the place of a page's plan: what it asks for would take minutes, and middlewares that not every machine has."""

NOT_RUN = {
    "--configuration mine.xml": "needs the user's own file: tests/recorder/backends/test_own_configuration.py writes some",
    "--against ~/venvs/kilted": "needs another environment with another ROS 2",
    "--cluster tcp://scheduler:8786": "needs a Dask scheduler: tests/extensions/cluster/test_cluster.py starts one",
    "--clock runs/": "needs a bag of one of two devices: tests/extensions/topics/test_clock_of_bags.py records it",
    "analyze docker/runs": "what containers recorded; none is built here",
}
"""Part of a line of a command -> why it is read, but not run."""

OTHER_PROGRAMS = {
    "DDS_TRACE_USER": "Docker is not here",
    "CYCLONEDDS_HOME": "tests/support/secured_cyclone.py builds it",
    "apt-get": "changes the machine",
    "cp": "brings samples",
    "docker": "Docker is not here",
    "jupyter": "just walk notebook runs the cells",
    "ln": "tests/support/secured_cyclone.py builds it",
    "mkdir": "belongs to Docker's commands",
    "PATH": "sets up the environment that runs this test",
    "git": "the clone is here",
    "python3": "sets up the environment that runs this test",
    "~/dds-trace-env/bin/pip": "sets up the environment that runs this test",
    "~/venvs/secured/bin/pip": "tests/support/secured_cyclone.py builds it",
    "pip": "sets up the environment that runs this test",
    "scp": "the other device is not here",
    "source": "sets up the environment that runs this test",
    "sudo": "changes the machine",
    "tar": "test_a_tutorial_is_a_transcript runs it",
}
"""First word of a line in a `sh` block -> why it is not run."""

LINES = list(dict.fromkeys(line for _, line in command_lines()))


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    """A folder with what the pages speak of: traces, two sides, plans, a photo, a bag."""
    folder = tmp_path_factory.mktemp("desk")
    words = {word for line in LINES for word in shlex.split(line)}
    for name in ("runs", "base", "new", *(word for word in words if word.startswith(("runs/", "again/")))):
        if not Path(name).suffix:
            copy_sample("losses", folder / name)
    for plan in (word for word in words if word.endswith(".toml")):
        (folder / plan).parent.mkdir(exist_ok=True)
        (folder / plan).write_text(SMALL_PLAN.format(domain=10))
    shutil.copy(SAMPLES / "losses" / "binary_600KB_20Hz.mcap", folder / "runs" / "ping.mcap")
    copy_sample("same_domain", folder / "runs" / "two-sizes")
    (folder / "photos").mkdir()
    (folder / "photos" / "one.jpg").write_bytes(b"jpeg")
    with tarfile.open(DOCS / "results" / "two-machines" / "traces.tar.xz") as archive:
        archive.extractall(folder, filter="data")
    for name in ("taps", "before", "after"):
        shutil.copytree(folder / "robot-and-laptop", folder / name)
    with tarfile.open(DOCS / "results" / "drive" / "traces.tar.xz") as archive:
        archive.extractall(folder, filter="data")
    shutil.copytree(folder / "drive", folder / "drive.mcap")
    return folder


def test_the_lists_of_what_is_not_run_are_of_these_pages():
    shell = [line for block in examples("sh") for line in block.text.splitlines() if not line.startswith(("#", "dds-"))]
    assert {re.split(r"[ =]", line)[0] for line in shell} == set(OTHER_PROGRAMS)
    assert [part for part in NOT_RUN if not any(part in line for line in LINES)] == []
    assert len(LINES) > 40


@pytest.mark.parametrize("page", [page for page in PAGES if list(examples("python", page))], ids=lambda page: page.stem)
def test_the_python_of_a_page_runs_from_top_to_bottom(page, desk, monkeypatch):
    monkeypatch.chdir(desk)
    monkeypatch.setattr("webbrowser.open", lambda _: True)
    names = {}
    for block in examples("python", page):
        exec(compile(block.text, str(page), "exec"), names)


def interrupted(_):
    raise KeyboardInterrupt


def run(line, monkeypatch):
    """Run a command in this process as far as its first message; how it ended."""
    monkeypatch.setattr("dds_trace.recorder.recording.rehearse", lambda *_: None)
    monkeypatch.setattr("dds_trace.extensions.campaigns.rehearsal.rehearse_plan", lambda *_, **__: {})
    monkeypatch.setattr("dds_trace.extensions.campaigns.rehearsal.check_plan", lambda *_: {})
    monkeypatch.setattr("dds_trace.extensions.campaigns.studio.desk.Desk.work", interrupted)
    program, *arguments = shlex.split(line)
    (command,) = entry_points(group="console_scripts", name=program)
    plans = {name: ["--dry-run"] for name in ("sweep", "explain", "advise", "capacity")}
    check = ["-o", "check=true"] if "record tap" in line else ["--check"]
    more = {"bridge": ["--config"], "record": check, "dds-record": check, "studio": ["--port", "0"], **plans}
    kind = arguments[0] if program == "dds-trace" else program
    monkeypatch.setattr(sys, "argv", [program, *arguments, *more.get(kind, [])])
    with pytest.raises(SystemExit) as ended:
        command.load()()
    return ended.value


DEFAULTS = DOCS / "how-to" / "choose.md"
PLANS = [block for block in examples("toml") if "[record]" not in block.text]


@pytest.mark.parametrize("block", PLANS, ids=lambda block: block.name)
def test_a_plan_of_a_page_is_one(block):
    """What is a part of a plan on the page, such as `[search]`, is completed."""
    start = "" if "[run]" in block.text else "[run]\nmessages = 10\n"
    cells = parse_plan(start + block.text, block.page.stem, block.name).cells
    assert cells
    if block.page.stem == "two-devices":
        assert {cell.bridge for cell in cells} == {"none", "builtin-zenoh"}


def test_the_defaults_of_the_page_are_in_force(tmp_path, monkeypatch, capsys):
    (block,) = (block for block in examples("toml", DEFAULTS) if "[record]" in block.text)
    (tmp_path / "dds-trace.toml").write_text(block.text)
    monkeypatch.setenv("DDS_TRACE_CONFIG", str(tmp_path / "dds-trace.toml"))
    monkeypatch.chdir(tmp_path)
    started = run("dds-record --role ping --out ping.mcap", monkeypatch)
    assert started.code == 0
    assert "dds-trace.toml" in capsys.readouterr().err


@pytest.mark.keeps(20)
@pytest.mark.parametrize("line", [line for line in LINES if not any(part in line for part in NOT_RUN)])
def test_a_command_of_a_page_runs_as_far_as_its_first_message(line, desk, monkeypatch, capfd):
    monkeypatch.chdir(desk)
    ended = run(line, monkeypatch)
    end, err = expected_end(line), capfd.readouterr().err
    assert ended.code in ((0, 21) if "--fail-if" in line and not end else (end,)), err
    assert "is a setting now" not in err


ENDS = {"bag drive/ --report": 20, "bag drive/": 30, "dds-trace studio": 130}
"""Part of a line -> the exit code that its page names: a limit is broken, the bag has holes, Ctrl-C."""

PART = re.compile(
    r"```sh\n(?P<sh>.*?)```|(?:into )?`(?P<plan>\w+\.toml)`[^`]*?```toml\n(?P<toml>.*?)```|```text\n(?P<answer>.*?)```|(?P<end>[Ee]nd the relay)",
    re.DOTALL,
)
"""What a person does on a tutorial's page, in its order: types, writes a plan, reads an answer, presses Ctrl-C."""

TIME = r"\d (ms|µs|s)\b"
LAST_WORDS = {
    "analyze runs/first": TIME,
    "analyze runs/mine": TIME,
    "analyze runs/camera": TIME,
    "analyze robot-and-laptop": TIME,
    "compare runs/mine": r"slower|faster|lost|change",
    "bag drive/ --report": r"health/topics\.html$",
    "bag drive/": r"clocks\.$",
    "--rehearse": r"start",
    "dds-trace sweep": r"(\d+) of \1 recordings? (is|are) complete",
}
"""Part of a line -> what the last sentence of its answer says: the first part that fits."""


def last_sentence(said):
    """The end of an answer, without the names of files after it."""
    lines = [line for line in said.splitlines() if line.strip() and not line.startswith("Wrote ")]
    return "\n".join(lines[-8:])


def expected_end(line):
    return next((code for part, code in ENDS.items() if part in line), 0)


def small(plan, domain):
    """A page's plan with few messages of one size, over sockets: what it asks for would take minutes, and middlewares that not every machine has."""
    plan = re.sub(r'size = \[("\w+").*\]', r"size = \1", plan)
    plan = re.sub(r"messages = \d+", f"messages = 5\nwarmup = 1\nsettle_seconds = 0\ndomain = {domain}", plan)
    return re.sub(r"backend = \[.*\]", 'backend = ["socket"]', plan)


@pytest.mark.keeps(1)
@pytest.mark.middleware
@pytest.mark.parametrize(
    ("page", "made"),
    [
        ("first-answer", ["runs/first/ping.mcap", "runs/mine/analysis/report.html", "again/mine/state.json"]),
        ("bag", ["health/topics.html", "runs/camera/analysis/report.html", "runs/camera-over/analysis/report.html"]),
        ("camera-late", []),
    ],
)
def test_a_tutorial_is_a_transcript(page, made, tmp_path, monkeypatch, domain_id):
    """From top to bottom in one folder, with the shipped files next to it; answers are those of the page."""
    if page == "first-answer":
        pytest.importorskip("rclpy", reason="rclpy is not installed")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_id))
    monkeypatch.setenv("COLUMNS", "80")
    Path("dds-trace").symlink_to(DOCS.parent)
    relay, said = None, ""
    with ExitStack() as stack:
        for part in PART.finditer((DOCS / "tutorials" / f"{page}.md").read_text(encoding="utf-8")):
            if part["plan"]:
                Path(part["plan"]).write_text(small(part["toml"], domain_id))
            elif part["answer"]:
                assert [line for line in part["answer"].splitlines() if line not in said] == []
            elif part["end"]:
                assert relay.stop(signal.SIGINT).status == 0
                relay = None
            for line in (part["sh"] or "").replace("\\\n", "").splitlines():
                if line.startswith("tar "):
                    subprocess.run(shlex.split(line), check=True)
                if not line.startswith("dds-"):
                    continue
                command = RunningCommand(*shlex.split(line))
                stack.callback(command.clean_up)
                if "record relay" in line:
                    relay = command
                    relay.wait_for_line("serves domain")
                else:
                    done = command.finish()
                    allowed = (0, 21) if "--fail-if" in line and not expected_end(line) else (expected_end(line),)
                    assert done.status in allowed, (line, done.stderr)
                    said = done.stdout
                    words = next((words for part, words in LAST_WORDS.items() if part in line), None)
                    last = last_sentence(said or done.stderr)
                    assert words is None or re.search(words, last), (line, last)
                    assert not re.search("not measured under equal|Traceback", said + done.stderr), line
    assert relay is None
    assert [name for name in made if not Path(name).is_file()] == []


BY_HAND = [line for page, line in command_lines() if page.stem == "camera-late" and " record " in line]
"""What a person types in a terminal each, on both devices, until Ctrl-C."""


@pytest.mark.middleware
def test_the_recording_of_a_page_leads_to_an_answer_like_its_own(tmp_path, monkeypatch, domain_id):
    pytest.importorskip("rclpy", reason="rclpy is not installed")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_id))
    driver = [sys.executable, DOCS.parent / "tests/support/topic_publisher.py"]
    topics = re.search(r"--topics (\S+)", "".join(BY_HAND))[1].split(",")
    with ExitStack() as stack:
        for topic in topics:
            publisher = subprocess.Popen([*driver, topic, "20", "100"])
            stack.callback(publisher.wait)
            stack.callback(publisher.terminate)
        running = [RunningCommand(*shlex.split(line)) for line in BY_HAND]
        running += [RunningCommand(*shlex.split(line.replace("robot", "laptop"))) for line in BY_HAND]
        for command in running:
            stack.callback(command.clean_up)
        for command, line in zip(running, 2 * BY_HAND, strict=True):
            command.wait_for_line("your clocks differ by" if "beacon" in line else topics[0])
        for command in running:
            assert command.stop(signal.SIGINT).status == 0
    assert len([*tmp_path.glob("*.mcap")]) == 4
    said = RunningCommand("dds-trace", "analyze", tmp_path).finish().stdout
    assert re.search(TIME, last_sentence(said)), said
    for topic in topics:
        assert re.search(rf"{topic}, on (robot|laptop): one way", said), said


@pytest.mark.parametrize("line", lines_in_text())
def test_options_within_a_sentence_are_those_of_the_program(line, capsys):
    program, *words = shlex.split(line)
    command = typer.main.get_command(
        {"dds-trace": trace.build(words), "dds-record": record.app, "dds-analyze": analyze.app}[program]
    )
    given = list(words)
    while hasattr(command, "commands") and given[:1] and given[0] in command.commands:
        command = command.commands[given.pop(0)]
    known = {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)}
    assert {word for word in words if word.startswith("--")} <= {*known, "--help"}
    is_whole = words[:1] == ["record"] and given != words and not re.search(r"\b[A-Z]{3,}\b", line)
    if is_whole and command.name in ("ping", "relay", "tap", "beacon"):
        options = [*words_of_role(words)[2:], "--out", "new.mcap"]
        command.main(options, standalone_mode=False, obj=lambda options: options.check())
        assert "is a setting now" not in capsys.readouterr().err


RECORDED = list(csv.DictReader((DOCS.parent / "benchmarks/replayed-link.csv").read_text().splitlines()))


def test_each_median_and_count_is_that_of_the_rows():
    page = (DOCS.parent / "benchmarks/replayed-link.md").read_text()
    table = [[cell.strip() for cell in line.split("|")[1:-1]] for line in page.splitlines() if "0 Hz |" in line]
    assert len(table) == 4
    for setup, data, *medians, received in table:
        for load, shown in zip(("none", "cpu"), medians, strict=True):
            own = [
                row
                for row in RECORDED
                if (row["backend"], row["load"]) == (setup.lower().replace(" ", ""), load)
                and (row["data"] == "imu") is ("IMU" in data)
            ]
            ordered = sorted(own, key=lambda row: row["repeat"])
            assert [float(text) for text in shown.split(",")] == [float(row["rtt_p50_ms"]) for row in ordered]
            assert f"{sum(int(row['replies']) for row in own):,}" in received
            assert f"{sum(int(row['sent']) for row in own):,}" in received
    late_us = [float(row["late_p50_us"]) for row in RECORDED]
    assert len(late_us) == 24
    assert f"{max(late_us):g} us in the worst run" in page
    assert max(late_us) < 0.01 * 18_100  # a hundredth of the least delay
    assert (
        f"{sum(int(row['frames']) for row in RECORDED):,}, and {sum(int(row['frames_lost']) for row in RECORDED):,}"
        in page
    )
