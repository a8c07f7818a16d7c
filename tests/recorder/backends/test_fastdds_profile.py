import os
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import pytest
from applied_pair import needs_large_buffers, run_pair
from middlewares import needs

from dds_trace.base.errors import BackendUnavailableError, OptionError
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.backends.ros2 import fastdds_profile
from dds_trace.recorder.backends.ros2.fastdds_profile import (
    applied_transport,
    loaded_profile,
    localhost_profile,
    profile_environment,
    requested_profile,
    send_when_free,
    written_profile,
)
from dds_trace.recorder.backends.ros2.installation import FAST_DDS_2, FAST_DDS_3, fast_dds
from dds_trace.recorder.choices import Discovery, Transport

VARIABLE = fast_dds().profile_variables[0]
TIMES_S = [0.0, 0.1, 0.1, 0.2, 0.2, 0.2]
GOLDEN = Path(__file__).parents[2] / "data" / "fastdds_profiles"
ON_THIS_MACHINE = {"127.0.0.1", "239.255.0.1"}


@pytest.mark.parametrize(
    ("name", "transport", "tuned"),
    [
        ("udp", Transport.UDP, False),
        ("udp-tuned", Transport.UDP, True),
        ("udp-tuned", Transport.DEFAULT, True),
        ("shm", Transport.SHM, False),
        ("large-data", Transport.LARGE_DATA, False),
    ],
)
def test_the_text_by_transport(monkeypatch, name, transport, tuned):
    monkeypatch.setattr(fastdds_profile, "fast_dds", lambda: FAST_DDS_2)
    assert requested_profile(transport, tuned=tuned) == (GOLDEN / f"{name}.xml").read_text()


@pytest.mark.parametrize(("full", "fails"), [(2, False), (3, True)], ids=["twice full", "then broken"])
def test_a_writer_without_room_waits_and_a_broken_one_fails_in_one_line(monkeypatch, full, fails):
    monkeypatch.setattr(fastdds_profile.time, "monotonic", iter(TIMES_S).__next__)
    refusals = [RuntimeError("cannot publish data\nat rmw_publish.cpp")] * full

    def send():
        if refusals:
            raise refusals.pop()

    with pytest.raises(BackendUnavailableError, match=r"cannot publish data$") if fails else nullcontext():
        send_when_free(send)
    assert not refusals


def test_the_default_needs_no_profile():
    assert requested_profile(Transport.DEFAULT, tuned=False) is None
    with pytest.raises(OptionError, match="LOCALHOST range does that"):
        localhost_profile(Transport.DEFAULT)


@pytest.mark.parametrize("transport", [Transport.SHM, Transport.LARGE_DATA])
def test_transports_that_cannot_be_tuned_are_refused(transport):
    with pytest.raises(OptionError, match=f"--tuned has no effect with -o transport={transport.value}"):
        requested_profile(transport, tuned=True)


