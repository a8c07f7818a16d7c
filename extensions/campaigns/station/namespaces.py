"""Two network namespaces in place of two devices, joined by a link."""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import os
import re
import shutil
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.base.errors import BackendUnavailableError, OptionError, TraceError
from dds_trace.recorder.host.child import Child

from ..plan.cells import OutageBy
from ..plan.link import EndCounters, ForwarderReport, Link, LinkReport
from .emulation import (
    DROPPING_HANDLE,
    INTERFACE,
    SYSTEM_PATH,
    LinkEvents,
    count_traffic,
    ip,
    open_tap,
    queue_disciplines,
    start_forwarder,
    tc,
)

if TYPE_CHECKING:
    from typing_extensions import Self


_NAME = re.compile(r"ddstrace-(\d+)-\d+-(?:ping|relay|switch|host\d+)")
_ROLES = ("ping", "relay")
_PATIENCE_S = 10.0
OTHER_ADDRESS = "10.213.0.11"
_AIR = "ifb0"
_counter = itertools.count()


@dataclass(frozen=True, slots=True)
class Side:
    namespace: str
    address: str

    @property
    def prefix(self) -> list[str]:
        """Words before a command that run it in this namespace, as on a device of its own.

        Zenoh would bypass the link by /dev/shm, and Fast DDS 3 takes a peer with the same machine id for one of this device.
        """
        memory = "mount -t tmpfs -o mode=1777 tmpfs /dev/shm"
        machine_id = hashlib.sha256(self.namespace.encode()).hexdigest()[:32]
        own_id = f"{memory} && echo {machine_id} >/dev/shm/id && mount --bind /dev/shm/id /etc/machine-id"
        own = f'if test -f /etc/machine-id; then {own_id}; fi && {memory} && exec "$@"'
        system_ip = shutil.which("ip", path=SYSTEM_PATH) or "ip"
        return [system_ip, "netns", "exec", self.namespace, "sh", "-c", own, "sh"]


def _is_air(link: Link | None) -> bool:
    return link is not None and link.shared and link.needs_only_rate


