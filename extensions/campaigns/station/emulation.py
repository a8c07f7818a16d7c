"""The parts of an emulated link."""

from __future__ import annotations

import ctypes
import fcntl
import json
import os
import selectors
import shutil
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.base.errors import BackendUnavailableError
from dds_trace.recorder.host.child import Child

from ..plan.link import EndCounters, Link
from .tap_forwarder import burst_chances

if TYPE_CHECKING:
    from typing_extensions import Self

INTERFACE = "link0"

SYSTEM_PATH = os.environ.get("PATH", "") + ":/usr/sbin:/sbin"  # where Debian has `ip` and `tc`

# <linux/if_tun.h>
_TUNSETIFF = 0x400454CA
_IFF_TAP, _IFF_NO_PI = 0x0002, 0x1000

# <linux/sched.h>, <linux/netlink.h>, <linux/rtnetlink.h>, <linux/if.h>
_CLONE_NEWNET, _NETLINK_ROUTE, _LINK_AND_TC = 0x40000000, 0, 0x1 | 0x8
_NEW_LINK, _NEW_DISCIPLINE, _REMOVED_DISCIPLINE = 16, 36, 37
_UP_AND_CARRIER = 0x1 | 0x10000

DROPPING_HANDLE = 0xFF

_TBF_BURST_FRAMES_BYTES = 2 * 1514
_TBF_BURST_S = 0.0002
"""Largest burst of a token bucket at the full rate: as short as the kernel's timers allow."""


def ip(*arguments: str) -> str:
    return _system("ip", *arguments)


def tc(*arguments: str) -> str:
    return _system("tc", *arguments)


def _system(program: str, *arguments: str) -> str:
    path = shutil.which(program, path=SYSTEM_PATH)
    if path is None:
        raise BackendUnavailableError(f"{program} is not installed; apt install iproute2")
    try:
        return subprocess.run([path, *arguments], capture_output=True, text=True, check=True).stdout
    except subprocess.CalledProcessError as err:
        raise BackendUnavailableError(
            f"{program} {' '.join(arguments)}: {err.stderr.strip() or err.returncode}"
        ) from err


def count_traffic(namespace: str) -> EndCounters:
    shown = json.loads(ip("-n", namespace, "-s", "-j", "link", "show", "dev", INTERFACE))
    sent = shown[0]["stats64"]["tx"]
    disciplines = json.loads(tc("-n", namespace, "-s", "-j", "qdisc", "show", "dev", INTERFACE) or "[]")
    return {
        "sent_bytes": sent["bytes"],
        "sent_packets": sent["packets"],
        "dropped_packets": sent["dropped"] + sum(discipline.get("drops", 0) for discipline in disciplines),
    }


def queue_disciplines(link: Link, *, kernel_does_all: bool) -> list[list[str]]:
    disciplines: list[list[str]] = []
    parent = ["root"]
    if link.rate_mbit_s and not (link.shared and not link.needs_only_rate):  # else the forwarder has the rate
        burst_bytes = max(_TBF_BURST_FRAMES_BYTES, round(link.rate_mbit_s * 1e6 / 8 * _TBF_BURST_S))
        disciplines.append(
            [*parent, "handle", "1:", "tbf", "rate", f"{link.rate_mbit_s:g}mbit", "burst", f"{burst_bytes}b",
             "latency", f"{link.queue_ms:g}ms"],
        )  # fmt: skip
        parent = ["parent", "1:1"]
    if kernel_does_all and not link.needs_only_rate:
        loss = ["loss", f"{link.loss_percent:g}%"]
        if link.loss_burst > 1:
            enter, leave = burst_chances(link.loss_percent / 100, link.loss_burst)
            loss = ["loss", "gemodel", f"{100 * enter:g}%", f"{100 * leave:g}%"]
        # netem's limit counts packets in flight; its default of 1000 drops at 12 MB/s and 1 s.
        disciplines.append(
            [*parent, "handle", "10:", "netem", "delay", f"{link.delay_ms:g}ms", f"{link.jitter_ms:g}ms",
             "distribution", "normal", *loss, "limit", "50000"],
        )  # fmt: skip
    return disciplines


