import html
import json
from pathlib import Path

import loopback_sshd
import pytest
from namespaces import needs_namespaces
from processes import run, socket_plan

from dds_trace.tracefile.reading.reader import read_trace

pytestmark = pytest.mark.middleware


@pytest.fixture
def plan(tmp_path, domain_id):
    def write(name, size, more="", *, repeats=3):
        path = tmp_path / f"{name}.toml"
        path.write_text(socket_plan(domain_id, repeats=repeats, size=size, more=more))
        return path

    return write


def starts_of(folder):
    held = [
        (trace.wall_ns[0], side, int(trace.labels["pass"]))
        for side in ("base", "new")
        for trace in map(Started, sorted((folder / side).glob("*.ping.mcap")))
    ]
    return [(side, number) for _, side, number in sorted(held)]


class Started:
    def __init__(self, path):
        trace = read_trace(path)
        self.labels = trace.runs[0].labels
        self.wall_ns = [session.wall_anchor_ns for session in trace.sessions]


def test_another_plan_is_recorded_in_turns_and_compared_cell_by_cell_and_pass_by_pass(plan, tmp_path, sentences):
    done = run("dds-trace", "sweep", plan("p", "1KB"), "--out", tmp_path / "runs", "--against", plan("q", "2KB"))
    assert done.status == 0, done.stderr
    folder = tmp_path / "runs/p-against-q"
    planned = [("base", 1), ("new", 1), ("new", 2), ("base", 2), ("base", 3), ("new", 3)]
    assert starts_of(folder)[:6] == planned  # then what met a busier machine, again
    printed = next(line for line in done.stdout.splitlines() if line.startswith("Compare: "))
    words = printed.removeprefix("Compare: dds-trace ").split()
    assert words == ["compare", str(folder / "base"), str(folder / "new"), "--paired"]
    for options in (words, words[:-1]):  # in turns is pass by pass, said or not
        compared = run("dds-trace", *options, "--report", "md", "--all")
        assert compared.status == 0, compared.stderr
        shown = html.unescape(compared.stdout)
        row = next(line for line in shown.splitlines() if "| Round trip median |" in line)
        assert "| 3 pairs |" in row or "| 4 pairs |" in row
        (asked,) = [line for line in shown.splitlines() if line.startswith("- Measured in turns: ")]
        sentences(row.split("|")[1], asked)


@pytest.mark.thorough
@needs_namespaces("tc", "iproute2")
def test_both_sides_have_namespaces_of_their_own(plan, tmp_path):
    network = "[network]\nnamespaces = true\n"
    arguments = (plan("p", "1KB", network, repeats=1), "--out", tmp_path, "--against", "SAME", "--json")
    done = run("dds-trace", "sweep", *arguments, environment={"COLUMNS": "80"})  # cold: one in a namespace has to be
    assert done.status == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["missing"] == {"base": {}, "new": {}}
    assert result["false_alarms"]["deals"] == 1
    (links,) = {
        read_trace(path).sessions[0].connectivity
        for side in ("base", "new")
        for path in Path(result[side]).glob("*.ping.mcap")
    }
    assert links == "wired"


@pytest.mark.thorough
def test_a_relay_over_ssh_serves_both_sides(plan, tmp_path):
    robot = '[devices]\nconnectivity = "loopback"\n' + loopback_sshd.robot(tmp_path)
    base = plan("p", "1KB", robot, repeats=1)
    base.write_text(base.read_text().replace("[run]", '[run]\ndiscovery = "localhost"'))
    done = run("dds-trace", "sweep", base, "--out", tmp_path, "--against", "SAME", "--json")
    assert done.status == 0, done.stderr
    result = json.loads(done.stdout)
    assert {
        read_trace(path).sessions[0].device
        for side in ("base", "new")
        for path in Path(result[side]).glob("*.relay.mcap")
    } == {"robot"}
