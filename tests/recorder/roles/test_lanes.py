import threading
from types import SimpleNamespace

import pytest
from fake_clock import FakeClock
from fake_node import FakeNode, FakePublisher, FakeSubscription, ListSink

from dds_trace.base.errors import OptionError
from dds_trace.recorder.choices import Serialization
from dds_trace.recorder.payloads import IMU, header_data_type
from dds_trace.recorder.payloads.base import Message, Payload
from dds_trace.recorder.payloads.stamp import HEADER_STAMP
from dds_trace.recorder.roles.lanes import object_lane, raw_lane
from dds_trace.recorder.roles.ping import open_ping
from dds_trace.recorder.roles.plan import RunPlan
from dds_trace.recorder.roles.relay import Relay
from dds_trace.tracefile.format.descriptions import Qos

RELAY = 0x2A
NEVER = threading.Event()


class ObjectPublisher(FakePublisher):
    def publish(self, message, /):
        self.sent.append(message)
        if self.on_publish is not None:
            self.on_publish(message)


class ObjectFakeNode(FakeNode):
    """A fake node that also has message objects, as that of ROS 2; an object knows the bytes that it was made of."""

    def create_object_publisher(self, topic, type_name, *, qos=None):
        del type_name, qos
        return self.publishers.setdefault(topic, ObjectPublisher(topic))

    def create_object_subscription(self, topic, type_name, receive, *, qos=None):
        del type_name, qos
        return self.subscriptions.setdefault(topic, FakeSubscription(topic, receive))

    def message_from_cdr(self, type_name, data):
        header = SimpleNamespace(frame_id="", stamp=SimpleNamespace(sec=0, nanosec=0))
        return SimpleNamespace(header=header, made_of=(type_name, bytes(data)))

    def message_to_cdr(self, message):
        return message.made_of[1]


def test_a_ping_and_a_relay_of_message_objects_record_all_four_stages():
    clock, node = FakeClock(1_000_000_000_000), ObjectFakeNode()
    sink = ListSink(clock)
    Relay(node, sink, RELAY, data_types=[IMU], qos=Qos(), serialization=Serialization.TYPED, clock=clock)
    plan = RunPlan(IMU.make(None, 1), 100.0, 3, serialization=Serialization.TYPED)
    ping = open_ping(node, plan, clock)
    node.publishers["imu_data"].on_publish = lambda message: node.deliver("imu_data", message)
    node.publishers["imu_data_relay"].on_publish = lambda message: node.deliver("imu_data_relay", message)
    run = ping.run(sink, NEVER)
    assert run.serialization == "typed"
    (message,) = {id(sent): sent for sent in node.publishers["imu_data"].sent}.values()  # one object, sent thrice
    assert message.made_of == (IMU.type_name, bytes(plan.payload.messages[0].data))
    assert HEADER_STAMP.read(message) == (run.run_id, 2, RELAY)
    for stage, relay_id in ((1, 0), (3, RELAY), (4, RELAY), (2, RELAY)):
        events = sink.of_stage(stage)
        assert [event[:2] for event in events] == [(run.run_id, sequence) for sequence in range(3)]
        assert {event[-2:] for event in events} == {(296, relay_id)}


class OneArrival:
    skipped = 0

    def __init__(self, message):
        self.messages = [message]

    def begin(self):
        pass

    def take(self, _stop):
        return (self.messages.pop(), 77) if self.messages else None


def test_messages_of_a_live_source_become_objects_too():
    clock, node = FakeClock(1_000_000_000_000), ObjectFakeNode()
    sink = ListSink(clock)
    (message,) = IMU.make(None, 5).messages
    payload = Payload(IMU, (message,), 296, feed=OneArrival(Message(bytearray(message.data), 296)))
    ping = open_ping(node, RunPlan(payload, 100.0, 2, serialization=Serialization.TYPED), clock)
    run = ping.run(sink, NEVER)
    (sent,) = node.publishers["imu_data"].sent
    assert HEADER_STAMP.read(sent) == (run.run_id, 0, 0)
    assert [(event[3], event[-2]) for event in sink.of_stage(1)] == [(77, 296)]


def test_bytes_are_patched_where_they_lie():
    (message,) = IMU.make(None, 1).messages
    assert raw_lane(FakeNode()).message_of(IMU, message) is message.data


def test_a_node_or_a_type_without_message_objects_is_refused():
    with pytest.raises(OptionError, match="-o serialization=typed: the backend ros2 only carries serialized"):
        object_lane(FakeNode())
    cloud = header_data_type("sensor_msgs/msg/PointCloud2")
    with pytest.raises(OptionError, match="sensor_msgs/msg/PointCloud2 is only sent as raw"):
        object_lane(ObjectFakeNode()).form_of(cloud)
