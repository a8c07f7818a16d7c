"""Nodes without a recorder, for `bench_node.py`: blocking TCP sockets, bare rclpy on two executors, and bare zenoh.

    python benchmarks/plain_nodes.py socket-echo PORT BYTES
    python benchmarks/plain_nodes.py socket-ping PORT BYTES RATE MESSAGES
    python benchmarks/plain_nodes.py ros2-echo BYTES              # and ros2-events-echo, zenoh-echo PORT
    python benchmarks/plain_nodes.py ros2-ping BYTES RATE MESSAGES  # and ros2-events-ping, zenoh-ping PORT

An echo prints `ready` and serves until it is ended; a ping prints the round-trip times of its messages in ns, as JSON. Each
message has its number: with one time of sending for all, an echo that takes longer than a period looks fast.
"""

# ruff: noqa: PLC0415 - rclpy and zenoh are loaded by the programs that use them

from __future__ import annotations

import json
import os
import socket
import sys
import threading
import time
from functools import partial
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

TOPICS = ("plain_ping", "plain_pong")


def receive_whole(connection: socket.socket, buffer: bytearray) -> bool:
    """Fill `buffer`; return False at the end of the connection."""
    left = memoryview(buffer)
    while left:
        count = connection.recv_into(left)
        if not count:
            return False
        left = left[count:]
    return True


def socket_echo(port: int, size: int) -> None:
    """Send every message back."""
    with socket.create_server(("127.0.0.1", port)) as server:
        print("ready", flush=True)
        connection, _ = server.accept()
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        buffer = bytearray(size)
        while receive_whole(connection, buffer):
            connection.sendall(buffer)


def socket_ping(port: int, size: int, rate_hz: int, messages: int) -> None:
    """Send a message, wait for its echo, sleep until the next one is due."""
    connection = socket.create_connection(("127.0.0.1", port))
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    message, buffer, times_ns = bytes(size), bytearray(size), []
    due_ns = time.monotonic_ns()
    for _ in range(messages):
        due_ns += 10**9 // rate_hz
        time.sleep(max(due_ns - time.monotonic_ns(), 0) / 1e9)
        begin_ns = time.monotonic_ns()
        connection.sendall(message)
        receive_whole(connection, buffer)
        times_ns.append(time.monotonic_ns() - begin_ns)
    print(json.dumps(times_ns))


class Echoes:
    """The times of numbered messages; `receive` is called by the thread that takes their echoes."""

    def __init__(self, messages: int) -> None:
        self._sent_ns, self._back_ns = [0] * messages, [0] * messages

    def receive(self, number: int) -> None:
        self._back_ns[number] = time.monotonic_ns()

    def send_all(self, rate_hz: int, send: Callable[[int], None]) -> None:
        """Send at a rate, print the round trips after the last echo, or after a second, and end the process."""
        due_ns = time.monotonic_ns()
        for number in range(len(self._sent_ns)):
            due_ns += 10**9 // rate_hz
            time.sleep(max(due_ns - time.monotonic_ns(), 0) / 1e9)
            self._sent_ns[number] = time.monotonic_ns()
            send(number)
        until_s = time.monotonic() + 1
        while not all(self._back_ns) and time.monotonic() < until_s:
            time.sleep(0.01)
        pairs = zip(self._sent_ns, self._back_ns, strict=True)
        print(json.dumps([back_ns - sent_ns for sent_ns, back_ns in pairs if back_ns]), flush=True)
        os._exit(0)  # rclpy's own end waits for the spinning thread


