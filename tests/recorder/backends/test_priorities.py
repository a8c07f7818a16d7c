from __future__ import annotations

import pytest

from dds_trace.base.errors import OptionError
from dds_trace.recorder.applied.differences import Setting, publisher_differences
from dds_trace.recorder.backends import load_backend, open_node
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.choices import Discovery, WhenFull


def settings_of(backend, domain_id, **requested):
    options = NodeOptions(domain_id=domain_id, discovery=Discovery.LOCALHOST, listens=True, **requested)
    with open_node(backend, options) as node:
        node.create_publisher("a_topic", "sensor_msgs/msg/Image")
        return node.publisher_settings


@pytest.mark.middleware
def test_zenoh_publishers_report_their_priority_and_what_they_do_when_full(domain_id):
    pytest.importorskip("zenoh", reason="zenoh is not installed")
    found = settings_of("zenoh", domain_id, priority=2, when_full=WhenFull.DROP)
    assert found == {"priority": "2", "when_full": "drop"}
    assert settings_of("zenoh", domain_id) == {"priority": "5", "when_full": "block"}  # reliable, at zenoh's default


@pytest.mark.middleware
def test_writers_of_cyclone_dds_report_their_transport_priority(domain_id):
    pytest.importorskip("cyclonedds", reason="Cyclone DDS is not installed")
    assert settings_of("cyclonedds", domain_id, priority=7) == {"priority": "7"}


@pytest.mark.parametrize(
    ("backend", "requested", "word"),
    [
        ("zenoh", {"priority": 8}, "1 to 7"),
        ("socket", {"priority": 1}, "none"),
        ("cyclonedds", {"when_full": WhenFull.DROP}, "leave it out"),
    ],
)
def test_what_a_backend_cannot_do_is_refused(backend, requested, word):
    with pytest.raises(OptionError) as error:
        load_backend(backend).check(NodeOptions(**requested))
    assert word in str(error.value)


def test_a_publisher_that_reports_another_value_was_not_given_what_was_requested():
    (difference,) = publisher_differences(
        {"priority": "1", "when_full": "drop"}, {"priority": "5", "when_full": "drop"}
    )
    assert (difference.setting, difference.asked, difference.applied) == (Setting.PRIORITY, "1", "5")
    assert publisher_differences({"priority": "1"}, {}) == ()
