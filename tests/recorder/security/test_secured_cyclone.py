"""DDS Security for real: Debian's Cyclone DDS 0.10.2 in an environment of its own, reached by the axis `environment`."""

import subprocess
import tempfile
from contextlib import contextmanager
from pathlib import Path

import pytest
from processes import running
from secured_cyclone import needs_secured_cyclone, secured_environment
from waiting import wait_until

from dds_trace.analyzer.pipeline import analyze
from dds_trace.recorder.choices import Security
from dds_trace.tracefile.reading.reader import read_trace

pytestmark = [pytest.mark.middleware, needs_secured_cyclone]

LEVELS = [level.value for level in Security]
PLAN = """
[run]
messages = 20
warmup = 2
settle_seconds = 0
own_cost_passes = 1
domain = {domain}
[axes]
backend = "cyclonedds"
environment = "{environment}"
security = {levels}
size = 1000
rate = 100
depth = 1000
"""


@pytest.fixture(scope="module")
def environment():
    return secured_environment()


@pytest.mark.thorough
def test_a_sweep_measures_every_level_with_keys_of_its_own(domain_id, tmp_path, environment):
    plan = tmp_path / "levels.toml"
    plan.write_text(PLAN.format(domain=domain_id, environment=environment, levels=LEVELS))
    with running("dds-trace", "sweep", plan, "--out", tmp_path) as command:
        done = command.finish()
    assert done.status == 0, done.stderr
    analysis = analyze(tmp_path / "levels")
    settings = analysis.summary["setting"].to_list()
    assert sorted(settings) == sorted(
        ",".join([f"environment={environment.name}", *([f"security={level}"] if level != "off" else [])])
        for level in LEVELS
    )
    assert analysis.summary["received"].to_list() == [20] * len(LEVELS)
    for session in analysis.sessions:
        security, level = session.extra.get("security"), session.extra["settings"].get("security", "off")
        assert session.extra["not_applied"] == []
        if level == "off":
            assert security is None
        else:
            assert security["level"] == level
            assert [name.partition(".")[0] for name in security["applied"].split(", ")] == [
                f"libdds_security_{plugin}" for plugin in ("ac", "auth", "crypto")
            ]
        assert "BEGIN" not in session.to_json()
    assert not list(Path(tempfile.gettempdir()).glob(f"dds-trace-keys-{command.pid}-*"))


@contextmanager
def recorder(environment, *arguments):
    command = [environment / "bin" / "dds-record", "--backend", "cyclonedds", "--discovery", "localhost", *arguments]
    with subprocess.Popen(list(map(str, command)), stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.terminate()


@pytest.mark.parametrize("secured", ["ping", "relay"])
def test_one_side_without_security_is_named(domain_id, tmp_path, environment, secured):
    keys = ("--security", "sign", "--keys", tmp_path / "keys")
    of_ping, of_relay = (keys, ()) if secured == "ping" else ((), keys)
    shared = ("--domain", domain_id, "--no-own-cost")
    with recorder(environment, "--role", "relay", *shared, *of_relay, "--out", tmp_path / "relay.mcap") as relay:
        wait_until(lambda: "serves" in relay.stderr.readline(), step_s=0)
        arguments = ("--role", "ping", *shared, *of_ping, "--wait", 4, "--out", tmp_path / "ping.mcap")
        with recorder(environment, *arguments) as ping:
            _, said = ping.communicate()
    assert ping.returncode == 8
    assert f"{'without' if secured == 'ping' else 'with'} -o security" in said
    assert "same -o security" in said


def test_a_reader_without_security_gets_nothing_of_a_secured_pair(domain_id, tmp_path, environment):
    """What an outsider hears while a secured pair exchanges messages: a second relay without security serves none."""
    keys = ("--security", "encrypt-data", "--keys", tmp_path / "keys")
    shared = ("--domain", domain_id, "--no-own-cost")
    with (
        recorder(environment, "--role", "relay", *shared, *keys, "--out", tmp_path / "relay.mcap") as relay,
        recorder(environment, "--role", "relay", *shared, "--out", tmp_path / "outside.mcap") as outside,
    ):
        for one in (relay, outside):
            wait_until(lambda one=one: "serves" in one.stderr.readline(), step_s=0)
        arguments = (*shared, *keys, "--messages", 20, "--rate", 50, "--out", tmp_path / "ping.mcap")
        with recorder(environment, "--role", "ping", *arguments) as ping:
            ping.communicate()
        assert ping.returncode == 0
    for one in (relay, outside):
        one.wait(60)
    counts = [sum(map(len, read_trace(tmp_path / f"{name}.mcap").events.values())) for name in ("relay", "outside")]
    assert counts[0] >= 40
    assert counts[1] == 0