def ros2_node(
    name: str, incoming: str, outgoing: str, receive: Callable[[Any], None], *, is_events: bool
) -> tuple[Callable[[], None], Any]:
    """Return what spins the executor, and a publisher; `receive` gets every serialized message of `incoming`."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from std_msgs.msg import String

    rclpy.init()
    node = rclpy.create_node(name)
    publisher = node.create_publisher(String, outgoing, 10)
    node.create_subscription(String, incoming, receive, 10, raw=True)
    executor: Any = SingleThreadedExecutor()
    if is_events:
        from rclpy.experimental import EventsExecutor

        executor = EventsExecutor()
    executor.add_node(node)

    def spin() -> None:
        while True:
            executor.spin_once(timeout_sec=1)

    return spin if is_events else executor.spin, publisher


def ros2_echo(_size: int, *, is_events: bool = False) -> None:
    """Send every message back, from the executor's thread."""
    spin, publisher = ros2_node("plain_echo", *TOPICS, lambda message: publisher.publish(message), is_events=is_events)  # noqa: PLW0108 - made before the publisher is known
    print("ready", flush=True)
    spin()


def ros2_ping(size: int, rate_hz: int, messages: int, *, is_events: bool = False) -> None:
    """Publish on the main thread at a rate; a thread spins the executor, and stamps each echo first of all."""
    echoes = Echoes(messages)
    spin, publisher = ros2_node(
        "plain_ping", *reversed(TOPICS), lambda message: echoes.receive(int(message[8:16], 16)), is_events=is_events
    )
    threading.Thread(target=spin, daemon=True).start()
    head, text = b"\0\1\0\0" + (size + 1).to_bytes(4, "little"), b"x" * (size - 8) + b"\0"
    while publisher.get_subscription_count() < 1:
        time.sleep(0.05)
    time.sleep(1)  # the echo has to find the subscription of this side as well
    echoes.send_all(rate_hz, lambda number: publisher.publish(b"%b%08x%b" % (head, number, text)))


def zenoh_session(port: int, *, listens: bool) -> Any:
    import zenoh

    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5(f"{'listen' if listens else 'connect'}/endpoints", json.dumps([f"tcp/127.0.0.1:{port}"]))
    if not listens:
        config.insert_json5("listen/endpoints", "[]")
    return zenoh.open(config)


def zenoh_publisher(session: Any, key: str) -> Any:
    import zenoh

    return session.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK)


def zenoh_echo(port: int, _size: int, *, writes: bool = False) -> None:
    """Send every message back from zenoh's thread, as it is or with eight bytes written, as a relay writes its id."""
    session = zenoh_session(port, listens=True)
    publisher = zenoh_publisher(session, TOPICS[1])

    def receive(sample: Any) -> None:
        if not writes:
            publisher.put(sample.payload)
            return
        message = bytearray(sample.payload.to_bytes())
        message[-8:] = b"%08x" % port
        publisher.put(message)

    subscriber = session.declare_subscriber(TOPICS[0], receive)
    print("ready", flush=True)
    threading.Event().wait()
    subscriber.undeclare()


def zenoh_ping(port: int, size: int, rate_hz: int, messages: int) -> None:
    """Publish on the main thread at a rate; zenoh's thread stamps each echo."""
    session, echoes = zenoh_session(port, listens=False), Echoes(messages)

    def receive(sample: Any) -> None:
        echoes.receive(int(sample.payload.to_bytes()[:8], 16))

    subscriber = session.declare_subscriber(TOPICS[1], receive)
    publisher, text = zenoh_publisher(session, TOPICS[0]), bytes(size - 8)
    time.sleep(1)
    echoes.send_all(rate_hz, lambda number: publisher.put(b"%08x%b" % (number, text)))
    subscriber.undeclare()


PROGRAMS: dict[str, Callable[..., None]] = {
    "socket-echo": socket_echo,
    "socket-ping": socket_ping,
    "ros2-echo": ros2_echo,
    "ros2-ping": ros2_ping,
    "ros2-events-echo": partial(ros2_echo, is_events=True),
    "ros2-events-ping": partial(ros2_ping, is_events=True),
    "zenoh-echo": zenoh_echo,
    "zenoh-ping": zenoh_ping,
    "zenoh-write-echo": partial(zenoh_echo, writes=True),
    "zenoh-write-ping": zenoh_ping,
}

if __name__ == "__main__":
    PROGRAMS[sys.argv[1]](*map(int, sys.argv[2:]))
