from dataclasses import replace

import pytest
from crossing import watch_crossing
from processes import own_port

from dds_trace.extensions.bridges.base import BRIDGED_TOPICS, BridgeOptions, Half, load_bridge
from dds_trace.extensions.bridges.running import open_bridge
from dds_trace.recorder.choices import Discovery
from dds_trace.tracefile.format.descriptions import Qos

pytestmark = pytest.mark.middleware

ALLOWED = {topic.name: topic.type_name for topic in BRIDGED_TOPICS}


@pytest.fixture
def pair(domains):
    return domains.take(), domains.take()


def skip_if_missing(name):
    if load_bridge(name).find() is None:
        pytest.skip(f"{name} is not installed; {load_bridge(name).install}")


def test_without_a_bridge_no_message_crosses(pair):
    seen = watch_crossing(*pair, ALLOWED, until={"heard": list(ALLOWED)})
    assert set(seen.crossed.values()) == {0}
    assert set(seen.echoed.values()) == {0}


@pytest.mark.keeps(1)
@pytest.mark.parametrize("name", ["builtin", "builtin-zenoh", "zenoh-bridge-dds", "zenoh-bridge-ros2dds"])
def test_allowed_topics_cross_both_ways_and_no_other_does(name, pair):
    skip_if_missing(name)
    topics = {**ALLOWED, "not_on_the_list": "std_msgs/msg/String"}
    with open_bridge(name, BridgeOptions(*pair, discovery=Discovery.LOCALHOST)) as bridge:
        seen = watch_crossing(*pair, topics, until={"echoed": list(ALLOWED), "heard": ["not_on_the_list"]})
        bridge.mark_ready()
    assert seen.crossed["not_on_the_list"] == 0
    assert bridge.describe()["state"] == "stopped"
    # No loop: nothing comes more often than it was sent.
    for topic in ALLOWED:
        assert seen.echoed[topic] <= seen.crossed[topic] <= seen.sent[topic]
        assert seen.heard[topic] <= seen.sent[topic]


@pytest.mark.parametrize("name", ["builtin-zenoh", "zenoh-bridge-dds", "zenoh-bridge-ros2dds"])
def test_two_halves_started_apart_meet_as_on_two_devices(name, pair):
    skip_if_missing(name)
    address = f"127.0.0.1:{own_port(pair[0])}"
    options = BridgeOptions(*pair, discovery=Discovery.LOCALHOST)
    # The one that connects is first: on two devices nobody knows which will be.
    with (
        open_bridge(name, replace(options, half=Half.RELAY, peers=(address,))) as relay,
        open_bridge(name, replace(options, half=Half.PING, listen=address)) as ping,
    ):
        watch_crossing(*pair, {"imu_data": ALLOWED["imu_data"]}, until={"echoed": ["imu_data"]})
        assert list(ping.processes) == ["bridge_ping"]
        assert list(relay.processes) == ["bridge_relay"]


def test_best_effort_nodes_are_bridged_best_effort(pair):
    qos = Qos(reliability="best_effort")
    with open_bridge("builtin", BridgeOptions(*pair, qos=qos, discovery=Discovery.LOCALHOST)):
        topics = {"string_data": ALLOWED["string_data"]}
        watch_crossing(*pair, topics, until={"echoed": ["string_data"]}, reliability="best_effort")


def test_configuration_and_load_of_a_real_bridge_are_in_its_description(pair):
    with open_bridge("builtin", BridgeOptions(*pair, discovery=Discovery.LOCALHOST)) as bridge:
        load = bridge.sample()["programs"]["bridge"]
    (program,) = bridge.describe()["programs"]
    assert program["log_tail"].splitlines()[-1] == "forwarded 0 messages"
    assert load["memory_bytes"] > 10_000_000
    assert load["processes"] == 1
    assert f'"ping_domain_id": {pair[0]}' in program["configuration"]
    assert program["version"]
