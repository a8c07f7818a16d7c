from __future__ import annotations

import os
import socket

import pytest

from dds_trace.recorder.service.upkeep import STATUS_PERIOD_S, ServiceManager


@pytest.fixture(params=["path", "abstract"])
def listening(tmp_path, request):
    """A socket, and its address as NOTIFY_SOCKET has it."""
    address = str(tmp_path / "notify") if request.param == "path" else f"@dds-trace-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(address.replace("@", "\0"))
        listener.setblocking(False)
        yield listener, address


def test_ready_once_then_status_now_and_then_and_the_watchdog_at_each_look(listening):
    listener, address = listening
    now_s = 100.0
    environment = {"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "2000000", "WATCHDOG_PID": str(os.getpid()), "A": "b"}
    manager = ServiceManager(environment, lambda: now_s)
    assert environment == {"A": "b"}  # nobody speaks for us
    manager.notify("1 message")
    manager.notify("2 messages")
    now_s += STATUS_PERIOD_S
    manager.notify("3 messages")
    manager.close()
    manager.notify("closed")
    said = [listener.recv(4096).decode() for _ in range(4)]
    assert said == [
        "READY=1\nWATCHDOG=1\nSTATUS=1 message",
        "WATCHDOG=1",
        "WATCHDOG=1\nSTATUS=3 messages",
        "STOPPING=1",
    ]
    with pytest.raises(BlockingIOError):
        listener.recv(4096)


def test_a_watchdog_of_another_process_is_none_of_ours(listening):
    listener, address = listening
    manager = ServiceManager({"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "1", "WATCHDOG_PID": "1"})
    manager.notify("x")
    manager.close()
    assert listener.recv(4096) == b"READY=1\nSTATUS=x"


def test_nobody_who_listens_holds_nobody_up(tmp_path):
    for environment in ({}, {"NOTIFY_SOCKET": str(tmp_path / "gone")}, {"NOTIFY_SOCKET": "@nobody-here"}):
        manager = ServiceManager(environment)
        manager.notify("x")
        manager.close()
