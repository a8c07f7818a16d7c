"""`action.yml` and the example for GitLab: their scripts are taken out of the files and run, on the socket backend.

`gh`, `git` and `curl` are stand-ins that write down what they were called with.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
import yaml
from warm_start import stand_ins
from wording import numbers

pytestmark = pytest.mark.timeout(300)

ROOT = Path(__file__).parents[2]
ACTION = yaml.safe_load((ROOT / "action.yml").read_text())
STEPS = {step["id"]: step for step in ACTION["runs"]["steps"]}
GITLAB = yaml.safe_load((ROOT / "docs/examples/gitlab-ci.yml").read_text())["latency"]
EXPRESSION = re.compile(r"\$\{\{ (\S+) \}\}")
PLAN = """
[run]
messages = 20
warmup = 2
settle_seconds = 0
repeats = {repeats}
domain = {domain}
[axes]
backend = "socket"
size = "1KB"
rate = 200
"""
STAND_IN = """#!/bin/bash
printf '%s\\n' "$0 $*" >> calls.log
case "$*" in *--jq*) printf '%s' "$COMMENTS" ;; esac
"""


@pytest.fixture
def desk(tmp_path, domain_id):
    """A workspace with the plans of both sides, and stand-ins before everything else on the PATH."""

    def prepare(repeats):
        (tmp_path / "main").mkdir()
        for path in (tmp_path / "main/plan.toml", tmp_path / "plan.toml"):
            path.write_text(PLAN.format(repeats=repeats, domain=domain_id))
        (tmp_path / "bin").mkdir()
        for name in ("gh", "git", "curl"):
            program = tmp_path / "bin" / name
            program.write_text(STAND_IN)
            program.chmod(0o755)
        return tmp_path

    return prepare


def bash(script, folder, environment):
    """A script as a step of a composite action, or GitLab's runner, has it run."""
    path = f"{folder / 'bin'}:{stand_ins()}:{Path(sys.executable).parent}:{os.environ['PATH']}"
    return subprocess.run(
        ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", script],
        cwd=folder,
        env=os.environ | {"PATH": path} | environment,
        capture_output=True,
        text=True,
        check=False,
    )


class Job:
    def __init__(self, folder, **inputs):
        self.folder = folder
        self._values = {f"inputs.{name}": each.get("default", "") for name, each in ACTION["inputs"].items()}
        self._values |= {f"inputs.{name.replace('_', '-')}": value for name, value in inputs.items()}
        self._values |= {"github.repository": "robots/arm", "github.event.pull_request.number": "7"}

    def run(self, step, **environment):
        output = self.folder / f"output-{step}"
        env = {
            name: EXPRESSION.sub(lambda found: self._values[found[1]], text)
            for name, text in STEPS[step]["env"].items()
        }
        files = {"GITHUB_OUTPUT": str(output), "GITHUB_STEP_SUMMARY": str(self.folder / "summary.md")}
        done = bash(STEPS[step]["run"], self.folder, env | files | environment)
        if output.exists():
            said = dict(line.split("=", 1) for line in output.read_text().splitlines())
            self._values |= {f"steps.{step}.outputs.{name}": value for name, value in said.items()}
        return done


def test_every_expression_of_the_action_names_something_that_is_there():
    text = (ROOT / "action.yml").read_text()
    for name in EXPRESSION.findall(text):
        room, _, rest = name.partition(".")
        if room == "inputs":
            assert rest in ACTION["inputs"]
        elif room == "steps":
            step, _, output = rest.partition(".outputs.")
            assert f"{output}=" in STEPS[step]["run"].replace("$side=", "base= new=")
        else:
            assert room == "github"


@pytest.mark.parametrize(("has_ros", "extras"), [(False, "analyze,ros2"), (True, "analyze")])
def test_a_stock_runner_gets_ros_2_and_one_that_has_it_does_not(desk, has_ros, extras):
    folder = desk(repeats=1)
    python = folder / "bin/python3"
    python.write_text(
        f'#!/bin/bash\n[ "$1" = -c ] && exit {int(not has_ros)}\n'
        'mkdir -p "$4/bin" && ln -sf "$(readlink -f bin/gh)" "$4/bin/python"\n'
    )
    python.chmod(0o755)
    (folder / "bin/uname").write_text("#!/bin/bash\necho x86_64\n")
    (folder / "bin/uname").chmod(0o755)
    job = Job(folder)
    job._values |= {"github.action_path": "/action"}
    done = job.run("install", RUNNER_TEMP=str(folder), GITHUB_PATH=str(folder / "path"))
    assert done.returncode == 0, done.stderr
    assert (folder / "calls.log").read_text().rstrip().endswith(f"/action[{extras}]")


