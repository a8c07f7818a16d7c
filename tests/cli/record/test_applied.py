import pytest
from applied_pair import needs_large_buffers
from processes import relay, run, running
from shared_memory import OWN_SHM, needs_root

from dds_trace.recorder.errors import NoEchoError, NotAppliedError
from dds_trace.tracefile.reading.reader import read_trace

pytest.importorskip("rclpy", reason="no ROS 2 here")
pytestmark = pytest.mark.middleware

IGNORED = {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}
"""A wish that ROS 2's LOCALHOST range ignores."""
LARGE = ("--size", "502KB", "--messages", 20, "--warmup", 2, "--rate", 20, "--depth", 1000)


def ping(domain_id, out, *more, environment=None):
    command = ("dds-record", "--role", "ping", "--domain", domain_id, "--out", out, *LARGE, *more)
    return run(*command, environment=environment)


def session(path):
    return read_trace(path).sessions[-1].extra


@pytest.mark.parametrize("more", [("--transport", "udp"), pytest.param(("--tuned",), marks=needs_large_buffers)])
def test_transport_and_tuning_are_applied_on_this_machine(domain_id, tmp_path, more):
    with relay(domain_id, tmp_path / "relay.mcap", *more, "--strict") as relaying:
        done = ping(domain_id, tmp_path / "ping.mcap", *more, "--strict")
        stopped = relaying.stop()
    assert (done.status, stopped.status) == (0, 0), done.stderr + stopped.stderr
    for name in ("ping", "relay"):
        read = session(tmp_path / f"{name}.mcap")
        assert read["asked"]["transport"] == "udp"
        assert read["not_applied"] == []
        assert read["applied"]["path"] in ("lo", "unknown")  # unknown where other tests use loopback as well
        for instant in ("begin", "end"):
            assert [each["name"] for each in read["applied"][instant]["memory"] if not each["is_deleted"]] == []


def test_a_setting_that_is_ignored_is_told_at_once_and_kept(domain_id, tmp_path):
    with relay(domain_id, tmp_path / "relay.mcap") as relaying:
        done = ping(domain_id, tmp_path / "ping.mcap", environment=IGNORED)
        stopped = relaying.stop()
    assert (done.status, stopped.status) == (0, 0), done.stderr + stopped.stderr
    assert done.stderr.count("not applied: ") == 1
    assert "not applied" not in stopped.stderr
    read = session(tmp_path / "ping.mcap")
    assert [each["setting"] for each in read["not_applied"]] == ["transport"]
    first = read_trace(tmp_path / "ping.mcap").sessions[0].extra
    assert first["not_applied"][0]["setting"] == "transport"


def test_strict_ends_a_ping_before_its_trace(domain_id, tmp_path):
    out = tmp_path / "ping.mcap"
    with relay(domain_id, tmp_path / "relay.mcap"):
        done = ping(domain_id, out, "--strict", environment=IGNORED)
    assert done.status == NotAppliedError.exit_code
    assert done.stderr.splitlines()[-1].startswith("dds-record: -o strict=true: asked for UDP")
    assert not out.exists()


def test_strict_ends_a_relay_at_the_first_ping_and_leaves_its_place_free(domain_id, tmp_path):
    out = tmp_path / "relay"
    command = ("dds-record", "--role", "relay", "--domain", domain_id, "--out", out, "--strict")
    with running(*command, environment=IGNORED) as relaying:
        relaying.wait_for_line("serves domain")
        ping(domain_id, tmp_path / "ping.mcap", "--duration", 1)
        done = relaying.finish()
    assert done.status == NotAppliedError.exit_code, done.stderr
    assert "-o strict=true: asked for UDP" in done.stderr
    assert not out.exists()


@needs_root
def test_two_containers_without_a_common_dev_shm_are_told_so(domain_id, tmp_path):
    command = ("dds-record", "--domain", domain_id, "--role")
    with running(*command, "relay", "--out", tmp_path / "relay.mcap", prefix=OWN_SHM) as relaying:
        relaying.wait_for_line("serves domain")
        waiting = ("ping", "--wait", 9, "--out", tmp_path / "ping.mcap")
        with running(*command, *waiting, prefix=OWN_SHM) as pinging:
            done = pinging.finish()
    assert done.status == NoEchoError.exit_code, done.stderr
    advice, settings = done.stderr.splitlines()[-2:]
    assert "/dev/shm" in advice, done.stderr
    assert settings.startswith("  not applied: ")
    assert "_port" in settings
    assert "firewall" not in done.stderr
