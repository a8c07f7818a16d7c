import signal
import sys
import textwrap
import threading
import time
from types import SimpleNamespace

import pytest
from processes import PATIENCE_S, executed

from dds_trace.base.errors import BackendUnavailableError, OptionError
from dds_trace.recorder.applied.vendors import ros_middleware
from dds_trace.recorder.backends import load_backend, open_node
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.backends.qos import other_definitions
from dds_trace.recorder.backends.ros2 import node as ros2
from dds_trace.recorder.choices import Discovery, ExecutorKind, Transport
from dds_trace.recorder.payloads import BINARY, IMU, data_types
from dds_trace.tracefile.format.descriptions import Qos

pytest.importorskip("rclpy", reason="no ROS 2 here")
pytestmark = pytest.mark.middleware

EXECUTORS = [ExecutorKind.EVENTS, ExecutorKind.SINGLE]


def options(domain_id, name="one", **more):
    return NodeOptions(domain_id=domain_id, name=name, discovery=Discovery.LOCALHOST, **more)


class Mailbox:
    def __init__(self):
        self.messages = []
        self._some = threading.Condition()

    def receive(self, message, source_ns=0, received_ns=0, /):
        with self._some:
            self.messages.append((message, source_ns, received_ns))
            self._some.notify_all()

    def wait_for(self, count, prompt=lambda: None):
        deadline = time.monotonic() + PATIENCE_S
        with self._some:
            while len(self.messages) < count:
                assert time.monotonic() < deadline, f"{len(self.messages)} of {count} messages"
                prompt()
                self._some.wait(0.1)
            return self.messages[:count]


@pytest.mark.parametrize("executor", EXECUTORS)
@pytest.mark.parametrize("data_type", data_types().values(), ids=lambda data_type: data_type.name)
def test_bytes_arrive_as_they_were_sent(domain_id, executor, data_type):
    (message,) = data_type.make(None, 1).messages
    data_type.raw.stamp.write(message.data, 3, 4)
    mailbox = Mailbox()
    with open_node("ros2", options(domain_id, executor=executor)) as node:
        node.create_subscription(data_type.topic, data_type.type_name, mailbox.receive)
        publisher = node.create_publisher(data_type.topic, data_type.type_name)
        node.start()
        before_ns = time.time_ns()
        ((received, source_ns, received_ns),) = mailbox.wait_for(1, lambda: publisher.publish(message.data))
        assert received == message.data
        assert before_ns <= source_ns <= received_ns <= time.time_ns()
        assert node.error is None


def test_typed_messages_arrive_as_objects(domain_id):
    mailbox, typed = Mailbox(), IMU.objects.stamp
    with open_node("ros2", options(domain_id)) as node:
        node.create_object_subscription("imu_data", IMU.type_name, mailbox.receive)
        publisher = node.create_object_publisher("imu_data", IMU.type_name)
        message = node.message_from_cdr(IMU.type_name, IMU.make(None, 1).messages[0].data)
        typed.write(message, 3, 4)
        node.start()
        ((received, _, _),) = mailbox.wait_for(1, lambda: publisher.publish(message))
        assert typed.read(received) == (3, 4, 0)
        assert received.linear_acceleration.z == message.linear_acceleration.z != 0


def test_two_domains_in_one_process_do_not_hear_each_other(domains):
    data, boxes = IMU.make(None, 1).messages[0].data, [Mailbox(), Mailbox()]
    with (
        open_node("ros2", options(domains.take(), "one")) as one,
        open_node("ros2", options(domains.take(), "two")) as two,
    ):
        publishers = []
        for node, box in zip((one, two), boxes, strict=True):
            node.create_subscription("imu_data", IMU.type_name, box.receive)
            publishers.append(node.create_publisher("imu_data", IMU.type_name))
            node.start()
        boxes[0].wait_for(3, lambda: publishers[0].publish(data))
        assert boxes[1].messages == []
        boxes[1].wait_for(1, lambda: publishers[1].publish(data))
        assert one.count_participants() == two.count_participants() == 1


def test_a_node_says_what_carries_it(domain_id):
    with open_node("ros2", options(domain_id)) as node:
        middleware = node.middleware
    assert (middleware.backend, middleware.vendor) == ("ros2", "fastdds")
    assert middleware.rmw == "rmw_fastrtps_cpp"
    assert {"rclpy", "rmw_fastrtps_cpp"} < set(middleware.versions)
    assert all(version[0].isdigit() for version in middleware.versions.values())
    assert middleware.settings["discovery"] == "localhost"
    assert middleware.settings["executor"] == "events"