@pytest.mark.middleware
def test_an_undecided_action_passes_with_a_warning_or_fails_and_writes_one_comment_anew(desk):
    job = Job(desk(repeats=1), base="main/plan.toml", new="plan.toml", looks="2")
    done = job.run("compare")
    assert done.returncode == 0, done.stderr
    first = done.stdout.splitlines()[0]
    assert numbers(first)[0] == numbers(first)[-2] == 2, first  # looks, recordings
    assert re.search(r"about \d+ s$", first), first
    # Both sides grow until the gates decide.
    out = job.folder / "dds-trace"
    assert [sorted(look.name for look in (out / side).iterdir()) for side in ("base", "new")] == [["1", "2"]] * 2
    assert (job.folder / "summary.md").read_text().startswith("# Comparison of latency\n")
    suites = ET.parse(job.folder / "dds-trace/gates.xml").getroot()
    assert (suites.get("tests"), suites.get("skipped")) == ("3", "3")
    assert len(re.findall("^::warning title=", done.stdout, re.MULTILINE)) == 3
    assert '"message": "inconclusive"' in (job.folder / "dds-trace/badge.json").read_text()

    verdict = job.run("verdict")
    assert (verdict.returncode, "::warning::" in verdict.stdout) == (0, True)
    strict = Job(job.folder, strict="true")
    strict._values |= {name: value for name, value in job._values.items() if name.startswith("steps.")}
    assert strict.run("verdict").returncode == 21

    for comments in ("", "31\n42"):
        assert job.run("comment", COMMENTS=comments).returncode == 0
    calls = (job.folder / "calls.log").read_text().splitlines()
    asked, posted, _, patched = (call.split("/bin/gh ")[1] for call in calls)
    assert asked.startswith("api --paginate repos/robots/arm/issues/7/comments --jq ")
    body = "--field body=@dds-trace/comment.md"
    assert posted == f"api --method POST repos/robots/arm/issues/7/comments {body}"
    assert patched == f"api --method PATCH repos/robots/arm/issues/comments/31 {body}"
    mark, title = (job.folder / "dds-trace/comment.md").read_text().splitlines()[:2]
    assert (mark, title) == ("<!-- dds-trace -->", "# Comparison of latency")


@pytest.mark.middleware
def test_an_action_whose_gate_fails_ends_with_its_exit_code(desk):
    gates = "latency_p50 > 100ns\nreceived_ratio < 1%\n"
    job = Job(desk(repeats=3), base="main/plan.toml", new="plan.toml", fail_if=gates)
    done = job.run("compare")
    assert done.returncode == 0, done.stderr
    verdict = job.run("verdict")
    assert verdict.returncode == 20, verdict.stderr
    assert "::error::latency: regressed" in verdict.stdout
    cases = ET.parse(job.folder / "dds-trace/gates.xml").iter("testcase")
    failed = [case.get("name") for case in cases if case.find("failure") is not None]
    assert failed == ["latency_p50 > 100ns"]


@pytest.mark.middleware
def test_the_example_for_gitlab_ends_with_the_code_that_its_job_allows_and_leaves_a_note(desk):
    folder = desk(repeats=1)
    variables = {
        "CI_MERGE_REQUEST_TARGET_BRANCH_NAME": "main",
        "CI_API_V4_URL": "https://gitlab.example/api/v4",
        "CI_PROJECT_ID": "12",
        "CI_MERGE_REQUEST_IID": "34",
        "LATENCY_TOKEN": "secret",
    }
    done = bash("\n".join(GITLAB["script"]), folder, variables)
    assert done.returncode in GITLAB["allow_failure"]["exit_codes"], done.stderr
    assert done.stdout.startswith("up to 5 looks, each: plan ")
    for path in (*GITLAB["artifacts"]["paths"], GITLAB["artifacts"]["reports"]["junit"]):
        assert (folder / path).is_file()
    worktree, note = (folder / "calls.log").read_text().splitlines()
    assert worktree.endswith("/bin/git worktree add --force main origin/main")
    assert note.endswith("https://gitlab.example/api/v4/projects/12/merge_requests/34/notes")
    assert "PRIVATE-TOKEN: secret" in note
