import json
import os
import re
import shlex
from dataclasses import replace
from itertools import count
from pathlib import Path

import pytest
import typer
from commands import run_trace
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from namespaces import needs_namespaces
from rich.console import Console

from dds_trace.analyzer.loading.campaign import Campaign
from dds_trace.base.errors import OptionError
from dds_trace.extensions.campaigns.commands.dry_run import argument_check
from dds_trace.extensions.campaigns.plan.plan_file import parse_plan
from dds_trace.extensions.campaigns.rehearsal import rehearse_plan
from dds_trace.extensions.campaigns.run.progress import make_progress
from dds_trace.extensions.campaigns.station.emulation import ip
from dds_trace.extensions.campaigns.sweep import run_sweep

HEAD = """
[run]
messages = 3
warmup = 0
settle_seconds = 0
attempts = 1
domain = {}
ping_domain = {}
"""


@pytest.fixture
def plan(tmp_path, domains):
    def write(text):
        path = tmp_path / "small.toml"
        path.write_text(HEAD.format(domains.take(), domains.take()) + text)
        return path

    return write


@pytest.mark.middleware
@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("rmw = 'rmw_fastrtps_cpp'", "--rmw rmw_fastrtps_cpp: the backend socket has no ROS middleware"),
        ("executor = 'single'", "-o executor=single: the backend socket has none"),
        ("transport = 'shm'", "-o transport=shm: the backend socket only has"),
        ("[devices.ping]\noptions = ['--depth', '0']", "--depth 0"),
        ("data = 'file:/nowhere/at/all'", "--data file:/nowhere/at/all: No such file"),
        ("[devices.ping]\noptions = ['--data', 'photos']", "there is no data type 'photos'"),
        ("data = 'imu'\nsize = '33KB'", "--size 33000"),
        ("[devices.ping]\noptions = ['--rate', '1e9']", "--rate 1e+09"),
        ("bridge = 'integration-service'", "integration-service"),
        ("[devices.ping]\noptions = ['--realtme', '50']", "No such option: --realtme"),
        ("[devices.ping]\noptions = ['--cpu-affinity', '4000']", "CPU 4000 is not among those"),
        ("[devices.ping]\noptions = ['--role', 'relay']", "cannot be given to a relay"),
        ("[devices.relay]\noptions = ['--type', 'nonsense']", "nonsense"),
    ],
)
def test_what_the_recorder_would_refuse_is_known_before_it_starts(call, plan, tmp_path, text, reason):
    code, out, err = call(plan(f"[axes]\nbackend = 'socket'\n{text}\n"), "--rehearse", "--out", tmp_path)
    assert code == 10, err
    assert "cannot start: " in err
    assert reason in err
    assert "plan small: 1 recording" in out
    assert not (tmp_path / "small").exists()


@pytest.mark.middleware
def test_a_plan_that_can_start_ends_with_0_and_names_what_cannot_in_json(call, plan, tmp_path):
    two = plan("[axes]\nbackend = 'socket'\ntransport = ['default', 'shm']\n")
    code, out, _ = call(two, "--rehearse", "--json", "--out", tmp_path)
    shown = json.loads(out)
    assert code == 10
    ((name, reason),) = shown["cannot_start"].items()
    assert (name in [cell["name"] for cell in shown["cells"]], "-o transport=shm" in reason) == (True, True)
    one = plan("[axes]\nbackend = 'socket'\n")
    assert call(one, "--rehearse", "--json", "--out", tmp_path)[0] == 0


def test_a_remedy_in_a_folder_of_a_sweep_is_a_command_that_it_runs(tmp_path):
    (folder := tmp_path / "of two").mkdir()
    campaign = Campaign(folder, (), (), {}, {}, {}, {}, None, ())
    lost = "see what stopped then, and record again; or give both sides --depth 12, a larger --depth (--tuned), or --reliability reliable"
    assert campaign.remedy(lost) == lost
    (folder / "plan.toml").write_text(parse_plan("[axes]\nbackend = 'socket'\n", "pub", "pub.toml").text)
    remedy = campaign.remedy(lost)
    words = shlex.split(re.search(r"record again \(dds-trace (.*?)\)", remedy)[1])
    assert run_trace(*words, "--dry-run") == 0
    axes = re.findall(r"(\w+(?: = \S+)?) in the plan's \[axes\]", remedy)
    assert axes == ["depth = 12", "depth", "tuned = true", 'reliability = "reliable"']
    assert parse_plan((folder / "plan.toml").read_text(), "plan", "plan.toml").name == "pub"


CODE = """[axes]
backend = "socket"
environment = ["", "{folder}/evil"]
[devices.relay]
ssh = "relay.invalid"
setup = "touch {folder}/setup"
path = "$(touch {folder}/path)"
ssh_options = ["-o", "ProxyCommand=touch {folder}/proxy"]
"""


