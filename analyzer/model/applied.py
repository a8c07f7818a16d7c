"""Settings that a recording process used, by its session."""

from __future__ import annotations

from collections.abc import Mapping

from dds_trace.tracefile.format.descriptions import Session
from dds_trace.tracefile.format.json_fields import object_of, objects_of

SHARED_MEMORY, UNKNOWN = "shm", "unknown"
"""Values of `payload_path` that are no interfaces."""

_HEADERS_BYTES = 256
"""Most bytes around a payload: IP, UDP, RTPS submessages, our stamped header."""

_LARGEST_PACKET_BYTES = 65_535
"""Largest IP packet (RFC 791): `lo`, with that MTU, cuts none."""

_LEAST_MTU_BYTES = 1280
"""Of IPv6 (RFC 8200): no link that cuts smaller packets is met."""


def words_not_applied(session: Session) -> tuple[str, ...]:
    words = [entry.get("words") for entry in objects_of(session.extra.get("not_applied"))]
    return tuple(dict.fromkeys(text for text in words if isinstance(text, str) and text))


def payload_path(session: Session) -> str | None:
    path = object_of(session.extra.get("applied")).get("path")
    return path if isinstance(path, str) else None


def maps_memory(session: Session) -> bool:
    return any(
        segment.get("middleware") == session.vendor and segment.get("is_deleted") is False
        for segment in objects_of(_instant(session, "begin").get("memory"))
    )


def udp_receive_buffer_bytes(session: Session) -> int | None:
    """Return the largest of the UDP sockets: those that only send keep a small default."""
    sockets = objects_of(_instant(session, "begin").get("sockets"))
    sizes = [_integer(socket, "receive_buffer_bytes") for socket in sockets if socket.get("protocol") == "udp"]
    return max((size for size in sizes if size is not None), default=None)


def congestion_controls(session: Session) -> tuple[str, ...]:
    states = [socket.get("tcp") for socket in objects_of(_instant(session, "begin").get("sockets"))]
    names = {object_of(state).get("congestion_control") for state in states}
    return tuple(sorted(name for name in names if isinstance(name, str) and name))


def socket_drops(session: Session) -> int | None:
    begin, end = (_instant(session, name) for name in ("begin", "end"))
    if not isinstance(begin.get("sockets"), list) or not isinstance(end.get("sockets"), list):
        return None
    before = {socket.get("inode"): _integer(socket, "dropped") or 0 for socket in objects_of(begin.get("sockets"))}
    drops = [
        (_integer(socket, "dropped") or 0, socket.get("inode"))
        for socket in objects_of(end.get("sockets"))
        if socket.get("protocol") == "udp"
    ]
    return sum(max(count - before.get(inode, 0), 0) for count, inode in drops)


def is_tuned(session: Session) -> bool:
    return object_of(session.extra.get("asked")).get("tuned") is True


def maps_foreign_memory(session: Session) -> bool | None:
    """Return whether the process mapped a segment of another one at the end of its run; None if unknown."""
    memory = _instant(session, "end").get("memory")
    if not isinstance(memory, list):
        return None
    return any(file.get("is_own") is not True and file.get("is_deleted") is False for file in objects_of(memory))


def interface_bytes(session: Session) -> dict[str, int]:
    begin, end = (object_of(_instant(session, name).get("interfaces")) for name in ("begin", "end"))
    sent = {name: [_integer(object_of(totals.get(name)), "sent_bytes") for totals in (begin, end)] for name in end}
    return {name: now - (then or 0) for name, (then, now) in sent.items() if now is not None}


def kernel_counts(session: Session) -> dict[str, int]:
    begin, end = (object_of(_instant(session, name).get("counters")) for name in ("begin", "end"))
    rises = {name: (_integer(begin, name), _integer(end, name)) for name in end}
    return {
        name: now - then for name, (then, now) in rises.items() if then is not None and now is not None and now >= then
    }


def may_be_cut(session: Session, payload_bytes: int) -> bool:
    path = payload_path(session)
    if path == SHARED_MEMORY:
        return False
    mtus = object_of(session.host.get("mtu"))
    known = (_integer(mtus, name) for name in ([path] if path is not None and path in mtus else mtus))
    mtu_bytes = min((size for size in known if size is not None), default=_LEAST_MTU_BYTES)
    return min(payload_bytes + _HEADERS_BYTES, _LARGEST_PACKET_BYTES) > mtu_bytes


def kernel_limits(session: Session) -> dict[str, int]:
    """Return limits of buffers and reassembly (`net.ipv4.ipfrag_time`)."""
    limits = object_of(_instant(session, "begin").get("limits"))
    return {name: value for name in limits if (value := _integer(limits, name)) is not None}


def _instant(session: Session, name: str) -> Mapping[str, object]:
    return object_of(object_of(session.extra.get("applied")).get(name))


def _integer(fields: Mapping[str, object], name: str) -> int | None:
    value = fields.get(name)
    return value if isinstance(value, int) and not isinstance(value, bool) else None
