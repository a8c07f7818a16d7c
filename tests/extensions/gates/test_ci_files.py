"""`action.yml` and the example for GitLab: their scripts are taken out of the files and run, on the socket backend.

`gh`, `git` and `curl` are stand-ins that write down what they were called with, and answer what `ANSWER` says.
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from textwrap import dedent
from xml.etree import ElementTree as ET

import pytest
import yaml
from processes import executed, socket_plan
from warm_start import stand_ins
from wording import numbers

from dds_trace.extensions.campaigns.against import against_seconds
from dds_trace.extensions.campaigns.plan.plan_file import read_plan
from dds_trace.extensions.gates.report import SIGNATURE

ROOT = Path(__file__).parents[3]
ACTION = yaml.safe_load((ROOT / "action.yml").read_text())
STEPS = {step["id"]: step for step in ACTION["runs"]["steps"]}
GITLAB = yaml.safe_load((ROOT / "docs/examples/gitlab-ci.yml").read_text())["latency"]
EXPRESSION = re.compile(r"\$\{\{ (\S+) \}\}")
STAND_IN = """printf '%s\\n' "$0 $*" >> calls.log
case "$*" in *"api user"*) [ -n "$LOGIN" ] && echo "$LOGIN" || exit 1 ;; *--jq*) printf '%s' "$COMMENTS" ;; esac
case "$*" in */user) echo '{"id": 5}' ;; */notes?per*) printf '%s' "$NOTES" ;; esac
"""


def stub(folder, name, script):
    path = folder / "bin" / name
    path.write_text(f"#!/bin/bash\n{script}")
    path.chmod(0o755)


@pytest.fixture
def desk(tmp_path, domain_id):
    """A workspace with the plans of both sides, and stand-ins before everything else on the PATH."""

    def prepare(repeats):
        (tmp_path / "main").mkdir()
        for path in (tmp_path / "main/plan.toml", tmp_path / "plan.toml"):
            path.write_text(socket_plan(domain_id, repeats=repeats))
        (tmp_path / "bin").mkdir()
        for name in ("gh", "git", "curl"):
            stub(tmp_path, name, STAND_IN)
        return tmp_path

    return prepare


def bash(script, folder, environment):
    """A script as a step of a composite action, or GitLab's runner, has it run."""
    path = f"{folder / 'bin'}:{stand_ins()}:{Path(sys.executable).parent}:{os.environ['PATH']}"
    words = ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", script]
    return executed(words, {"PATH": path} | environment, cwd=folder)


class Job:
    def __init__(self, folder, **inputs):
        self.folder = folder
        self._values = {f"inputs.{name}": each.get("default", "") for name, each in ACTION["inputs"].items()}
        self._values |= {f"inputs.{name.replace('_', '-')}": value for name, value in inputs.items()}
        self._values |= {"github.repository": "robots/arm"}
        self.event("7", "robots/arm")

    def run(self, step, **environment):
        output = self.folder / f"output-{step}"
        env = {
            name: EXPRESSION.sub(lambda found: self._values.get(found[1], ""), str(text))
            for name, text in STEPS[step]["env"].items()
        }
        files = {"GITHUB_OUTPUT": str(output), "GITHUB_STEP_SUMMARY": str(self.folder / "summary.md")}
        done = bash(STEPS[step]["run"], self.folder, env | files | environment)
        if output.exists():
            said = dict(line.split("=", 1) for line in output.read_text().rstrip("\n").split("\n"))
            self._values |= {f"steps.{step}.outputs.{name}": value for name, value in said.items()}
        return done

    def event(self, number, head):
        self._values |= {"github.event.pull_request.number": number}
        self._values |= {"github.event.pull_request.head.repo.full_name": head}
        terms = (EXPRESSION.sub(lambda found: self._values.get(found[1], ""), STEPS["comment"]["if"]), number)
        return all(terms)


def test_the_plan_of_the_page_takes_less_than_four_minutes(tmp_path):
    page = (ROOT / "docs/how-to/ci.md").read_text()
    (tmp_path / "plan.toml").write_text(dedent(page[page.index("       [run]") : page.index("2. Add [this workflow]")]))
    plan = read_plan(tmp_path / "plan.toml", list)
    assert plan.run.repeats >= 3
    assert against_seconds(plan, plan).seconds < 240


