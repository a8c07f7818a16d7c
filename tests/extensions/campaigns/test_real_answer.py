"""Answers over real middleware: on an emulated link, and between two devices that ssh joins."""

import json
import os
import shlex
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import loopback_sshd
import pytest
from namespaces import needs_namespaces
from processes import executed

from dds_trace.extensions.campaigns.answer import answer
from dds_trace.extensions.campaigns.plan.link import Link
from dds_trace.extensions.campaigns.plan.plan_file import parse_plan
from dds_trace.extensions.campaigns.question import Question, ask, flows_together, limits_of
from dds_trace.extensions.campaigns.station.namespaces import NamespacePair
from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.reading.reader import read_trace

pytest.importorskip("cyclonedds", reason="no Cyclone DDS here")
pytestmark = [pytest.mark.middleware, pytest.mark.slow, needs_namespaces("tc", "iproute2")]

BIN = Path(sys.executable).parent
LINK = "[link]\nrate_mbit_s = 50\ndelay_ms = 4\n"
PLAN = '[axes]\nbackend = "cyclonedds"\nsize = "9KB"\nrate = 100\n'


def only(plan, backend):
    return replace(plan, cells=tuple(cell for cell in plan.cells if cell.backend == backend))


def run(line, **variables):
    words = shlex.split(line)
    words[0] = str(BIN / words[0])
    done = subprocess.run(words, capture_output=True, text=True, check=False, env={**os.environ, **variables})
    return done.returncode, done.stdout + done.stderr


def test_an_emulated_link_is_answered_with_a_proof_that_the_printed_command_repeats(tmp_path):
    (tmp_path / "mine.toml").write_text(LINK)
    plan = only(ask("9KB", "100", link=str(tmp_path / "mine.toml")), "cyclonedds")
    events = []
    found = answer(Question(plan, limits_of("2s"), 0.7), tmp_path, events.append)
    assert found["recommended"]["vendor"] == "cyclonedds", found
    measured = [row for row in found["candidates"] if row["runs"]]
    assert len(measured) >= 2
    assert all(row["p50_ms"] > 8 for row in measured)  # twice the delay
    assert found["proofs"]
    for proof in found["proofs"]:
        assert {row["statistic"] for row in proof["proof"]} == {"p50", "p90", "p99"}
        code, printed = run(proof["command"])
        assert code == 0, printed
        assert "9 KB" in printed
    stages = [event.stage for event in events]
    assert {"link", "look", "proof", "answer"} == set(stages)
    # A file is read back by a node of its own.
    path = next((tmp_path / plan.name / "configurations" / "cyclonedds").glob("small-packets.xml"))
    code, printed = run(
        "dds-trace record relay --backend cyclonedds --check --out x.mcap", CYCLONEDDS_URI=path.as_uri()
    )
    assert code == 0, printed


def test_flows_are_sent_together(tmp_path):
    flows = '[[flows]]\nname = "a"\nsize = "9KB"\nrate = 100\n[[flows]]\nname = "b"\nsize = "1KB"\nrate = 50\n'
    plan = f'{LINK}[run]\nseconds = 1\n[axes]\nbackend = "cyclonedds"\n{flows}'
    plan = flows_together(replace(parse_plan(plan, "two", "two.toml")))
    found = answer(Question(plan, limits_of("2s"), 2), tmp_path)
    assert found["recommended"], found
    spans = {}
    for path in (tmp_path / "two/proof").glob("*/*.ping.mcap"):
        run = path.parent, path.name.split("_r")[-1]
        spans.setdefault(run, []).append(read_trace(path).events[Stage.T1].monotonic_ns[[0, -1]])
    assert len(spans) >= 2 * 3
    for (a_first, a_last), (b_first, b_last) in spans.values():
        assert max(a_first, b_first) < min(a_last, b_last)
    for proof in found["proofs"]:
        assert {row["payload_bytes"] for row in proof["proof"]} == {9000, 1000}


def test_more_than_the_link_carries_is_said_and_what_fits_is_searched(tmp_path):
    plan = replace(parse_plan(LINK + PLAN.replace("100", "2000"), "much", "much.toml"))
    events = []
    found = answer(Question(plan, limits_of("500ms"), 1.5), tmp_path, events.append)
    assert found["load"] > 2
    assert "no setting makes this fit" in events[1].text
    assert not found["proofs"]
    assert found["fits"]["rate_hz"] is None or found["fits"]["rate_hz"] < 700


def test_two_devices_are_asked_over_ssh_and_their_link_is_measured(tmp_path, domains):
    link = Link("shaped", rate_mbit_s=50, delay_ms=4)
    with NamespacePair(link) as pair:
        robot = loopback_sshd.robot(tmp_path, f"ip netns exec {pair.relay.namespace}")
        plan = tmp_path / "mine.toml"
        head = f"[run]\nmessages = 10\ndomain = {domains.take()}\n"
        plan.write_text(f'{head}{PLAN}{robot}address = "{pair.relay.address}"\n')
        command = [str(BIN / "dds-trace"), "advise", str(plan), "--minutes", "2", "--json", "--out", str(tmp_path)]
        environment = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": ""}
        done = executed([*pair.ping.prefix, *command], env=environment)
        assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert 25 < found["link"]["rate_mbit_s"] < 55
    assert found["link"]["delay_ms"] >= 4
    assert "clocks" in done.stderr
    configured = [row for row in found["candidates"] if row["candidate"]["bundle"] and row["runs"]]
    assert configured, found
    assert found["question"]["host"].endswith("@127.0.0.1")
