import pytest
from waiting import wait_until

from dds_trace.base.errors import OptionError
from dds_trace.recorder.applied.applied import Applied, Snapshot
from dds_trace.recorder.applied.asked import asked_settings
from dds_trace.recorder.applied.differences import Setting, differences
from dds_trace.recorder.applied.memory import SharedMemory
from dds_trace.recorder.backends import load_backend, open_node
from dds_trace.recorder.backends.cyclone_settings import cyclone_settings
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.backends.ros2.fastdds_profile import requested_profile
from dds_trace.recorder.backends.sizes import Sizes
from dds_trace.recorder.backends.zenoh import zenoh_configuration
from dds_trace.recorder.choices import Discovery, Transport
from dds_trace.recorder.kernel.sockets import Socket

SIZES = Sizes(100_000, 300_000, 1_400)
BUFFER, FRAGMENT = "<receiveBufferSize>100000<", "<maxMessageSize>1400<"
SEGMENT = "<segment_size>300000<"


@pytest.mark.parametrize(
    ("transport", "is_local", "expected", "absent"),
    [
        (Transport.DEFAULT, True, (BUFFER, SEGMENT, FRAGMENT, "127.0.0.1"), ()),
        (Transport.UDP, True, (BUFFER, FRAGMENT, "127.0.0.1"), ("SHM",)),
        (Transport.SHM, True, (SEGMENT,), ("UDP",)),
        (Transport.DEFAULT, False, (BUFFER, SEGMENT, FRAGMENT), ("127.0.0.1",)),
    ],
)
def test_a_profile_of_fast_dds_has_the_sizes_of_its_transports(transport, is_local, expected, absent):
    text = requested_profile(transport, tuned=False, is_local=is_local, sizes=SIZES)
    assert [part for part in expected if part not in text] == []
    assert [part for part in absent if part in text] == []
    assert "4000000" in requested_profile(Transport.DEFAULT, tuned=True, sizes=Sizes(fragment=1_400))


def test_cyclone_dds_and_zenoh_are_given_their_sizes():
    text = cyclone_settings(Discovery.SUBNET, tuned=False, environment={}, sizes=SIZES)
    assert "<FragmentSize>1400B<" in text
    assert 'max="100000B"' in text
    options = NodeOptions(discovery=Discovery.LOCALHOST, buffer_bytes=1, segment_bytes=2, fragment_bytes=3)
    transport = zenoh_configuration(options)["transport"]
    assert transport["link"] == {"tcp": {"so_rcvbuf": 1, "so_sndbuf": 1}, "tx": {"batch_size": 3}}
    assert transport["shared_memory"]["transport_optimization"]["pool_size"] == 2


@pytest.mark.middleware
def test_zenoh_takes_its_sizes(domain_id):
    pytest.importorskip("zenoh", reason="zenoh is not installed")
    sizes = {"buffer_bytes": 100_000, "segment_bytes": 1 << 20, "fragment_bytes": 1_400}
    open_node("zenoh", NodeOptions(domain_id, discovery=Discovery.LOCALHOST, listens=True, **sizes)).close()


@pytest.mark.parametrize("transport", [Transport.DEFAULT, Transport.UDP])
def test_sockets_have_the_buffer_and_cut_at_the_fragment(transport):
    more = {"fragment_bytes": 1_400} if transport is Transport.UDP else {}
    options = NodeOptions(transport=transport, discovery=Discovery.LOCALHOST, buffer_bytes=50_000, **more)
    receiving, sending = load_backend("socket").open_pair(options)
    received, message = [], bytes(range(256)) * 40
    with receiving, sending:
        receiving.create_subscription("t", "sensor_msgs/msg/Image", lambda message, *_: received.append(bytes(message)))
        receiving.start()
        sending.start()
        publisher = sending.create_publisher("t", "sensor_msgs/msg/Image")

        def is_received():
            publisher.publish(message)
            return bool(received)

        wait_until(is_received)
        if transport is Transport.UDP:
            assert receiving.middleware.settings["receive_buffer_bytes"] == "100000"
    assert received[0] == message


@pytest.mark.parametrize(
    ("backend", "transport", "name"),
    [
        ("socket", Transport.DEFAULT, "segment"),
        ("socket", Transport.DEFAULT, "fragment"),
        ("cyclonedds", Transport.DEFAULT, "segment"),
        ("ros2", Transport.SHM, "buffer"),
        ("zenoh", Transport.TCP, "segment"),
        ("connext", Transport.DEFAULT, "buffer"),
    ],
)
def test_a_size_that_a_middleware_does_not_have_is_refused(backend, transport, name):
    with pytest.raises(OptionError) as error:
        load_backend(backend).check(NodeOptions(transport=transport, **{f"{name}_bytes": 70_000}))
    assert f"-o {name}=" in str(error.value)


def udp(buffer_bytes):
    return Socket("udp", "ipv4", "127.0.0.1", 7410, "0.0.0.0", 0, buffer_bytes, 1, 0, 1)


@pytest.mark.parametrize(("granted", "found"), [(200_000, []), (425_984, [Setting.BUFFER]), (150_000, [Setting.TUNED])])
def test_another_buffer_than_requested_is_a_difference(granted, found):
    asked = asked_settings("fastdds", domain_id=0, transport="udp", buffer_bytes=100_000)
    applied = Applied(Snapshot(sockets=(udp(granted),)))
    assert [one.setting for one in differences(asked, applied)] == found


@pytest.mark.parametrize(
    ("size", "found"), [(310_000, []), (524_800, []), (1_000_000, [Setting.SEGMENT]), (200_000, [Setting.SEGMENT])]
)
def test_another_segment_than_requested_is_a_difference(size, found):
    asked = asked_settings("fastdds", domain_id=0, transport="shm", segment_bytes=300_000)
    memory = (SharedMemory("fastrtps_0123456789abcdef", "fastdds", "segment", size, is_own=True),)
    assert [one.setting for one in differences(asked, Applied(Snapshot(memory=memory)))] == found
