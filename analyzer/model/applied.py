"""The settings that a recording process really used, as its session tells (`applied` and `not_applied`, docs/trace-format.md).

A trace may hold any JSON there, and older ones hold none: each function then says that nothing is known.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    from dds_trace.tracefile.format.descriptions import Session

SHARED_MEMORY, UNKNOWN = "shm", "unknown"
"""Values of `payload_path` beside the names of interfaces."""


_HEADERS_BYTES = 512
"""Octets that surround a payload in its datagrams: IP, UDP, RTPS submessages, the stamped header of ours, generously."""

_LARGEST_PACKET_BYTES = 65_535
"""Octets of an IP packet at most (RFC 791): an interface with that MTU, such as `lo`, cuts none."""


def words_not_applied(session: Session) -> tuple[str, ...]:
    """Return a sentence, without a full stop, for each setting that was asked for and not applied."""
    listed = session.extra.get("not_applied")
    entries = listed if isinstance(listed, list) else []
    words = [entry.get("words") for entry in entries if isinstance(entry, dict)]
    return tuple(dict.fromkeys(each for each in words if isinstance(each, str) and each))


def payload_path(session: Session) -> str | None:
    """Return what carried the payload: `shm`, an interface or `unknown`; None of a session that does not tell."""
    path = _object(session.extra.get("applied")).get("path")
    return path if isinstance(path, str) else None


def maps_memory(session: Session) -> bool:
    """Tell whether the process had its vendor's shared memory open."""
    return any(
        each.get("middleware") == session.vendor and each.get("is_deleted") is False
        for each in _listed(_instant(session, "begin"), "memory")
    )


def udp_receive_buffer_bytes(session: Session) -> int | None:
    """Return the largest receive buffer of the process's UDP sockets as Linux shows it, None if there is none.

    Sockets that only send keep the system's default, so the largest one is that of the sockets that receive.
    """
    sockets = _listed(_instant(session, "begin"), "sockets")
    sizes = [_integer(each, "receive_buffer_bytes") for each in sockets if each.get("protocol") == "udp"]
    return max((size for size in sizes if size is not None), default=None)


def congestion_controls(session: Session) -> tuple[str, ...]:
    """Return the congestion controls of the process's TCP connections, sorted; empty without a connection."""
    states = [each.get("tcp") for each in _listed(_instant(session, "begin"), "sockets")]
    names = {state.get("congestion_control") for state in states if isinstance(state, dict)}
    return tuple(sorted(name for name in names if isinstance(name, str) and name))


def socket_drops(session: Session) -> int | None:
    """Return the datagrams that the kernel dropped at the process's own sockets from its first message to its end.

    None where the sockets of one of the two instants are unknown.
    """
    begin, end = (_instant(session, name) for name in ("begin", "end"))
    if not isinstance(begin.get("sockets"), list) or not isinstance(end.get("sockets"), list):
        return None
    before = {each.get("inode"): _integer(each, "dropped") or 0 for each in _listed(begin, "sockets")}
    drops = [(_integer(each, "dropped") or 0, each.get("inode")) for each in _listed(end, "sockets")]
    return sum(max(count - before.get(inode, 0), 0) for count, inode in drops)


def kernel_counts(session: Session) -> dict[str, int]:
    """Return by how much each kernel counter of the host (`ReasmFails` and so on) rose from the first message to the end."""
    begin, end = (_object(_instant(session, name).get("counters")) for name in ("begin", "end"))
    rises = {name: (_integer(begin, name), _integer(end, name)) for name in end}
    return {
        name: now - then
        for name, (then, now) in rises.items()
        if then is not None and now is not None and now >= then
    }


def may_be_cut(session: Session, payload_bytes: int) -> bool:
    """Tell whether the kernel may have cut datagrams of such a message into IP fragments; an unknown path may."""
    path = payload_path(session)
    if path == SHARED_MEMORY:
        return False
    mtu_bytes = _integer(_object(session.host.get("mtu")), path) if path is not None else None
    return mtu_bytes is None or min(payload_bytes + _HEADERS_BYTES, _LARGEST_PACKET_BYTES) > mtu_bytes


def kernel_limits(session: Session) -> dict[str, int]:
    """Return the kernel settings that bound buffers and reassembly (`net.ipv4.ipfrag_time` and so on)."""
    limits = _object(_instant(session, "begin").get("limits"))
    return {name: value for name in limits if (value := _integer(limits, name)) is not None}


def _instant(session: Session, name: str) -> Mapping[str, object]:
    return _object(_object(session.extra.get("applied")).get(name))


def _listed(instant: Mapping[str, object], name: str) -> list[Mapping[str, object]]:
    listed = instant.get(name)
    return [_object(each) for each in listed] if isinstance(listed, list) else []


def _object(value: object) -> Mapping[str, object]:
    return value if isinstance(value, dict) else {}


def _integer(held: Mapping[str, object], name: str) -> int | None:
    value = held.get(name)
    return value if isinstance(value, int) and not isinstance(value, bool) else None
