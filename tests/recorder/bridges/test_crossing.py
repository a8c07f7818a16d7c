from __future__ import annotations

import pytest
from crossing import watch_crossing

from recorder.backend import Discovery
from recorder.bridges import BRIDGED_TOPICS, BridgeOptions, load_bridge, open_bridge

pytestmark = pytest.mark.middleware

ALLOWED = {topic.name: topic.type_name for topic in BRIDGED_TOPICS}


@pytest.fixture
def pair(domains):
    return domains.take(), domains.take()


def test_without_a_bridge_no_message_crosses(pair):
    seen = watch_crossing(*pair, ALLOWED, until=("heard", list(ALLOWED)))
    assert set(seen.crossed.values()) == {0}
    assert set(seen.echoed.values()) == {0}


@pytest.mark.parametrize("name", ["builtin", "builtin-zenoh", "zenoh-bridge-dds"])
def test_allowed_topics_cross_both_ways_and_no_other_does(name, pair):
    if load_bridge(name).find() is None:
        pytest.skip(f"{name} is not installed; {load_bridge(name).install}")
    topics = {**ALLOWED, "not_on_the_list": "std_msgs/msg/String"}
    with open_bridge(name, BridgeOptions(*pair, discovery=Discovery.LOCALHOST)) as bridge:
        seen = watch_crossing(*pair, topics, until=("echoed", list(ALLOWED)))
        bridge.mark_ready()
    assert seen.heard["not_on_the_list"] > 0
    assert seen.crossed["not_on_the_list"] == 0
    assert bridge.describe()["state"] == "stopped"
    # No loop: nothing is heard or echoed more often than it was sent once.
    for topic in ALLOWED:
        assert seen.echoed[topic] <= seen.crossed[topic] <= seen.heard["not_on_the_list"] + 1
