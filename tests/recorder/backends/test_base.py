import threading

import pytest
from toy_backend import ToyNode

from dds_trace.base.errors import OptionError
from dds_trace.recorder.applied.differences import Setting, publisher_differences
from dds_trace.recorder.backends import BACKEND_MODULES, installed_middlewares, load_backend, load_backends, open_node
from dds_trace.recorder.backends.base import Meeting
from dds_trace.recorder.backends.node import Endpoint, NodeOptions
from dds_trace.recorder.backends.qos import (
    duration_extra,
    incompatible_pairs,
    mismatches,
    requested_durations,
    warn_of_depth,
)
from dds_trace.recorder.choices import Discovery, ExecutorKind, Security, Transport, WhenFull
from dds_trace.recorder.roles.lanes import message_objects_of
from dds_trace.tracefile.format.descriptions import Qos

LOCAL = {"domain_id": 3, "discovery": Discovery.LOCALHOST}


@pytest.mark.parametrize("name", BACKEND_MODULES)
def test_the_facts_of_a_backend_fit_together(name):
    backend = load_backend(name)
    assert backend.name == name
    assert (backend.relay_port is not None) is (backend.meeting is Meeting.PEERS)
    assert ("{port}" in backend.meeting_needs) is (backend.relay_port is not None)
    assert ("{dds_backends}" in backend.meeting_needs) is backend.speaks_dds
    assert Transport.DEFAULT in backend.transports


def test_relays_of_two_backends_share_no_port():
    ports = [backend.relay_port for backend in load_backends() if backend.relay_port is not None]
    assert len(set(ports)) == len(ports)
    assert all(2 <= port < 10 for port in ports)  # DDS participants use 0, 1 and those from 10 on


@pytest.mark.parametrize("name", BACKEND_MODULES)
@pytest.mark.parametrize(
    ("more", "is_known", "line"),
    [
        ({"domain_id": 233}, lambda _: False, "--domain 233: a DDS domain id must be between 0 and 232"),
        ({"rmw": "rmw_x"}, lambda backend: backend.has_ros, "--rmw rmw_x: the backend {} has no ROS middleware"),
        ({"executor": ExecutorKind.SINGLE}, lambda backend: backend.has_ros, "-o executor=single: the backend {}"),
        (
            {"transport": Transport.SHM},
            lambda backend: Transport.SHM in backend.transports,
            "-o transport=shm: the backend {} only has default",
        ),
        (
            {"peers": ("pi4",)},
            lambda backend: backend.meeting is not Meeting.DISCOVERY,
            "--peer pi4: the backend {} discovers",
        ),
    ],
)
def test_an_option_without_a_meaning_is_refused_and_named(name, more, is_known, line):
    backend, options = load_backend(name), NodeOptions(**{**LOCAL, **more})
    if is_known(backend):
        backend.check(options)
    else:
        with pytest.raises(OptionError, match=line.format(name)):
            backend.check(options)


@pytest.mark.parametrize("name", ["ros2", "cyclonedds"])
def test_a_secured_domain_is_one_that_the_governance_covers(name):
    backend, secured = load_backend(name), {**LOCAL, "security": Security.SIGN}
    backend.check(NodeOptions(**{**secured, "domain_id": 230}))
    with pytest.raises(OptionError, match="at most 230"):
        backend.check(NodeOptions(**{**secured, "domain_id": 231}))


def test_the_relays_address_is_this_device_unless_given():
    backend = load_backend("socket")
    port = 7400 + 250 * 3 + 8
    assert backend.peer_addresses(NodeOptions(**LOCAL)) == (("127.0.0.1", port),)
    told = NodeOptions(domain_id=3, peers=("pi4", "10.0.0.2:99"))
    assert backend.peer_addresses(told) == (("pi4", port), ("10.0.0.2", 99))
    with pytest.raises(OptionError, match="the backend socket does not look for relays on the network"):
        backend.peer_addresses(NodeOptions(domain_id=3))


def test_each_rmw_of_an_installation_is_a_middleware_and_connext_needs_a_licence(tmp_path, monkeypatch):
    index = tmp_path / "share/ament_index/resource_index/rmw_typesupport"
    index.mkdir(parents=True)
    for name in ("rmw_fastrtps_cpp", "rmw_cyclonedds_cpp"):
        (index / name).touch()
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path}")
    monkeypatch.delenv("RTI_LICENSE_FILE", raising=False)
    monkeypatch.setattr("dds_trace.recorder.backends.ros2.installation.has_package", lambda name: name == "rclpy")
    found = installed_middlewares()
    assert [pair for pair in found if pair[0] == "ros2"] == [
        ("ros2", "rmw_cyclonedds_cpp"),
        ("ros2", "rmw_fastrtps_cpp"),
    ]
    assert ("socket", None) in found
    assert ("connext", None) not in found
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    assert ("ros2", None) in installed_middlewares()
    monkeypatch.setattr("dds_trace.recorder.backends.ros2.installation.has_package", lambda _: False)
    assert "ros2" not in dict(installed_middlewares())


