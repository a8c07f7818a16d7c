"""The commands of `docs/tutorials/two-devices.md`, as they stand there, between two namespaces joined by a veth."""

import re
import shlex
import shutil
import signal
import sys
from contextlib import ExitStack
from itertools import groupby
from pathlib import Path

import pytest
from processes import executed
from two_devices import command_blocks, needs_devices, two_devices

from dds_trace.tracefile.reading.reader import read_trace

PAGE = Path(__file__).parents[3] / "docs" / "tutorials" / "two-devices.md"
PING, RELAY = "192.168.0.10", "192.168.0.20"
READY = {"record relay": "serves domain", "trace bridge": " runs: "}
"""What a command says on stderr once others may begin; a command with none of these words runs to its end."""
LAST_WORDS = {"record ping": r"1\d\d|200", "trace analyze runs": r"\d (ms|µs)\b"}
"""What the answer of a command that runs to its end has."""
MESSAGES, WARMUP, PAYLOAD_BYTES = 200, 10, 33_000
LEAST_RECEIVED = 0.9


def test_the_page_names_the_addresses_and_every_section_has_its_commands():
    assert f"the ping's device is {PING} and the relay's is {RELAY}" in PAGE.read_text()
    blocks = command_blocks(PAGE)
    sections = groupby(blocks, lambda block: block.section)
    assert {section: " ".join(block.device for block in part) for section, part in sections} == {
        "Same domain": "relay ping",
        "Different domains": "relay relay ping",
        "The floor of the link": "relay ping",
        "Bring the traces together": "ping",
    }
    assert PAGE.read_text().count("```sh") == len(blocks)


@pytest.mark.thorough
@pytest.mark.middleware
@needs_devices
def test_one_machine_is_two_devices_by_the_lines_of_the_page(tmp_path):
    section = PAGE.read_text().partition("### Or try it")[2].partition("## Same")[0]
    setup, enter = re.findall(r"(?:^    .*\n)+", section, re.MULTILINE)
    zenoh = "--backend zenoh --discovery subnet --out"
    relay = f"echo dds-trace record relay {zenoh} relay.mcap --duration 10s | {enter.strip()}"
    ping = (
        f"echo dds-trace record ping {zenoh} ping.mcap --peer {RELAY} --messages 20 | {enter.replace('relay', 'ping')}"
    )
    script = f'mount -t tmpfs tmpfs /run; sudo() {{ "$@"; }}; USER=root PATH={Path(sys.executable).parent}:$PATH\n{setup}{relay} &\n{ping}wait'
    done = executed(["unshare", "--mount", "--net", "bash", "-ec", script], cwd=tmp_path)
    assert "received 20" in done.stdout + done.stderr, done


@pytest.mark.thorough
@pytest.mark.middleware
@needs_devices
def test_its_commands_lead_to_completed_round_trips_over_the_link(tmp_path):
    for package in ("rclpy", "zenoh", "polars"):
        pytest.importorskip(package, reason=f"{package} is not installed")
    with two_devices(tmp_path, PING, RELAY) as (pair, devices):
        for section, blocks in groupby(command_blocks(PAGE), lambda block: block.section):
            pair.report()
            _follow(list(blocks), devices)
            if section != "Bring the traces together":
                sent = pair.report()
                # The messages found no other way than the link; those that `_check` lets a busy machine lose, less.
                for role in ("ping", "relay"):
                    assert sent[role]["sent_bytes"] > LEAST_RECEIVED * (MESSAGES + WARMUP) * PAYLOAD_BYTES, section
    _check(devices["ping"].folder / "runs")


def _follow(blocks, devices):
    """Run a section as its reader would; what goes on until Ctrl-C gets it at the end."""
    with ExitStack() as stack:
        waiting = []
        for block in blocks:
            for line in block.lines:
                program, *arguments = shlex.split(line)
                if program == "scp":
                    assert arguments == ["-r", f"pi@{RELAY}:runs", "."]
                    here, there = (devices[name].folder / "runs" for name in ("ping", "relay"))
                    shutil.copytree(there, here, dirs_exist_ok=True)
                    continue
                command = devices[block.device].start(program, *arguments)
                stack.callback(command.clean_up)
                ready = [text for words, text in READY.items() if words in line]
                if ready:
                    command.wait_for_line(ready[0])
                    waiting.append(command)
                else:
                    done = command.finish()
                    assert done.status == 0, done.stderr
                    words = next(words for part, words in LAST_WORDS.items() if part in line)
                    assert re.search(words, done.stdout + done.stderr), (line, done)
        for command in waiting:
            done = command.stop(signal.SIGINT)
            assert done.status == 0, done.stderr


def _check(runs):
    from dds_trace.analyzer.pipeline import analyze

    assert (runs / "analysis" / "report.html").exists()
    analysis = analyze(runs)
    groups = {group["bridge"] + " " + group["backend"]: group for group in analysis.summary.to_dicts()}
    assert set(groups) == {"none ros2", "builtin-zenoh ros2", "none socket"}
    assert [groups[name]["domain_mode"] for name in sorted(groups)] == ["different", "same", "same"]
    for group in groups.values():
        assert group["published"] == MESSAGES
        # All of them, but for a machine that is too busy to read ten messages long.
        assert group["received"] >= LEAST_RECEIVED * MESSAGES
        assert group["latency_p50_ns"] > 0
    for path in runs.glob("*/*.mcap"):
        session = read_trace(path).sessions[-1]
        assert session.state == "closed"
        assert session.connectivity == "wired"
        assert session.host["middleware"]["discovery"] == "subnet"
