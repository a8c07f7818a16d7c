from pathlib import Path

import pytest
from applied_pair import needs_large_buffers, run_pair
from middlewares import needs
from namespaces import needs_namespaces, network_with
from shared_memory import OWN_SHM, needs_root

from dds_trace.recorder.backends.ros2.fastdds_profile import (
    localhost_profile,
    profile_environment,
    requested_profile,
    written_profile,
)
from dds_trace.recorder.backends.ros2.installation import fast_dds
from dds_trace.recorder.choices import Transport

pytestmark = pytest.mark.middleware

needs_ros2, needs_zenoh = needs("ros2"), needs("zenoh")


def localhost(value):
    return {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "FASTDDS_BUILTIN_TRANSPORTS": value}


def run_under_profile(text, domain_id, prefix=()):
    with written_profile(text) as path:
        environment = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT"}
        variables = {fast_dds().profile_variables[0]: str(path)}
        return path.name, run_pair("ros2", domain_id, environment=environment, variables=variables, prefix=prefix)


@needs_ros2
def test_1_udp_under_the_localhost_range(domain_id):
    ping, relay = run_pair("ros2", domain_id, transport="udp", environment=localhost("UDPv4"))
    for side in (ping, relay):
        ((setting, words),) = side.at_begin
        assert setting == "transport"
        assert "shared memory is open" in words
        assert side.settings == ["transport"]
    assert ping.at_end[0][1].startswith("asked for UDP, ")
    assert any(each.is_foreign_segment for each in ping.applied.end.memory)


@needs_ros2
def test_2_tuned_under_the_localhost_range(domain_id):
    for side in run_pair("ros2", domain_id, tuned=True, environment=localhost("UDPv4?sockets_size=4MB")):
        assert side.settings == ["transport", "tuned"]
        assert "receive buffers of 4,000,000 bytes" in side.at_end[1][1]


@needs_ros2
def test_3_a_profile_that_keeps_the_builtin_transports(domain_id):
    loose = localhost_profile(Transport.UDP).replace("<useBuiltinTransports>false</useBuiltinTransports>", "")
    name, sides = run_under_profile(loose, domain_id)
    for side in sides:
        ((setting, words),) = side.at_begin
        assert setting == "profile"
        assert f"the profile {name} asks for UDP" in words
        # On a quiet machine the loopback interface, which the profile names, is seen to carry nothing as well.
        assert side.settings in (["profile"], ["profile", "interface"])


@pytest.fixture
def unused_interface():
    """Name of an interface that has an address, in a network namespace, and the way into that."""
    with network_with("unused0") as inside:
        yield "unused0", inside


@needs("cyclonedds")
@needs_namespaces("ip", "iproute2")
def test_4_an_interface_that_carries_nothing(domain_id, unused_interface):
    # Linux moves what a machine sends to its own address through loopback, whichever interface has that address.
    name, inside = unused_interface
    settings = (
        f'<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="{name}"/></Interfaces></General>'
        "</Domain></CycloneDDS>"
    )
    for side in run_pair(
        "cyclonedds", domain_id, discovery="subnet", variables={"CYCLONEDDS_URI": settings}, prefix=inside
    ):
        assert side.asked.interface == name
        assert (side.applied.path, side.at_begin, side.settings) == ("lo", [], ["interface"])


@needs_ros2
@needs_namespaces("ip", "iproute2")
def test_4_an_interface_of_a_fast_dds_profile_that_carries_nothing(domain_id, unused_interface):
    name, inside = unused_interface
    text = localhost_profile(Transport.UDP, 4_000_000).replace("127.0.0.1", "198.51.100.1")
    for side in run_under_profile(text, domain_id, inside)[1]:
        assert side.asked.interface == name
        assert (side.applied.path, side.at_begin, side.settings) == ("lo", [], ["interface"])


@needs_ros2
def test_5_a_buffer_above_the_kernels_limit(domain_id):
    # The limit itself is the machine's, and other tests need it; asking for more than it allows is the same.
    limit = int(Path("/proc/sys/net/core/rmem_max").read_text())
    with written_profile(localhost_profile(Transport.UDP, 2 * limit)) as path:
        sides = run_pair(
            "ros2",
            domain_id,
            tuned=True,
            environment=profile_environment(path, {}),
            asked={"receive_buffer_bytes": 2 * limit},
        )
    for side in sides:
        assert side.settings == ["kernel_limit"]
        assert side.at_end[0][1].endswith(f"net.core.rmem_max is {limit:,}")


@needs_ros2
def test_6_large_data_under_the_localhost_range(domain_id):
    expected = ["large_data", *(["segment"] if fast_dds().large_data else [])]
    for side in run_pair("ros2", domain_id, transport="large-data", environment=localhost("LARGE_DATA")):
        assert [setting for setting, _ in side.at_begin] == side.settings == expected


@needs_zenoh
@pytest.mark.parametrize(("is_on", "words"), [(True, "asked for no shared memory, "), (False, "none is mapped")])
def test_7_zenohs_shared_memory(domain_id, is_on, words):
    # Not a word of the settings says it: zenoh's own default is on, and a message of 3 KB or more leaves TCP for it.
    for side in run_pair("zenoh", domain_id, zenoh_memory=is_on, asked={"shared_memory": not is_on}):
        assert side.settings == ["shared_memory"]
        assert words in side.at_end[0][1]
    for side in run_pair("zenoh", domain_id, zenoh_memory=is_on, asked={"shared_memory": is_on}):
        assert side.at_begin == side.at_end == []


@needs_zenoh
def test_7_the_other_side_of_zenoh_has_its_shared_memory_off(domain_id):
    ping, relay = run_pair("zenoh", domain_id, transport="shm", relay={"transport": "tcp"})
    assert (ping.asked.shared_memory, relay.asked.shared_memory) == (True, False)
    assert ping.settings == ["memory_namespace"]
    assert relay.settings == []
    assert ping.applied.path == "lo"
    # Its connection ended with the ping, before it looked; what loopback counted is everybody's.
    assert relay.applied.path != "shm"


@needs_root
@needs_zenoh
def test_8_zenoh_with_a_dev_shm_of_another_namespace(domain_id):
    ping, relay = run_pair("zenoh", domain_id, asked={"shared_memory": True}, relay_prefix=OWN_SHM)
    assert ping.settings == ["memory_namespace"]
    assert ping.applied.path == "lo"
    assert relay.applied.path != "shm"


@needs_root
@needs_ros2
def test_8_fast_dds_with_a_dev_shm_of_another_namespace_sends_in_vain(domain_id):
    # Each side has its own: in the machine's, a segment that another test's killed process left could be the receiver's.
    ping, _ = run_pair("ros2", domain_id, prefix=OWN_SHM, attempts=40)
    assert ping.traffic.received == 0
    assert ping.settings == ["memory_namespace"]
    assert "a /dev/shm of its own" in ping.at_end[0][1]


@needs_root
@needs_ros2
@needs_large_buffers
def test_udp_reaches_a_side_whose_dev_shm_is_another(domain_id):
    with written_profile(requested_profile(Transport.UDP, tuned=True)) as path:
        sides = run_pair("ros2", domain_id, tuned=True, environment=profile_environment(path, {}), relay_prefix=OWN_SHM)
    for side in sides:
        assert side.at_end == []