class LinkEvents:
    """When the kernel takes the link of namespaces down and up (rtnetlink); the commands themselves take up to 72 ms."""

    def __init__(self, namespaces: Sequence[str]) -> None:
        with ThreadPoolExecutor(1) as pool:  # a thread of its own, as it changes its namespace
            self._sockets = [pool.submit(_route_socket, namespace).result() for namespace in namespaces]
        self._wake, self._waker = os.pipe()
        self._thread = threading.Thread(target=self._read, name="link-events", daemon=True)
        self._times: list[tuple[int, bool]] = []

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        os.write(self._waker, b"x")  # what the commands changed is in the sockets by now
        self._thread.join()
        for descriptor in (self._wake, self._waker):
            os.close(descriptor)
        for netlink in self._sockets:
            netlink.close()

    def first_ns(self, *, passes: bool) -> int | None:
        return min((at_ns for at_ns, state in self._times if state is passes), default=None)

    def last_ns(self, *, passes: bool) -> int | None:
        return max((at_ns for at_ns, state in self._times if state is passes), default=None)

    def _read(self) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._wake, selectors.EVENT_READ)
            for netlink in self._sockets:
                selector.register(netlink, selectors.EVENT_READ)
            while ready := [key.fileobj for key, _ in selector.select()]:
                at_ns = time.monotonic_ns()
                for netlink in self._sockets:
                    if netlink in ready:
                        self._times += [(at_ns, passes) for passes in link_changes(netlink.recv(65_536))]
                if ready == [self._wake]:
                    return


def _route_socket(namespace: str) -> socket.socket:
    with Path("/run/netns", namespace).open("rb") as file:
        if ctypes.CDLL(None, use_errno=True).setns(file.fileno(), _CLONE_NEWNET):
            raise BackendUnavailableError(f"network namespace {namespace}: {os.strerror(ctypes.get_errno())}")
    netlink = socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, _NETLINK_ROUTE)
    netlink.bind((0, _LINK_AND_TC))
    return netlink


def link_changes(messages: bytes) -> Iterator[bool]:
    at = 0
    while at + 28 <= len(messages):
        length, kind = struct.unpack_from("IH", messages, at)
        index, value = struct.unpack_from("=iI", messages, at + 20)
        if kind == _NEW_LINK and index != 1:
            yield value & _UP_AND_CARRIER == _UP_AND_CARRIER
        elif kind in (_NEW_DISCIPLINE, _REMOVED_DISCIPLINE) and value == DROPPING_HANDLE << 16:
            yield kind == _REMOVED_DISCIPLINE
        at += max(16, (length + 3) & ~3)


def open_tap(name: str, namespace: str) -> int:
    try:
        descriptor = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
        fcntl.ioctl(descriptor, _TUNSETIFF, struct.pack("16sH14x", name.encode(), _IFF_TAP | _IFF_NO_PI))
    except OSError as err:
        raise BackendUnavailableError(
            f"/dev/net/tun: {err.strerror}; this kernel has no netem, and without TAP devices (modprobe tun) "
            "a link can only have a rate"
        ) from err
    ip("link", "set", name, "netns", namespace, "name", INTERFACE)
    return descriptor


def start_forwarder(taps: Sequence[int], link: Link) -> Child:
    program = Path(__file__).with_name("tap_forwarder.py")
    drive = link.drive
    values: dict[str, object] = {"rows": ()}
    if drive is not None:
        values = {"rows": drive.rows, "has_rate": drive.has_rate}
    elif link.shared:
        values["has_rate"] = True
    with tempfile.TemporaryFile("w+") as file:  # a drive is longer than an argument may be
        json.dump({**link.to_dict(), **values}, file)
        file.seek(0)
        # -I -S starts fastest: only the standard library.
        return Child(
            [sys.executable, "-I", "-S", program, *taps, file.fileno()],
            ends_by_input=True,
            lost=lambda: BackendUnavailableError("the emulated link ended by itself; run the sweep again"),
            stdout=subprocess.PIPE,
            pass_fds=(*taps, file.fileno()),
        )