def test_every_expression_of_the_action_names_something_that_is_there():
    text = (ROOT / "action.yml").read_text()
    for name in EXPRESSION.findall(text):
        room, _, rest = name.partition(".")
        if room == "inputs":
            assert rest in ACTION["inputs"]
        elif room == "steps":
            step, _, output = rest.partition(".outputs.")
            assert f"output {output} " in STEPS[step]["run"]
        else:
            assert room == "github"


@pytest.mark.parametrize(("has_ros", "extras"), [(False, "analyze,ros2"), (True, "analyze")])
def test_a_stock_runner_gets_ros_2_and_one_that_has_it_does_not(desk, has_ros, extras):
    folder = desk(repeats=1)
    python = (
        f'[ "$1" = -c ] && exit {int(not has_ros)}\nmkdir -p "$4/bin" && ln -sf "$(readlink -f bin/gh)" "$4/bin/python"'
    )
    stub(folder, "python3", python)
    stub(folder, "uname", "echo x86_64")
    job = Job(folder)
    job._values |= {"github.action_path": "/action"}
    done = job.run("install", RUNNER_TEMP=str(folder), GITHUB_PATH=str(folder / "path"))
    assert done.returncode == 0, done.stderr
    assert (folder / "calls.log").read_text().rstrip().endswith(f"/action[{extras}]")


@pytest.mark.middleware
def test_an_undecided_action_passes_with_a_warning_or_fails_and_says_nothing_new(desk):
    job = Job(desk(repeats=1), base="main/plan.toml", new="plan.toml", looks="2")
    (job.folder / "dds-trace.toml").write_text("[compare]\nallow-missing = true\nlooks = 99\n")  # decides nothing
    done = job.run("compare")
    assert done.returncode == 0, done.stderr
    first = done.stderr.splitlines()[0]
    assert numbers(first)[0] == numbers(first)[-2] == 2, first  # looks, recordings
    assert re.search(r"about \d+ s$", first), first
    # Both sides grow until the gates decide.
    for side in ("base", "new"):
        assert len(list(job.folder.glob(f"dds-trace/plan-against-plan/{side}/*.ping.mcap"))) == 2
    assert "# Comparison of latency\n" in (job.folder / "summary.md").read_text()
    suites = ET.parse(job.folder / "dds-trace/gates.xml").getroot()
    assert (suites.get("tests"), suites.get("skipped")) == ("3", "3")
    assert len(re.findall("^::warning title=", done.stdout, re.MULTILINE)) == 3
    assert '"message": "undecided"' in (job.folder / "dds-trace/badge.json").read_text()
    for strict, status in (("false", 0), ("true", 21)):
        verdict = job.run("verdict", STRICT=strict)
        assert (verdict.returncode, "::warning::" in verdict.stdout) == (status, status == 0)
    assert job.run("comment", COMMENTS="").returncode == 0
    assert "POST" not in (job.folder / "calls.log").read_text(), "nothing changed"


@pytest.mark.parametrize(
    ("changed", "comments", "head", "login", "method"),
    [
        (True, "", "robots/arm", "", "POST"),
        (False, "", "robots/arm", "", None),
        (False, "31\n42", "robots/arm", "robot", "PATCH"),
        (True, "", "stranger/arm", "", None),
    ],
)
def test_a_comment_comes_where_something_changed_and_only_an_own_one_is_updated(
    desk, changed, comments, head, login, method
):
    job = Job(desk(repeats=1))
    assert not job.event("", ""), "a push has no comments"
    assert job.event("7", head)
    (job.folder / "dds-trace").mkdir()
    (job.folder / "dds-trace/comparison.md").write_text("# Comparison of latency\n")
    (job.folder / "dds-trace/comparison.json").write_text(json.dumps({"changed": changed}, indent=1))
    done = job.run("comment", COMMENTS=comments, LOGIN=login)
    assert done.returncode == 0, done.stderr
    log = job.folder / "calls.log"
    calls = [call.split("/bin/gh ")[1] for call in log.read_text().splitlines()] if log.exists() else []
    if head == "stranger/arm":
        assert (calls, "::notice::" in done.stdout) == ([], True)
        return
    assert calls[0] == "api user --jq .login"
    assert "select(.user.login == $ENV.AUTHOR and" in calls[1]
    number = "issues/comments/31" if comments else "issues/7/comments"
    sent = f"api --method {method} repos/robots/arm/{number} --field body=@dds-trace/comparison.md"
    assert calls[2:] == ([sent] if method else [])
    assert f'startswith("{SIGNATURE}")' in calls[1]


