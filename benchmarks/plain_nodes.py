"""Nodes without a recorder, which `bench_node.py` runs beside ours: blocking TCP sockets, and bare rclpy.

    python benchmarks/plain_nodes.py socket-echo PORT BYTES
    python benchmarks/plain_nodes.py socket-ping PORT BYTES RATE MESSAGES
    python benchmarks/plain_nodes.py ros2-echo BYTES
    python benchmarks/plain_nodes.py ros2-ping BYTES RATE MESSAGES

An echo prints `ready` and serves until it is ended; a ping prints the round-trip times of its messages in ns, as JSON.
"""

# ruff: noqa: PLC0415 - rclpy is loaded by the programs that use it alone

from __future__ import annotations

import json
import os
import socket
import sys
import threading
import time
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


def ros2_node(name: str, incoming: str, outgoing: str, receive: Callable[[Any], None]) -> tuple[Any, Any]:
    """Return an executor and a publisher: `receive` gets every serialized message of `incoming`."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from std_msgs.msg import String

    rclpy.init()
    node = rclpy.create_node(name)
    publisher = node.create_publisher(String, outgoing, 10)
    node.create_subscription(String, incoming, receive, 10, raw=True)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    return executor, publisher


def ros2_echo(_size: int) -> None:
    """Send every message back, from the executor's thread."""
    executor, publisher = ros2_node("plain_echo", *TOPICS, lambda message: publisher.publish(message))  # noqa: PLW0108 - made before the publisher is known
    print("ready", flush=True)
    executor.spin()


def ros2_ping(size: int, rate_hz: int, messages: int) -> None:
    """Publish on the main thread at a rate; a thread spins the executor, and stamps each echo first of all."""
    sent_ns, times_ns = [0], []

    def receive(_message: bytes) -> None:
        times_ns.append(time.monotonic_ns() - sent_ns[0])

    executor, publisher = ros2_node("plain_ping", *reversed(TOPICS), receive)
    threading.Thread(target=executor.spin, daemon=True).start()
    message = b"\0\1\0\0" + (size + 1).to_bytes(4, "little") + b"x" * size + b"\0"
    while publisher.get_subscription_count() < 1:
        time.sleep(0.05)
    time.sleep(1)  # the echo has to find the subscription of this side as well
    due_ns = time.monotonic_ns()
    for _ in range(messages):
        due_ns += 10**9 // rate_hz
        time.sleep(max(due_ns - time.monotonic_ns(), 0) / 1e9)
        sent_ns[0] = time.monotonic_ns()
        publisher.publish(message)
    time.sleep(0.2)
    print(json.dumps(times_ns), flush=True)
    os._exit(0)  # rclpy's own end waits for the spinning thread


PROGRAMS: dict[str, Callable[..., None]] = {
    "socket-echo": socket_echo,
    "socket-ping": socket_ping,
    "ros2-echo": ros2_echo,
    "ros2-ping": ros2_ping,
}

if __name__ == "__main__":
    PROGRAMS[sys.argv[1]](*map(int, sys.argv[2:]))