def test_transports_and_tuning_are_recorded(domain_id):
    done = python(
        f"""
        from dds_trace.recorder.backends import open_node
        from dds_trace.recorder.backends.node import NodeOptions
        from dds_trace.recorder.choices import Discovery, Transport
        options = NodeOptions({domain_id}, discovery=Discovery.LOCALHOST, transport=Transport.UDP, tuned=True)
        with open_node("ros2", options) as node:
            print(*node.middleware.settings.values())
        """
    )
    # Under localhost discovery a profile of ours does what FASTDDS_BUILTIN_TRANSPORTS cannot.
    words = "events localhost udp true written by dds-trace for this machine only"
    assert done.stdout.split() == words.split(), done.stderr


def test_an_rclpy_without_message_info_gets_the_callback_as_it_is(monkeypatch):
    # Humble's subscriptions have no CallbackType and call with the message alone.
    old = SimpleNamespace(subscription=SimpleNamespace(Subscription=object))
    monkeypatch.setattr(ros2, "_rclpy", lambda: old)
    receive = Mailbox().receive
    assert ros2._with_info(receive, stamps_reception=True) == receive


@pytest.mark.parametrize(("rmw", "received_ns"), [("rmw_fastrtps_cpp", 7), ("rmw_cyclonedds_cpp", 0)])
def test_the_time_of_the_take_is_no_reception_time(monkeypatch, rmw, received_ns):
    new = SimpleNamespace(subscription=SimpleNamespace(Subscription=SimpleNamespace(CallbackType=object)))
    monkeypatch.setattr(ros2, "_rclpy", lambda: new)
    got = []
    on_message = ros2._with_info(
        lambda *message: got.append(message), stamps_reception=ros_middleware(rmw).stamps_reception
    )
    on_message("message", {"source_timestamp": 5, "received_timestamp": 7})
    assert got == [("message", 5, received_ns)]


@pytest.mark.parametrize(
    ("info", "source"),
    [
        (
            {"publisher_gid": {"implementation_identifier": "rmw_fastrtps_cpp", "data": bytes(range(24))}},
            bytes(range(16)).hex(),
        ),
        ({"publisher_gid": None}, None),
        ({}, None),
    ],
)
def test_a_tap_has_the_publisher_of_a_message_where_rclpy_gives_it(monkeypatch, info, source):
    new = SimpleNamespace(subscription=SimpleNamespace(Subscription=SimpleNamespace(CallbackType=object)))
    monkeypatch.setattr(ros2, "_rclpy", lambda: new)
    got = []
    on_message = ros2._with_sequence(lambda *message: got.append(message), stamps_reception=True)
    on_message("message", {"source_timestamp": 5, "received_timestamp": 7, "publication_sequence_number": 3, **info})
    assert got == [("message", 5, 7, 3, source)]


@pytest.mark.parametrize("executor", EXECUTORS)
def test_quality_of_service_that_never_matches_is_seen(domain_id, executor):
    with (
        open_node("ros2", options(domain_id, "one", executor=executor)) as one,
        open_node("ros2", options(domain_id, "two", executor=executor)) as two,
    ):
        one.create_publisher("imu_data", IMU.type_name, qos=Qos(reliability="best_effort"))
        two.create_subscription("imu_data", IMU.type_name, Mailbox().receive)
        one.start()
        two.start()
        expected = "imu_data: publisher of one and subscription of two differ in reliability"
        deadline = time.monotonic() + PATIENCE_S
        views = []
        # The middleware's event comes first and knows the policy alone; the graph names both sides.
        while not all(line.startswith(expected) for view in views for line in view.incompatible or ("",)) or not views:
            assert time.monotonic() < deadline, views
            time.sleep(0.05)
            views = [node.look_at("imu_data") for node in (one, two)]
        assert [each.node_name for each in views[0].publishers] == ["one"]
        assert [each.type_name for each in views[1].subscriptions] == [IMU.type_name]
        assert one.count_participants() == 2


def test_python_keeps_its_signal_handlers(domain_id):
    # The EventsExecutor takes SIGINT and SIGTERM for itself when it is made and resets them when it goes.
    seen = []
    before = signal.signal(signal.SIGTERM, lambda number, _: seen.append(number))
    try:
        with open_node("ros2", options(domain_id)) as node:
            node.start()
            signal.raise_signal(signal.SIGTERM)
            assert seen == [signal.SIGTERM]
        signal.raise_signal(signal.SIGTERM)
        assert seen == [signal.SIGTERM] * 2
    finally:
        signal.signal(signal.SIGTERM, before)