@pytest.mark.parametrize(
    ("inputs", "status", "word"),
    [
        ({"looks": "99"}, 2, "looks"),
        ({"strict": "yes"}, 2, "strict"),
        ({"out": "dds-trace\nstatus=0"}, 2, "one line"),
        ({"base": "gone.toml\n::error::forged"}, 2, "one line"),
        ({"new": "missing.toml"}, 2, "missing.toml"),
        ({"base": "main/other.toml"}, 0, "No base yet"),
        ({"fail_if": "latncy_p50 > +10%"}, 2, "did you mean"),
        ({"new": "notes.txt"}, 2, "--against"),
        ({"base": "ssh.toml", "new": "venv"}, 2, "--against ENVIRONMENT"),  # and another device
    ],
)
def test_an_input_that_is_refused_and_a_first_pull_request_are_one_line(desk, inputs, status, word):
    job = Job(desk(repeats=1), **{"base": "main/plan.toml", "new": "plan.toml", **inputs})
    (job.folder / "notes.txt").write_text("no plan\n")
    robot = '[devices.relay]\nssh = "pi@192.0.2.1"\n'  # reserved for documentation: nothing is asked there
    (job.folder / "ssh.toml").write_text((job.folder / "plan.toml").read_text() + robot)
    (job.folder / "venv/bin").mkdir(parents=True)
    (job.folder / "venv/bin/dds-record").touch()
    done = job.run("compare")
    said = done.stdout + done.stderr
    assert (done.returncode, word in said, said.count("\n")) == (status, True, 1), said
    assert not list(job.folder.glob("dds-trace/*"))
    if status == 0:
        assert (job.run("verdict").returncode, job.run("comment").returncode) == (0, 0)
        assert "No base yet" in (job.folder / "summary.md").read_text()
        assert not (job.folder / "calls.log").exists()


@pytest.mark.parametrize(
    "odd", ['a "quoted" \\ name', "it's $(touch made) `touch made`; *", "tab\t{}[]:,#&", "\u2028 ü ↯"]
)
def test_what_the_action_writes_is_whole_for_any_name(desk, odd):
    folder = desk(repeats=1)
    stub(
        folder,
        "dds-trace",
        f"""[ "$1" = sweep ] || exec "{stand_ins()}/dds-trace" "$@"
for side in base new; do mkdir -p "$6/$NAME" && cp -r "{ROOT}/sample_traces/same_domain" "$6/$NAME/$side"; done; exit 21""",
    )
    gates = "latency_p50 > 10s\n\nlatency_p99 > +1000%"
    job = Job(folder, base="main/plan.toml", new=odd, fail_if=gates, looks="1", out=f"out {odd}")
    done = job.run("compare", NAME=f"plan {odd}", PATH=f"{folder / 'bin'}:{os.environ['PATH']}")
    assert done.returncode == 0, done.stderr
    said = dict(line.split("=", 1) for line in (folder / "output-compare").read_text().rstrip("\n").split("\n"))
    assert {"base", "new", "outcome", "status"} == said.keys()
    assert (folder / said["base"]).samefile(folder / f"out {odd}" / f"plan {odd}" / "base")
    out = folder / f"out {odd}"
    compared, badge = (json.loads((out / f"{name}.json").read_text()) for name in ("comparison", "badge"))
    assert ({gate["gate"] for gate in compared["gates"]}, badge["schemaVersion"]) == ({*gates.split("\n\n")}, 1)
    assert ET.parse(out / "gates.xml").getroot().get("tests") == str(len(compared["gates"]))
    assert all(line.startswith("::") for line in (out / "annotations.txt").read_text().splitlines())
    assert not list(folder.rglob("made"))