RELIABLE, BEST_EFFORT = Qos(), Qos(reliability="best_effort")
LATCHED = Qos(durability="transient_local")


@pytest.mark.parametrize(
    ("offered", "requested", "found"),
    [
        (RELIABLE, RELIABLE, []),
        (RELIABLE, BEST_EFFORT, []),
        (BEST_EFFORT, RELIABLE, ["reliability (best_effort offered, reliable requested)"]),
        (RELIABLE, LATCHED, ["durability (volatile offered, transient_local requested)"]),
        (LATCHED, RELIABLE, []),
        (Qos(reliability="unknown"), RELIABLE, []),
        (Qos(depth=1), Qos(depth=1000, history="keep_all"), []),
        (Qos(extra={"deadline_ns": 20_000_000}), Qos(extra={"deadline_ns": 20_000_000}), []),
        (Qos(extra={"deadline_ns": 5}), Qos(), []),
        (Qos(), Qos(extra={"deadline_ns": 20_000_000}), ["deadline (none offered, 20ms requested)"]),
        (
            Qos(extra={"deadline_ns": 1_500_000_000}),
            Qos(extra={"deadline_ns": 20_000_000}),
            ["deadline (1.5s offered, 20ms requested)"],
        ),
        (Qos(), Qos(extra={"lifespan_ns": 5}), []),
    ],
)
def test_offered_against_requested(offered, requested, found):
    assert mismatches(offered, requested) == found


def test_durations_without_end_are_left_out():
    told_ns = {"deadline": 20_000_000, "lifespan": (2**31 - 1) * 10**9}
    assert duration_extra(told_ns) == {"deadline_ns": 20_000_000}
    assert duration_extra({"deadline": 0, "lifespan": 2**63 - 1}) == {}
    assert requested_durations(Qos(extra={"lifespan_ns": 7, "vendor": "x"})) == {"lifespan": 7}


def test_pairs_of_ours_are_named_and_others_are_not(sentences):
    type_name = "sensor_msgs/msg/Imu"
    ours, theirs = Endpoint("me", type_name, BEST_EFFORT), Endpoint("they", type_name, RELIABLE)
    unknown = Endpoint("bare", type_name)
    (line,) = incompatible_pairs("imu_data", [ours, unknown], [theirs], "me")
    sentences(line)
    assert list(incompatible_pairs("imu_data", [ours], [theirs], "somebody")) == []


@pytest.mark.parametrize(
    ("history", "depth", "rate_hz", "warned"),
    [
        ("keep_last", 10, 100, True),
        ("keep_last", 10, 101, True),
        ("keep_last", 101, 1000, False),
        ("keep_last", 1, 10.5, True),
        ("keep_last", 1, 0.1, False),
        ("keep_all", 1, 1000, False),
    ],
)
def test_a_depth_below_rate_times_stall_is_warned_of(history, depth, rate_hz, warned):
    assert (warn_of_depth(history, depth, rate_hz) is not None) == warned


class WakingNode(ToyNode):
    """A toy node that counts how often it was woken and how often it left."""

    def __init__(self):
        super().__init__(NodeOptions(domain_id=3, name="waking"))
        self.calls = []

    def _wake(self):
        self.calls.append("wake")

    def _leave(self):
        self.calls.append("leave")
        super()._leave()


def test_messages_are_received_on_a_thread_of_the_nodes_name():
    received, arrived = [], threading.Event()

    def receive(message, _source_ns=0, _received_ns=0, /):
        received.append((threading.current_thread().name, message))
        arrived.set()

    with ToyNode(NodeOptions(domain_id=3)) as node:
        node.create_subscription("x", "std_msgs/msg/String", receive)
        publisher = node.create_publisher("x", "std_msgs/msg/String")
        publisher.publish(b"before the start")
        assert received == []
        node.start()
        while not arrived.wait(0.1):
            assert node.error is None
    assert received == [("toy-domain-3", b"before the start")]


def test_an_error_of_a_callback_ends_the_thread_and_is_kept():
    def fail(*_):
        raise ValueError("ours")

    with WakingNode() as node:
        node.create_subscription("x", "std_msgs/msg/String", fail)
        node.start()
        node.create_publisher("x", "std_msgs/msg/String").publish(b"")
        node._thread.join()
        assert str(node.error) == "ours"
    assert node.calls == ["wake", "leave"]


def test_closing_twice_leaves_once_and_needs_no_start():
    node = WakingNode()
    node.close()
    node.close()
    assert node.calls == ["wake", "leave"]


def test_a_node_without_message_objects_says_so():
    with (
        ToyNode(NodeOptions(domain_id=3)) as node,
        pytest.raises(OptionError, match="-o serialization=typed: the backend toy only carries serialized"),
    ):
        message_objects_of(node)


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