def test_options_that_ros_cannot_meet_are_refused(domain_id):
    with open_node("ros2", options(domain_id)) as node:
        with pytest.raises(OptionError, match="RATHER"):
            node.create_publisher("x", IMU.type_name, qos=Qos(reliability="rather"))
        with pytest.raises(BackendUnavailableError, match=r"nowhere_msgs/msg/None.* apt install"):
            node.create_publisher("x", "nowhere_msgs/msg/None")
    with pytest.raises(OptionError, match="large-data"):
        open_node("ros2", options(domain_id, transport=Transport.LARGE_DATA, tuned=True))
    with pytest.raises(OptionError, match="--peer pi4: the backend ros2 discovers"):
        open_node("ros2", options(domain_id, peers=("pi4",)))


def test_there_is_no_other_backend():
    with pytest.raises(OptionError, match="no backend 'dds'; choose one of ros2"):
        load_backend("dds")


def python(code, **environment):
    """`code` in a process of its own; the middleware is chosen when rclpy is imported."""
    return executed([sys.executable, "-c", textwrap.dedent(code)], environment, timeout=PATIENCE_S)


@pytest.mark.parametrize(
    ("option", "environment"), [("None", {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}), ("'rmw_cyclonedds_cpp'", {})]
)
def test_a_missing_middleware_is_one_line_and_no_dead_process(domain_id, option, environment):
    done = python(
        f"""
        from dds_trace.recorder.backends import open_node
        from dds_trace.recorder.backends.node import NodeOptions
        from dds_trace.base.errors import BackendUnavailableError
        try:
            open_node("ros2", NodeOptions(domain_id={domain_id}, rmw={option}))
        except BackendUnavailableError as error:
            print(error)
        """,
        **environment,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("RMW_IMPLEMENTATION=rmw_cyclonedds_cpp does not work here: ")
    assert "apt install ros-$ROS_DISTRO-rmw-cyclonedds-cpp" in done.stdout


def test_binary_data_of_some_megabytes_arrives_whole(domain_id):
    data, mailbox = BINARY.make(2_000_000, 1).messages[0].data, Mailbox()
    with open_node("ros2", options(domain_id)) as node:
        node.create_subscription(BINARY.topic, BINARY.type_name, mailbox.receive)
        publisher = node.create_publisher(BINARY.topic, BINARY.type_name)
        node.start()
        ((received, _, _),) = mailbox.wait_for(1, lambda: publisher.publish(data))
        assert received == data


def test_a_message_without_a_notification_does_not_wait_for_later_ones(domain_id):
    mailbox, topic = Mailbox(), "unnotified"
    message = BINARY.make(100, 0).messages[0].data
    with open_node("ros2", options(domain_id, executor=ExecutorKind.EVENTS)) as node:
        subscription = node.create_subscription(topic, BINARY.type_name, mailbox.receive)
        node._executor.remove_node(node._node)  # so that the executor is told of nothing
        node.start()
        publisher = node.create_publisher(topic, BINARY.type_name)
        mailbox.wait_for(3, lambda: publisher.publish(message))
        subscription.close()
        assert node.error is None


class StuckReader:
    """A subscription as Fast DDS leaves it after half a large message: its first message is taken and stays."""

    msg_type, raw = None, True

    def __init__(self, *messages):
        self.handle, self.messages = self, list(messages)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def take_message(self, _type, _raw):
        message = self.messages[0]
        if len(self.messages) > 1:
            del self.messages[0]
        return message, {"source_timestamp": message, "received_timestamp": message + 5}


def test_a_message_that_is_readable_for_ever_is_handed_on_once():
    handed = []
    left = ros2._Ros2Subscription(None, StuckReader(1, 2, 3), lambda message, _info: handed.append(message))
    left.take_left()
    left.take_left()
    assert handed == [1, 2, 3]


def test_a_type_of_the_same_name_and_another_definition_is_named(sentences):
    def info(node_name, type_hash, topic_type="sensor_msgs/msg/Imu"):
        return SimpleNamespace(node_name=node_name, topic_type=topic_type, topic_type_hash=type_hash)

    ours = info("me", "RIHS01_aa")
    sentences(*other_definitions("imu_data", [ours, info("you", "RIHS01_bb")], "me"))
    alike = [info("you", "RIHS01_aa"), info("cyclone", "INVALID"), info("other", "RIHS01_cc", "std_msgs/msg/String")]
    assert (
        list(
            other_definitions(
                "imu_data", [ours, *alike, SimpleNamespace(node_name="humble", topic_type=ours.topic_type)], "me"
            )
        )
        == []
    )