DRIVER = """
import psutil, socket, time
psutil.cpu_percent = lambda percpu: [0.0] * psutil.cpu_count()
psutil.Process.cpu_percent = lambda _: 0.0
class Slow(socket.socket):
    def sendmsg(self, *arguments):
        time.sleep({delay})
        return super().sendmsg(*arguments)
socket.socket = Slow
"""


def environment(folder, delay):
    """A Python environment with dds-trace and a package of the pull request, a driver that waits before it sends.

    It says that the machine is idle: where other tests load it more on one side, the gate rightly decides nothing.
    """
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
    (site,) = folder.glob("lib/python*/site-packages")
    installed = next(path for path in sys.path if path.endswith("site-packages"))
    (site / "radio_driver.py").write_text(DRIVER.format(delay=delay))
    (site / "installed.pth").write_text(f"import site; site.addsitedir({installed!r})\nimport radio_driver\n")
    for name in ("dds-record", "dds-trace"):
        program = folder / "bin" / name
        program.write_text(
            (Path(sys.executable).parent / name).read_text().replace(sys.executable, f"{folder}/bin/python")
        )
        program.chmod(0o755)
    return folder


def test_the_first_workflow_of_the_page_installs_both_sides_and_gives_them_to_the_action(desk):
    folder = desk(repeats=1)
    stub(folder, "python3", 'mkdir -p "$3/bin"; ln -s "$PWD/bin/gh" "$3/bin/python"')
    first = yaml.safe_load((ROOT / "docs/examples/github-gate.yml").read_text())["jobs"]["latency"]["steps"]
    (script,) = (step["run"] for step in first if "run" in step)
    done = bash(script, folder, {"RUNNER_TEMP": str(folder / "temp"), "GITHUB_PATH": str(folder / "path")})
    assert done.returncode == 0, done.stderr
    calls = [call.partition("temp/")[2] for call in (folder / "calls.log").read_text().splitlines()]
    install = (
        "bin/python -m pip install --quiet dds-trace[analyze,ros2] @ git+https://github.com/OWNER/dds-trace@VERSION"
    )
    assert calls == [f"base/{install} ./main", f"new/{install} ."]
    assert (folder / "path").read_text() == f"{folder}/temp/base/bin\n"
    (given,) = (step["with"] for step in first if step.get("uses", "").startswith("OWNER/dds-trace"))
    assert given.keys() <= ACTION["inputs"].keys()
    assert (given["base"], given["new"]) == ("main/plan.toml", "${{ runner.temp }}/new")


def test_the_workflow_with_a_history_feeds_each_tool(desk):
    """The traces of the stand-in for the sweep are the samples."""
    folder = desk(repeats=1)
    traces = ROOT / "sample_traces/same_domain"
    stub(folder, "dds-trace", f'[ "$1" = sweep ] && exec cp -r "{traces}" runs; exec "{stand_ins()}/dds-trace" "$@"')
    for name in ("bencher", "otava"):
        stub(folder, name, "echo $* >> tools.log")
    (folder / "history").mkdir()
    steps = yaml.safe_load((ROOT / "docs/examples/github-history.yml").read_text())["jobs"]["history"]["steps"]
    for script in [step["run"].replace("/srv/history", "history") for step in steps if "run" in step]:
        done = bash(script, folder, {"PROJECT": "my-robot", "GITHUB_SHA": "1a2b"})
        assert done.returncode == 0, done.stderr
    assert [row.split(",")[1] for row in (folder / "history/latency.csv").read_text().splitlines()] == [
        "commit",
        "1a2b",
    ]
    (uses,) = (step["with"] for step in steps if "benchmark" in step.get("uses", ""))
    assert (folder / uses["output-file-path"]).is_file()
    assert "--adapter json --file analysis/bencher.json" in (folder / "tools.log").read_text()


