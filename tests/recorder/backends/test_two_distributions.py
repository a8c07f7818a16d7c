"""A ping on ROS 2 Kilted and a relay on Jazzy, on one machine: `just test-kilted`."""

import os
import subprocess

import pytest
from processes import PATIENCE_S, ping
from waiting import wait_until

from dds_trace.analyzer.pipeline import analyze
from dds_trace.extensions.bridges.programs import program_environment

JAZZY = os.environ.get("DDS_TRACE_JAZZY", "")
"""`dds-record` of the environment with Jazzy, where this one has Kilted."""
pytestmark = [pytest.mark.middleware, pytest.mark.skipif(not JAZZY, reason="just test-kilted names both environments")]


def recorded(folder, domain_id, *options):
    folder.mkdir()
    log = folder / "relay.log"
    command = [JAZZY, "--role", "relay", "--domain", domain_id, *options, "--out", folder / "relay.mcap"]
    with (
        log.open("w") as file,
        subprocess.Popen(
            [*map(str, command)], stdout=file, stderr=subprocess.STDOUT, env=program_environment({}, foreign=True)
        ) as relay,
    ):
        try:
            wait_until(lambda: "serves" in log.read_text(), PATIENCE_S)
            sent = ("--size", "1MB", "--rate", 20, "--messages", 40)
            done = ping(domain_id, folder / "ping.mcap", *options, *sent)
            assert done.status == 0, done.stderr
        finally:
            relay.terminate()
    analysis = analyze(folder)
    return {found.code: found for found in analysis.findings}, analysis


def test_a_pair_of_two_distributions_is_named_and_tuned_sockets_carry_each_message_once(tmp_path, domain_id):
    found, analysis = recorded(tmp_path / "default", domain_id)
    versions = [session.host["versions"]["fastdds"] for session in sorted(analysis.sessions, key=lambda one: one.role)]
    assert [version[0] for version in versions] == ["3", "2"]
    assert f"Fast DDS {versions[0]} and {versions[1]}" in found["mixed_versions"].what
    assert f"fastdds {versions[0]} and {versions[1]}" in found["unlike_versions"].what
    assert {session.extra["applied"]["path"] for session in analysis.sessions} == {"lo"}
    assert "mixed_versions" not in recorded(tmp_path / "tuned", domain_id, "--tuned")[0]
