from __future__ import annotations

import threading

import pytest
from toy_backend import ToyNode

from dds_trace.base.errors import OptionError
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.roles.lanes import message_objects_of


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
        pytest.raises(OptionError, match="--serialization typed: the backend toy only carries serialized"),
    ):
        message_objects_of(node)