@pytest.mark.thorough
@pytest.mark.middleware
@pytest.mark.parametrize(("delay", "status"), [(0.02, 0), (0.2, 20)])
def test_a_slower_package_in_the_environment_of_the_pull_request_fails_the_gate(desk, tmp_path, delay, status):
    """Both sides wait far longer than a busy machine delays them, so that runs of one side are alike."""
    folder = desk(repeats=3)
    base, new = (environment(tmp_path / name, late) for name, late in (("base", 0.02), ("new", delay)))
    job = Job(folder, base="plan.toml", new=str(new), fail_if="latency_p50 > +50%\nreceived_ratio < 1%\n", looks="1")
    done = job.run("compare", PATH=f"{folder / 'bin'}:{base / 'bin'}:{os.environ['PATH']}")
    assert done.returncode == 0, done.stderr
    verdict = job.run("verdict")
    assert (verdict.returncode, "::error::latency: regressed" in verdict.stdout) == (status, status == 20)
    cases = ET.parse(folder / "dds-trace/gates.xml").iter("testcase")
    assert [case.get("name") for case in cases if case.find("failure") is not None] == ["latency_p50 > +50%"] * (
        status > 0
    )
    compared = json.loads((folder / "dds-trace/comparison.json").read_text())
    assert {row["pairs"] for row in compared["groups"][0]["changes"] if row["statistic"] == "p50"} <= {3, 4}
    assert not [note for note in compared["notes"] if "Measured in turns" in note or "nvironment" in note]


@pytest.mark.keeps(1)
@pytest.mark.middleware
@pytest.mark.parametrize(
    ("gate", "notes", "sent"),
    [
        ("default", [], None),
        ("default", [{"id": 3, "author": {"id": 9}}, {"id": 4, "author": {"id": 5}}], "PUT"),
        ("latency_p50 > 100ns", [{"id": 3, "author": {"id": 9}}], "POST"),
    ],
)
def test_the_example_for_gitlab_ends_with_the_code_that_its_job_allows_and_leaves_a_note(desk, gate, notes, sent):
    repeats = 1 if gate == "default" else 3
    folder = desk(repeats=repeats)
    variables = {
        "CI_MERGE_REQUEST_TARGET_BRANCH_NAME": "main",
        "CI_API_V4_URL": "https://gitlab.example/api/v4",
        "CI_PROJECT_ID": "12",
        "CI_MERGE_REQUEST_IID": "34",
        "LATENCY_TOKEN": "secret",
        "NOTES": json.dumps([{**note, "body": SIGNATURE} for note in notes]),
    }
    looks = "--looks 5" if sent == "POST" else "--looks 1"  # the gates decide at the first
    script = "\n".join(GITLAB["script"]).replace("default", f"'{gate}'").replace("--looks 5", looks)
    done = bash(script, folder, GITLAB["variables"] | variables)
    names = [trace.name.partition("_r")[2] for trace in folder.glob("dds-trace/*/base/*.ping.mcap")]
    numbers = {int(name.partition(".")[0] or 1) for name in names}
    assert {*range(1, repeats + 1)} <= numbers <= {*range(1, 2 * repeats + 1)}  # one look; busier repeats again
    assert done.returncode in ([20] if sent == "POST" else GITLAB["allow_failure"]["exit_codes"]), done.stderr
    assert done.stderr.startswith("up to 5 looks, each: plan " if sent == "POST" else "plan ")
    for path in (*GITLAB["artifacts"]["paths"], GITLAB["artifacts"]["reports"]["junit"]):
        assert (folder / path).is_file()
    worktree, _, _, *note = (folder / "calls.log").read_text().splitlines()
    assert worktree.endswith("/bin/git worktree add --force main origin/main")
    assert len(note) == (sent is not None)
    if sent:
        where = "https://gitlab.example/api/v4/projects/12/merge_requests/34/notes"
        assert note[0].endswith(where + ("/4" if sent == "PUT" else ""))
        assert f"PRIVATE-TOKEN: secret --request {sent} --data-urlencode body@dds-trace/comparison.md" in note[0]


def test_a_first_merge_request_has_no_base(desk):
    folder = desk(repeats=1)
    (folder / "main/plan.toml").unlink()
    done = bash("\n".join(GITLAB["script"]), folder, {"CI_MERGE_REQUEST_TARGET_BRANCH_NAME": "main"})
    assert (done.returncode, done.stdout.count("\n")) == (0, 1), done.stderr