@pytest.mark.parametrize("ssh", [True, False])
def test_a_dry_run_runs_nothing_of_a_plan(call, plan, tmp_path, monkeypatch, ssh):
    evil = tmp_path / "evil/bin"
    evil.mkdir(parents=True)
    for program in (evil / "dds-record", tmp_path / "ssh"):
        program.write_text(f"#!/bin/sh\ntouch {tmp_path}/ran-$(basename $0)\nexit 1\n")
        program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    text = CODE.replace('environment = ["", "{folder}/evil"]\n', "") if ssh else CODE.partition("[devices")[0]
    text = plan(text.replace("{folder}", str(tmp_path)))
    before = sorted(path.name for path in tmp_path.iterdir())
    assert call(text, "--dry-run", "--out", tmp_path)[0] == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == before
    assert call(text, "--rehearse", "--out", tmp_path)[0] != 0
    assert any(path.name.startswith("ran-") for path in tmp_path.iterdir())


@pytest.mark.parametrize(
    "words", ["sweep", "sweep --against SAME", "capacity", "explain rates", "explain size 2KB", "advise"]
)
def test_a_dry_run_names_what_is_not_here_and_counts_the_rest(call, plan, tmp_path, monkeypatch, words):
    monkeypatch.setattr(
        "dds_trace.extensions.campaigns.rehearsal.missing_here",
        lambda backend, _rmw: "zenoh is not here" if backend == "zenoh" else None,
    )

    def shown(*backends):
        path = plan(f"[axes]\nbackend = {json.dumps(backends)}\nrate = [10, 100]\nsize = [100, 200]\n")
        command, *more = words.split()
        code, out, err = call(*more, path, "--dry-run", "--json", "--out", tmp_path, command=command)
        return code, json.loads(out), err

    code, both, err = shown("cyclonedds", "zenoh")
    _, here, _ = shown("cyclonedds")
    assert (code, here["cannot_start"]) == (10, {}), err
    assert {name.partition("_")[0] for name in both["cannot_start"]} == {"zenoh"}
    assert both["seconds"] == here["seconds"] > sum(cell.get("seconds", 0) for cell in here["cells"])
    assert f" and {len(both['cannot_start']) - 1} more cannot start: zenoh" in err


def test_a_dry_run_of_more_results_builds_no_more_commands(call, plan, tmp_path, monkeypatch):
    get_command, built = typer.main.get_command, []
    monkeypatch.setattr("typer.main.get_command", lambda app: built.append(app) or get_command(app))
    counts = []
    for sizes in (2, 40):
        text = f"backend = 'socket'\nsize = {[*range(100, 100 + sizes)]}\ndepth = [1, 10]\nbuffer = [8192, 9000]\n"
        code, out, _ = call(plan(f"[axes]\n{text}"), "--dry-run", "--json", "--out", tmp_path)
        assert (code, len(json.loads(out)["cells"])) == (0, 4 * sizes)
        counts.append(len(built) - sum(counts))
    assert counts[0] == counts[1] < 10
    code, _, err = call(plan("[axes]\nbackend = 'socket'\ntransport = 'shm'\n"), "--dry-run", "--out", tmp_path)
    assert (code, "-o transport=shm" in err) == (10, True)


@pytest.mark.parametrize("name", ["../elsewhere", "/etc/important", "a/b", "..", ".", "", "line\nbreak"])
def test_names_cannot_leave_out(call, tmp_path, name):
    path = tmp_path / "plan.toml"
    path.write_text(f"name = {json.dumps(name)}\n[axes]\nbackend = 'socket'\n")
    code, _, err = call(path, "--rehearse", "--out", tmp_path / "runs")
    assert code == OptionError.exit_code
    assert "write a name" in err
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize(
    ("text", "cells"),
    [
        (
            f"[axes]\nrate = {list(range(1, 1001))}\nsize = {list(range(1, 1001))}\ndepth = {list(range(1, 1001))}\n",
            "1,000,000,000 results",
        ),
        ("[run]\nrepeats = 1000000000\n[axes]\nrate = [1]\n", ""),
        (SMALL := "[axes]\nrate = [1, 2]\n", ""),
        ("[[axes]]\nrate = 1\n" * 1001 + "[[matrix]]\nsize = 1\n" * 1000, "1,001,000 results"),
    ],
    ids=["axes", "passes", "further passes", "tables"],
)
def test_a_plan_of_a_billion_cells_ends_in_one_line(call, tmp_path, text, cells):
    path = tmp_path / "plan.toml"
    path.write_text(text)
    more = () if text != SMALL else ("--until", "latency_p99:5%", "--max-passes", 10**9)
    code, out, err = call(path, "--rehearse", *more)
    assert (code, out) == (OptionError.exit_code, "")
    assert len(err.splitlines()) == 1
    assert cells in err