def test_where_it_is_written_and_what_names_it():
    with written_profile("<dds/>") as path:
        assert path.read_text() == "<dds/>"
        assert profile_environment(path, {}) == {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT", VARIABLE: str(path)}
    assert not path.exists()


@pytest.mark.parametrize("name", fast_dds().profile_variables)
def test_a_profile_of_the_users_own_excludes_ours(name, tmp_path):
    with pytest.raises(OptionError, match=f"{name} already names a profile"):
        profile_environment(tmp_path / "ours.xml", {name: "/home/me/mine.xml"})


def test_the_environment_is_as_before_behind_the_block(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    for _ in range(2):  # a process opens several nodes one after the other
        with loaded_profile("<dds/>") as path:
            assert os.environ[VARIABLE] == str(path)
            assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SYSTEM_DEFAULT"
            assert path.exists()
        assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
        assert VARIABLE not in os.environ
        assert not path.exists()


def test_the_block_leaves_a_profile_of_the_users_own_alone(monkeypatch):
    monkeypatch.setenv(VARIABLE, "mine.xml")
    with pytest.raises(OptionError, match="already names a profile"), loaded_profile("<dds/>"):
        pass
    assert os.environ[VARIABLE] == "mine.xml"


@pytest.fixture
def run(domain_id):
    pytest.importorskip("rclpy", reason="no ROS 2 here")

    def pair(transport, tuned, **more):
        return run_pair("ros2", domain_id, transport=transport.value, tuned=tuned, **more)

    return pair


def assert_honest(side):
    assert side.at_begin == side.at_end == []
    assert {
        each.local_address for each in side.applied.latest.sockets if each.remote_port or each.protocol == "udp"
    } <= (ON_THIS_MACHINE)


@pytest.mark.keeps(1)
@pytest.mark.middleware
@pytest.mark.parametrize("tuned", [False, pytest.param(True, marks=needs_large_buffers)])
@pytest.mark.parametrize("payload_bytes", [502_000, 1_000_000])
def test_udp_leaves_shared_memory_and_stays_on_loopback(run, tuned, payload_bytes):
    for side in run(Transport.UDP, tuned, payload_bytes=payload_bytes):
        assert_honest(side)
        assert side.applied.latest.memory == ()
        assert side.traffic.sent == side.traffic.received
        receiving = [
            each.receive_buffer_bytes
            for each in side.applied.latest.sockets
            if 0 <= each.local_port - 7400 - 250 * side.asked.domain_id < 250
        ]
        assert len(receiving) >= 2
        assert (min(receiving) == max(receiving) == 8_000_000) is tuned


@pytest.mark.middleware
@needs_large_buffers
def test_a_tuned_default_is_tuned_udp(run):
    ping, relay = run(Transport.DEFAULT, True)
    assert ping.asked.transport == relay.asked.transport == "udp"
    for side in (ping, relay):
        assert_honest(side)
        assert side.applied.latest.memory == ()


@pytest.mark.middleware
def test_shared_memory_alone_opens_no_socket(run):
    for side in run(Transport.SHM, False):
        assert_honest(side)
        assert side.applied.latest.sockets == ()
        assert any(each.middleware == "fastdds" for each in side.applied.latest.memory)


@pytest.mark.middleware
def test_large_data_opens_tcp_on_loopback(run):
    for side in run(Transport.LARGE_DATA, False):
        assert_honest(side)
        listening = [each.local_address for each in side.applied.latest.sockets if each.is_listening]
        assert listening == ["127.0.0.1"]
        groups = {(each.interface, each.address) for each in side.applied.latest.groups}
        assert ("lo", "239.255.0.1") in groups
        # Fast DDS 3 gives it 8,500 KiB, Fast DDS 2 its default of 512.
        segment_bytes = max(each.size_bytes for each in side.applied.latest.memory)
        assert (segment_bytes >= 8_704_000) is (fast_dds() is FAST_DDS_3)


@pytest.mark.middleware
@pytest.mark.parametrize("is_ping_ours", [True, False])
def test_nodes_of_the_localhost_range_and_ours_find_each_other(run, is_ping_ours):
    theirs = {"transport": "default"}
    pair = run(Transport.UDP, False, relay=theirs) if is_ping_ours else run(Transport.UDP, False, ping=theirs)
    ours, other = pair if is_ping_ours else reversed(pair)
    assert ours.traffic.received > 0
    assert_honest(ours)
    assert other.at_end == []


@pytest.mark.middleware
@needs_large_buffers
@needs("cyclonedds")
@pytest.mark.parametrize("is_ping_ours", [True, False])
def test_cyclone_dds_and_ours_find_each_other(run, is_ping_ours):
    cyclone = {"transport": "default", "backend": "cyclonedds"}
    more = {"relay" if is_ping_ours else "ping": cyclone}
    for side in run(Transport.UDP, True, payload_bytes=1_000_000, **more):
        assert side.traffic.received > 0
        assert side.at_end == []


LOCAL = NodeOptions(discovery=Discovery.LOCALHOST, transport=Transport.UDP)


@pytest.fixture
def fresh(monkeypatch):
    monkeypatch.setattr(fastdds_profile, "_loaded", [])


@pytest.mark.usefixtures("fresh")
def test_a_process_has_one_profile():
    with applied_transport(LOCAL, "rmw_fastrtps_cpp") as settings:
        assert list(settings) == ["profile"]
        assert settings["profile"].startswith("written by dds-trace")
    with applied_transport(replace(LOCAL, name="second"), "rmw_fastrtps_cpp"):
        pass
    other = replace(LOCAL, transport=Transport.DEFAULT)
    with pytest.raises(OptionError, match="once in each process"), applied_transport(other, "rmw_fastrtps_cpp"):
        pass


@pytest.mark.usefixtures("fresh")
def test_the_subnet_leaves_the_transport_to_the_variable(monkeypatch):
    monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "SHM")
    with applied_transport(replace(LOCAL, discovery=Discovery.SUBNET), "rmw_fastrtps_cpp") as settings:
        assert settings == {}
        assert os.environ["FASTDDS_BUILTIN_TRANSPORTS"] == "UDPv4"
        assert VARIABLE not in os.environ


@pytest.mark.usefixtures("fresh")
@pytest.mark.parametrize("transport", [Transport.DEFAULT, Transport.UDP])
def test_tuning_beyond_this_machine_enlarges_receive_buffers_only(monkeypatch, transport):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    subnet = replace(LOCAL, discovery=Discovery.SUBNET, transport=transport, tuned=True)
    with applied_transport(subnet, "rmw_fastrtps_cpp") as settings:
        text = Path(os.environ[VARIABLE]).read_text()
        assert settings == {"profile": "written by dds-trace"}
        assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SUBNET"
    assert "<receiveBufferSize>4000000<" in text
    assert "sendBufferSize" not in text
    assert "127.0.0.1" not in text


@pytest.mark.usefixtures("fresh")
@pytest.mark.parametrize("discovery", Discovery)
def test_the_transports_of_other_vendors_are_refused(discovery):
    options = replace(LOCAL, discovery=discovery)
    with (
        pytest.raises(OptionError, match="the middleware here is rmw_cyclonedds_cpp"),
        applied_transport(options, "rmw_cyclonedds_cpp"),
    ):
        pass
