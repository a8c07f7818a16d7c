from __future__ import annotations

import csv
import re
import shlex
import shutil
import signal
import sys
import tarfile
from contextlib import ExitStack
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path

import pytest
import typer
from bags import points, write_bag2
from doc_examples import DOCS, PAGES, command_lines, examples, lines_in_text
from processes import RunningCommand
from trace_files import SAMPLES, copy_sample

from dds_trace.analyzer.recordings.topics import analyze_topics
from dds_trace.recorder.sweep.plan.plan_file import parse_plan
from dds_trace.reports.topics.renderers import print_topics

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
    "dds-sweep new mine.toml": "asks questions: tests/cli/test_sweep_new.py answers them",
    "--against ~/venvs/kilted": "needs another environment with another ROS 2",
    "--cluster tcp://scheduler:8786": "needs a Dask scheduler: tests/analyzer/engines/test_cluster.py starts one",
    "--clock runs/": "needs a bag of one of two devices: tests/analyzer/topics/test_clock_of_bags.py records it",
    "dds-analyze docker/runs": "what containers recorded; none is built here",
}
"""Part of a line of a command -> why it is read, but not run."""

OTHER_PROGRAMS = {
    "DDS_TRACE_USER": "Docker is not here",
    "CYCLONEDDS_HOME": "tests/support/secured_cyclone.py builds it",
    "apt-get": "changes the machine",
    "docker": "Docker is not here",
    "mkdir": "belongs to Docker's commands",
    "PATH": "sets up the environment that runs this test",
    "git": "the clone is here",
    "python3": "sets up the environment that runs this test",
    "ssh-copy-id": "the other device is not here",
    "ssh-keygen": "the other device is not here",
    "~/dds-trace-env/bin/pip": "sets up the environment that runs this test",
    "~/venvs/secured/bin/pip": "tests/support/secured_cyclone.py builds it",
    "pip": "sets up the environment that runs this test",
    "scp": "the other device is not here",
    "source": "sets up the environment that runs this test",
    "sudo": "changes the machine",
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
    write_bag2(folder / "drive", {"/lidar/points": [points(n) for n in range(20, 40)]})
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


def run(line, monkeypatch):
    """Run a command in this process as far as its first message; how it ended."""
    monkeypatch.setattr("dds_trace.cli.record.tools.rehearse", lambda *_: None)
    monkeypatch.setattr("dds_trace.recorder.sweep.rehearsal.rehearse_plan", lambda *_, **__: {})
    monkeypatch.setattr("dds_trace.recorder.sweep.rehearsal.check_plan", lambda *_: {})
    program, *arguments = shlex.split(line)
    (command,) = entry_points(group="console_scripts", name=program)
    shown = {"--list", "--print-config"} & set(arguments)
    more = {"dds-bridge": [] if shown else ["--print-config"], "dds-record": ["--check"], "dds-sweep": ["--dry-run"]}
    monkeypatch.setattr(sys, "argv", [program, *arguments, *more.get(program, [])])
    with pytest.raises(SystemExit) as ended:
        command.load()()
    return ended.value


DEFAULTS = DOCS / "how-to" / "defaults.md"
PLANS = [block for block in examples("toml") if block.page != DEFAULTS]


@pytest.mark.parametrize("block", PLANS, ids=lambda block: block.name)
def test_a_plan_of_a_page_is_one(block):
    """What is a part of a plan on the page, such as `[search]`, is completed."""
    start = "" if "[run]" in block.text else "[run]\nmessages = 10\n"
    assert parse_plan(start + block.text, block.page.stem, block.name).cells


def test_the_defaults_of_the_page_are_in_force(tmp_path, monkeypatch, capsys):
    (block,) = examples("toml", DEFAULTS)
    (tmp_path / "dds-trace.toml").write_text(block.text)
    monkeypatch.setenv("DDS_TRACE_CONFIG", str(tmp_path / "dds-trace.toml"))
    monkeypatch.chdir(tmp_path)
    started = run("dds-record --role ping --out ping.mcap", monkeypatch)
    assert started.code == 0
    assert "dds-trace.toml" in capsys.readouterr().err


@pytest.mark.parametrize("line", [line for line in LINES if not any(part in line for part in NOT_RUN)])
def test_a_command_of_a_page_runs_as_far_as_its_first_message(line, desk, monkeypatch, capsys):
    monkeypatch.chdir(desk)
    ended = run(line, monkeypatch)
    assert ended.code in ((0, 21) if "--fail-if" in line else (0,)), capsys.readouterr().err


@pytest.mark.middleware
@pytest.mark.parametrize(
    ("page", "made"),
    [
        ("first-answer", ["runs/first/ping.mcap", "runs/mine/state.json", "runs/mine/analysis/report.html"]),
        ("bag", ["runs/lidar/analysis/report.html"]),
    ],
)
def test_a_tutorial_leads_to_its_answer(page, made, desk, tmp_path, monkeypatch, domain_id):
    """Its commands in their order, as they stand; a plan of sockets and few messages stands for its own."""
    if page == "first-answer":
        pytest.importorskip("rclpy", reason="rclpy is not installed")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_id))
    shutil.copytree(desk / "drive", "drive")
    for plan in ("mine.toml", "lidar.toml"):
        Path(plan).write_text(SMALL_PLAN.format(domain=domain_id))
    relay = None
    with ExitStack() as stack:
        for block in examples("sh", DOCS / "tutorials" / f"{page}.md"):
            for line in block.text.splitlines():
                if not line.startswith("dds-"):
                    continue
                if relay is not None and line.startswith("dds-analyze"):  # the page ends it with Ctrl-C before
                    assert relay.stop(signal.SIGINT).status == 0
                    relay = None
                command = RunningCommand(*shlex.split(line))
                stack.callback(command.clean_up)
                if "--role relay" in line:
                    relay = command
                    relay.wait_for_line("serves domain")
                else:
                    done = command.finish()
                    assert done.status == 0, (line, done.stderr)
    assert [name for name in made if not Path(name).is_file()] == []