def test_a_cell_whose_name_no_file_can_have_or_is_another_pass_of_one_is_refused(tmp_path):
    with pytest.raises(OptionError, match=r"has a name of 2\d\d bytes, which no file may have"):
        parse_plan(f"[axes]\ndata = 'file:{'x' * 200}'\n", "plan", "plan.toml")
    text = f"[run]\nrepeats = 2\n[axes]\nenvironment = ['', '{tmp_path / 'r2'}']\n"
    with pytest.raises(OptionError, match="would be repeat 2 of"):
        parse_plan(text, "plan", "plan.toml")


@pytest.mark.middleware
@needs_namespaces("ip", "iproute2")
def test_namespaces_are_made_for_the_rehearsal_and_gone_behind_it(call, plan, tmp_path):
    text = plan("[axes]\nbackend = 'socket'\n[network]\nnamespaces = true\n")
    code, _, err = call(text, "--rehearse", "--out", tmp_path)
    assert (code, err) == (0, "")
    assert f"ddstrace-{os.getpid()}-" not in ip("netns", "list")


@pytest.mark.middleware
def test_namespaces_that_cannot_be_made_are_known_before(call, plan, tmp_path, monkeypatch):
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    text = plan("[axes]\nbackend = 'socket'\n[network]\nnamespaces = true\n")
    code, _, err = call(text, "--rehearse", "--out", tmp_path)
    assert code == OptionError.exit_code
    assert "need root to make network namespaces" in err


AXES = {
    "data": st.sampled_from(["binary", "string", "imu", "photos", "file:/nowhere"]),
    "size": st.sampled_from([0, 1, 4, 91, 33_000, 1 << 40]),
    "rate": st.sampled_from([10, 100, 1e5, 1e7]),
    "depth": st.sampled_from([0, 1, 10]),
    "transport": st.sampled_from(["default", "udp", "shm"]),
    "reliability": st.sampled_from(["reliable", "best_effort"]),
    "serialization": st.sampled_from(["raw", "typed"]),
    "rmw": st.sampled_from(["", "rmw_fastrtps_cpp"]),
    "tuned": st.booleans(),
}
GIVEN = "|--strict|--deadline 20ms|--deadline soon|--cpu-affinity 0|--cpu-affinity x|--label a|--setting load=50%|--nonsense"
OPTIONS = st.sampled_from([words.split() for words in GIVEN.split("|")])


@st.composite
def plans(draw):
    axes = {
        name: draw(st.lists(values, min_size=1, max_size=2, unique=True))
        for name, values in AXES.items()
        if draw(st.booleans())
    }
    options = "".join(f"[devices.{side}]\noptions = {json.dumps(draw(OPTIONS))}\n" for side in ("ping", "relay"))
    lines = "".join(f"{name} = {json.dumps(values)}\n" for name, values in axes.items())
    return f"[axes]\nbackend = ['socket']\n{lines}{options}"


def _not_started(text, folder):
    try:
        plan = parse_plan(text, "plan", "plan.toml")
    except OptionError:
        return {}, 0
    refused = rehearse_plan(plan, folder / "plan", argument_check(), note=str)
    passed = [cell for cell in plan.cells if cell.name not in refused][:2]
    if not passed:
        return {}, 0
    with Path(os.devnull).open("w") as nowhere:
        done = run_sweep(replace(plan, cells=tuple(passed)), folder, make_progress(Console(file=nowhere)))
    return done.missing, len(passed)


@pytest.mark.middleware
@pytest.mark.parametrize("examples", [3, pytest.param(60, marks=pytest.mark.slow)])
def test_generated_plans_that_pass_start_their_cells(tmp_path, domains, examples):
    tried, head = count(), HEAD.format(domains.take(), domains.take())
    started = 0

    @settings(max_examples=examples, derandomize=True, database=None, phases=[Phase.generate])
    @given(text=plans())
    def passes_or_starts(text):
        nonlocal started
        missing, of = _not_started(head + text, tmp_path / f"runs-{next(tried)}")
        assert missing == {}, text
        started += of

    passes_or_starts()
    assert started > 0


@pytest.mark.middleware
def test_an_environment_that_is_not_there_is_left_out(tmp_path, domain_id, capsys):
    path = tmp_path / "plan.toml"
    path.write_text(
        HEAD.format(domain_id, 5) + "[axes]\nbackend = 'socket'\nenvironment = ['', 'gone']\n[[matrix]]\nsize = '1KB'\n"
    )
    for more in (["--dry-run"], ["--rehearse"], []):
        assert run_trace("sweep", path, "--out", tmp_path / "runs", *more) == 10
        said = capsys.readouterr()
        assert ("1 left out" in said.out) == bool(more)
        assert "gone has no bin/dds-record" in said.err
    assert [trace.name for trace in (tmp_path / "runs/plan").glob("*.ping.mcap")] == [
        "socket_same_binary-1KB_10Hz.ping.mcap"
    ]