class NamespacePair:
    """Two namespaces, with further hosts one for each and a bridge, and the link of them, by default a bare veth."""

    def __init__(self, link: Link | None, hosts: int = 1, *, has_air: bool = False) -> None:
        self.link = self._shaped = link
        self._number = next(_counter)
        prefix = f"ddstrace-{os.getpid()}-{self._number}"
        self.ping, self.relay = (Side(f"{prefix}-{role}", f"10.213.0.{host}") for host, role in enumerate(_ROLES, 1))
        further = (Side(f"{prefix}-host{host}", f"10.213.0.{20 + host}") for host in range(2, hosts + 1))
        self.relays = (self.relay, *further)
        self._has_air = has_air or _is_air(link)
        self._switch = f"{prefix}-switch" if hosts > 1 or self._has_air else ""
        self._shaped_ends: list[tuple[str, str]] = []  # namespace and device with the queue disciplines
        self.applied_by = ""
        self.commands: list[str] = []
        self._forwarder: Child | None = None
        self._taps: list[int] = []
        self._drive_started_ns: int | None = None
        self._disciplines: list[list[str]] = []
        self._counted: dict[Side, EndCounters] = {}

    def __enter__(self) -> Self:
        require_root()
        remove_stale()
        try:
            self._create()
        except BaseException:
            self._remove()
            raise
        return self

    def __exit__(self, *_error: object) -> None:
        self._remove()

    def report(self) -> LinkReport:
        return {
            "monotonic_ns": time.monotonic_ns(),
            "link": self._shaped.to_dict() if self._shaped else None,
            "applied_by": self.applied_by,
            "commands": self.commands,
            "ping": self._traffic_since(self.ping),
            "relay": self._traffic_since(self.relay),
            "forwarder": self._ask_forwarder(),
            "drive_started_ns": self._drive_started_ns,
        }

    def drive(self, *, starts: bool) -> None:
        self._drive_started_ns = time.monotonic_ns() if starts else None
        assert self._forwarder is not None
        self._forwarder.say(f"start {self._drive_started_ns}" if starts else "rest")

    def shape(self, link: Link) -> None:
        """Change what is shaped: the queue, or of links that only have a rate the whole link."""
        if link == self._shaped:
            return
        self._shaped = link
        for namespace, device in self._shaped_ends:
            tc("-n", namespace, "qdisc", "del", "dev", device, "root")
        if self._has_air:
            self._redirect(is_air=_is_air(link))
        self._add_disciplines(link)

    def cut(self, by: OutageBy) -> int:
        """Return when the first frame could no longer pass, by CLOCK_MONOTONIC."""
        with LinkEvents([side.namespace for side in (self.ping, self.relay)]) as events:
            if by is OutageBy.LOSS:
                for side in (self.ping, self.relay):
                    replaced = f"qdisc replace dev {INTERFACE} root handle {DROPPING_HANDLE:x}: pfifo limit 0"
                    tc("-n", side.namespace, *replaced.split())
            else:
                ip("-n", self.ping.namespace, "link", "set", INTERFACE, "down")
            done_ns = time.monotonic_ns()
        return events.first_ns(passes=False) or done_ns

    def restore(self, by: OutageBy) -> int:
        """Return when frames could pass again, by CLOCK_MONOTONIC."""
        with LinkEvents([side.namespace for side in (self.ping, self.relay)]) as events:
            if by is OutageBy.LOSS:
                self._restore_disciplines()
            else:
                if by is OutageBy.ADDRESS:
                    self._set_address(OTHER_ADDRESS)
                self._bring_up(self.ping)
            done_ns = time.monotonic_ns()
        kernel_ns = events.last_ns(passes=True) if by is OutageBy.LOSS else events.first_ns(passes=True)
        return kernel_ns or done_ns

    def repair(self) -> None:
        self._restore_disciplines()
        self._set_address(self.ping.address)
        self._bring_up(self.ping)

    def _set_address(self, address: str) -> None:
        ip("-n", self.ping.namespace, "address", "flush", "dev", INTERFACE)
        ip("-n", self.ping.namespace, "address", "add", f"{address}/24", "dev", INTERFACE)

    def _bring_up(self, side: Side) -> None:
        ip("-n", side.namespace, "link", "set", INTERFACE, "up")
        # DDS discovery and Zenoh scouting send to multicast groups, which need a route.
        ip("-n", side.namespace, "route", "replace", "224.0.0.0/4", "dev", INTERFACE)

    def _restore_disciplines(self) -> None:
        for side in (self.ping, self.relay):
            if f"qdisc pfifo {DROPPING_HANDLE:x}:" in tc("-n", side.namespace, "qdisc", "show", "dev", INTERFACE):
                self._renew_disciplines(side.namespace)

    def _renew_disciplines(self, namespace: str) -> None:
        tc("-n", namespace, "qdisc", "del", "dev", INTERFACE, "root")
        if (namespace, INTERFACE) in self._shaped_ends:
            for discipline in self._disciplines:
                tc("-n", namespace, "qdisc", "add", "dev", INTERFACE, *discipline)

    def _add_disciplines(self, link: Link) -> None:
        ends = [(side.namespace, INTERFACE) for side in (self.ping, *self.relays)]
        if _is_air(link):
            ends = [(self._switch, _AIR)]
        self._disciplines = queue_disciplines(link, kernel_does_all=not self._taps)
        self._shaped_ends = ends if self._disciplines else []
        for (namespace, device), discipline in itertools.product(self._shaped_ends, self._disciplines):
            tc("-n", namespace, "qdisc", "add", "dev", device, *discipline)
        applied = ["tap_forwarder" if self._taps else "veth", *(["ifb"] if _is_air(link) else [])]
        kinds = [discipline[discipline.index("handle") + 2] for discipline in self._disciplines]
        self.applied_by = "+".join(applied + kinds)
        self.commands = ["tc qdisc add dev " + " ".join([ends[0][1], *discipline]) for discipline in self._disciplines]

    def _traffic_since(self, side: Side) -> EndCounters:
        now = count_traffic(side.namespace)
        before = self._counted.get(side, EndCounters(sent_bytes=0, sent_packets=0, dropped_packets=0))
        self._counted[side] = now
        return {
            "sent_bytes": now["sent_bytes"] - before["sent_bytes"],
            "sent_packets": now["sent_packets"] - before["sent_packets"],
            "dropped_packets": now["dropped_packets"] - before["dropped_packets"],
        }

    def _create(self) -> None:
        sides = (self.ping, *self.relays)
        for side in sides:
            ip("netns", "add", side.namespace)
            ip("-n", side.namespace, "link", "set", "lo", "up")
        link = self.link
        needs_forwarder = (
            link is not None
            and not link.needs_only_rate
            and (bool(link.outage_ms or link.file or link.shared) or not self._has_netem())
        )
        if needs_forwarder:
            self._taps = [
                open_tap(f"ddt{os.getpid()}.{self._number}{role[0]}", side.namespace)
                for role, side in zip(_ROLES, sides, strict=True)
            ]
        elif self._switch:
            self._join(sides)
        else:
            ip("-n", sides[0].namespace, "link", "add", INTERFACE, "type", "veth",
               "peer", "name", INTERFACE, "netns", sides[1].namespace)  # fmt: skip
        for side in sides:
            ip("-n", side.namespace, "address", "add", f"{side.address}/24", "dev", INTERFACE)
            self._bring_up(side)
        self.applied_by = "veth"
        if self._has_air:
            ip("-n", self._switch, "link", "add", _AIR, "type", "ifb")
            ip("-n", self._switch, "link", "set", _AIR, "up")
            self._redirect(is_air=_is_air(link))
        if link is not None:
            self._add_disciplines(link)
        if needs_forwarder and link is not None:
            self._forwarder = start_forwarder(self._taps, link)
        self.report()  # the traffic of the setup does not count

    def _join(self, sides: Iterable[Side]) -> None:
        ip("netns", "add", self._switch)
        ip("-n", self._switch, "link", "add", "bridge0", "type", "bridge", "mcast_snooping", "0")
        ip("-n", self._switch, "link", "set", "bridge0", "up")
        for number, side in enumerate(sides):
            port = f"port{number}"
            ip("-n", side.namespace, "link", "add", INTERFACE, "type", "veth",
               "peer", "name", port, "netns", self._switch)  # fmt: skip
            ip("-n", self._switch, "link", "set", port, "master", "bridge0", "up")

    def _redirect(self, *, is_air: bool) -> None:
        """Send what comes in at each port through one ifb: redirected on its way out, a sender would feel no full line."""
        for number in range(1 + len(self.relays)):
            tc("-n", self._switch, "qdisc", "replace", "dev", f"port{number}", "clsact")
            if is_air:
                words = f"filter replace dev port{number} ingress protocol all prio 1 handle 800::800 u32 match u32 0 0"
                tc("-n", self._switch, *words.split(), *f"action mirred egress redirect dev {_AIR}".split())
            else:
                tc("-n", self._switch, "filter", "del", "dev", f"port{number}", "ingress")

    def _has_netem(self) -> bool:
        try:
            tc("-n", self.ping.namespace, "qdisc", "add", "dev", "lo", "root", "netem", "delay", "1ms")
        except BackendUnavailableError:
            return False
        tc("-n", self.ping.namespace, "qdisc", "del", "dev", "lo", "root")
        return True

    def _ask_forwarder(self) -> ForwarderReport | None:
        if self._forwarder is None:
            return None
        self._forwarder.say("report")
        report: ForwarderReport = self._forwarder.answer()
        return report

    def _remove(self) -> None:
        if self._forwarder is not None:
            with self._forwarder:
                self._forwarder.end(_PATIENCE_S)
            self._forwarder = None
        for descriptor in self._taps:
            os.close(descriptor)
        self._taps = []
        for name in (self.ping.namespace, *(side.namespace for side in self.relays), self._switch):
            with contextlib.suppress(BackendUnavailableError):  # creating it may have failed
                ip("netns", "delete", name)


def remove_stale() -> list[str]:
    removed = []
    for match in map(_NAME.match, ip("netns", "list").splitlines()):
        if match and not Path("/proc", match[1]).exists():
            with contextlib.suppress(BackendUnavailableError):  # another sweep may remove it at the same time
                ip("netns", "delete", match[0])
                removed.append(match[0])
    return removed


def require_root() -> None:
    if os.geteuid() != 0:
        raise OptionError("[network] and [link] need root to make network namespaces; run `dds-trace sweep` with sudo")


def permitted() -> Iterator[tuple[str, str, bool, str]]:
    """Yield the check of `doctor` whether this process may make networks of its own."""
    refusal = ""
    try:
        with NamespacePair(None):
            pass
    except TraceError as err:
        refusal = str(err)
    yield "permissions", "[network] and [link] of a plan", not refusal, refusal or "permitted"