@pytest.mark.parametrize("line", lines_in_text())
def test_options_within_a_sentence_are_those_of_the_program(line):
    program, *words = shlex.split(
        line.replace("dds-trace compare", "dds-analyze compare").replace("dds-trace ", "dds-")
    )
    module = import_module(f"dds_trace.cli.{program[4:]}" + ".command" * (program in ("dds-record", "dds-sweep")))
    command = typer.main.get_command(getattr(module, "COMMANDS", {}).get(words[0], module.app))
    known = {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)}
    assert {word for word in words if word.startswith("--")} <= known
    if program == "dds-record" and "--role" in words and not re.search(r"\b[A-Z]{3,}\b", line):
        command.main([*words, "--out", "new.mcap"], standalone_mode=False, obj=lambda options: options.check())


def test_the_tutorial_quotes_the_card_of_the_kept_bag(tmp_path, monkeypatch, capsys):
    archive = DOCS / "results" / "drive" / "traces.tar.xz"
    assert archive.stat().st_size <= 1_000_000
    with tarfile.open(archive) as bag:
        bag.extractall(tmp_path, filter="data")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    print_topics(analyze_topics([Path("drive")]))
    shown = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    text = (DOCS / "tutorials" / "bag.md").read_text(encoding="utf-8")
    quoted = re.findall(r"```text\n(.*?)```", text, re.DOTALL)[0]
    assert [line.rstrip() for line in quoted.splitlines() if line.rstrip() not in shown] == []


RECORDED = list(csv.DictReader((DOCS / "results/replayed-link.csv").read_text().splitlines()))


def test_each_median_and_count_is_that_of_the_rows():
    lines = (DOCS / "results/replayed-link.md").read_text().splitlines()
    table = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines if "0 Hz |" in line]
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


def test_frames_are_late_by_less_than_a_hundredth_of_the_least_delay():
    late_us = [float(row["late_p50_us"]) for row in RECORDED]
    page = (DOCS / "results/replayed-link.md").read_text()
    assert len(late_us) == 24
    assert f"{max(late_us):g} us in the worst run" in page
    assert max(late_us) < 0.01 * 18_100
    assert (
        f"{sum(int(row['frames']) for row in RECORDED):,}, and {sum(int(row['frames_lost']) for row in RECORDED):,}"
        in page
    )
