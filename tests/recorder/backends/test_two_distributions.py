"""A ping on ROS 2 Kilted and a relay on Jazzy, on one machine: `just test-kilted`."""

import os
import subprocess
from contextlib import contextmanager

import pytest
from processes import PATIENCE_S, ping
from waiting import wait_until

from dds_trace.analyzer.pipeline import analyze
from dds_trace.extensions.bridges.programs import program_environment

JAZZY = os.environ.get("DDS_TRACE_JAZZY", "")
"""`dds-record` of the environment with Jazzy, where this one has Kilted."""
pytestmark = [pytest.mark.middleware, pytest.mark.skipif(not JAZZY, reason="just test-kilted names both environments")]


@contextmanager
def jazzy_relay(folder, domain_id, *options, **variables):
    folder.mkdir()
    log = folder / "relay.log"
    command = [JAZZY, "--role", "relay", "--domain", domain_id, *options, "--out", folder / "relay.mcap"]
    environment = {**program_environment({}, foreign=True), **variables}
    with (
        log.open("w") as file,
        subprocess.Popen([*map(str, command)], stdout=file, stderr=subprocess.STDOUT, env=environment) as relay,
    ):
        try:
            wait_until(lambda: "serves" in log.read_text(), PATIENCE_S)
            yield relay
        finally:
            relay.terminate()


def recorded(folder, domain_id, *options):
    with jazzy_relay(folder, domain_id, *options):
        sent = ("--size", "1MB", "--rate", 20, "--messages", 40)
        done = ping(domain_id, folder / "ping.mcap", *options, *sent)
        assert done.status == 0, done.stderr
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


def test_what_the_relays_middleware_prints_is_the_first_line_of_the_ping(tmp_path, domain_id):
    kept = "<CycloneDDS><Domain><Compatibility><IgnoreTypeInformation>{}</IgnoreTypeInformation></Compatibility></Domain></CycloneDDS>"
    cyclone = ("--backend", "cyclonedds")
    with jazzy_relay(tmp_path / "kept", domain_id, *cyclone, CYCLONEDDS_URI=kept.format("1.2")) as relay:
        done = ping(domain_id, tmp_path / "1.mcap", "--messages", 5, "-o", "wait=6")
    said = f'  try: at the relay (process {relay.pid}, cyclonedds): the middleware printed "type'
    assert (done.status, said in done.stderr) == (8, True), done.stderr
    with jazzy_relay(tmp_path / "ignored", domain_id, *cyclone, CYCLONEDDS_URI=kept.format("1.15")):
        done = ping(domain_id, tmp_path / "2.mcap", "--messages", 5)
    assert done.status == 0, done.stderr
