import subprocess
import sys

import pytest
import toy_bridge
from applied_pair import needs_large_buffers, relaying

from dds_trace.extensions.bridges.base import BridgeOptions, load_bridge
from dds_trace.extensions.bridges.running import ProgramReadBack, open_bridge
from dds_trace.recorder.applied.vendors import BUFFER_BYTES
from dds_trace.recorder.choices import Discovery, Transport
from dds_trace.recorder.domains import domain_port_range


@pytest.fixture
def pair(domains):
    return domains.take(), domains.take()


def asked(pair, **options):
    return BridgeOptions(*pair, discovery=Discovery.LOCALHOST, **options)


def test_a_program_without_a_middleware_says_nothing_and_one_that_has_ended_is_not_read():
    options = BridgeOptions(5, 10, transport=Transport.UDP, tuned=True)
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as program:
        read_back = ProgramReadBack(toy_bridge.BRIDGE, options, program.pid)
        assert read_back.fields() == {}
        read_back.read()
        assert read_back.fields()["applied"]["begin"]["sockets"] == []
        assert read_back.not_applied == ()
        program.communicate()
    read_back.read()
    assert read_back.fields()["applied"]["end"] is None


@pytest.mark.middleware
def test_a_transport_that_a_program_does_not_use_is_named_with_the_bridge(pair):
    pytest.importorskip("rclpy")
    with relaying("ros2", pair[0]) as program:  # of the default transports
        read_back = ProgramReadBack(load_bridge("builtin"), asked(pair, transport=Transport.UDP), program.pid)
        read_back.read()
        (difference,) = read_back.not_applied
        assert difference.words.startswith("the bridge builtin: asked for UDP")
        assert difference.asked == "builtin: udp"
        fields = read_back.fields()
        assert [each["domain_id"] for each in fields["asked"]] == list(pair)
        assert [each["setting"] for each in fields["not_applied"]] == ["transport"]
        assert {each["vendor"] for each in fields["applied"]["begin"]["libraries"]} == {"fastdds"}


@pytest.mark.middleware
@needs_large_buffers
@pytest.mark.parametrize("name", ["builtin", "builtin-zenoh", "zenoh-bridge-dds", "zenoh-bridge-ros2dds"])
def test_tuning_reaches_the_sockets_of_a_bridge_in_both_domains(name, pair):
    if load_bridge(name).find() is None:
        pytest.skip(f"{name} is not installed")
    with open_bridge(name, asked(pair, tuned=True)) as bridge:
        bridge.read_applied()
        assert bridge.read_applied() == ()
        programs = bridge.describe()["programs"]
    buffers = {
        (domain_id, each["receive_buffer_bytes"])
        for program in programs
        for each in program["read_back"]["applied"]["end"]["sockets"]
        for domain_id in pair
        if each["protocol"] == "udp" and each["local_port"] in domain_port_range(domain_id)
    }
    assert {domain_id for domain_id, _ in buffers} == set(pair)
    assert min(granted_bytes for _, granted_bytes in buffers) >= 2 * BUFFER_BYTES
