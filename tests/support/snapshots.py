"""Read-backs drawn by hand: the parts of a snapshot that a test is about."""

from dds_trace.recorder.applied.applied import Applied, Snapshot
from dds_trace.recorder.applied.memory import SharedMemory
from dds_trace.recorder.applied.vendors import PORT, SEGMENT
from dds_trace.recorder.kernel.counters import InterfaceCounters
from dds_trace.recorder.kernel.sockets import Socket, TcpState

DEFAULT_BUFFER_BYTES = 212_992


def udp(port, receive_buffer_bytes=DEFAULT_BUFFER_BYTES, send_buffer_bytes=DEFAULT_BUFFER_BYTES, **more):
    return Socket("udp", "ipv4", "127.0.0.1", port, "0.0.0.0", 0, receive_buffer_bytes, send_buffer_bytes, **more)


def tcp(acked_bytes=0, received_bytes=0, *, remote="127.0.0.1", inode=1, dropped=0):
    state = TcpState("cubic", acked_bytes=acked_bytes, received_bytes=received_bytes)
    return Socket("tcp", "ipv4", "127.0.0.1", 40_000, remote, 10_909, 131_072, 16_384, dropped, inode=inode, tcp=state)


def segment(name="fastrtps_00000000000000aa", *, vendor="fastdds", is_own=True, **more):
    return SharedMemory(name, vendor, SEGMENT, 549_408, 0, is_own=is_own, is_served=is_own is not None or None, **more)


def port(number=7411, *, is_own=True, is_served=True):
    return SharedMemory(f"fastrtps_port{number}", "fastdds", PORT, 52_400, 0, is_own=is_own, is_served=is_served)


def counted(**interfaces):
    return {name: InterfaceCounters(*pair) for name, pair in interfaces.items()}


def applied(*, sockets=(), memory=(), limits=None, begin=None, end=None, begin_sockets=None):
    """A pair of snapshots, or with `end` None the beginning alone; `begin` and `end` are interface counters."""
    begun = Snapshot(
        sockets=sockets if begin_sockets is None else begin_sockets,
        memory=memory,
        interfaces=begin or {},
        limits=limits or {},
    )
    if end is None:
        return Applied(begun)
    return Applied(begun, Snapshot(sockets=sockets, memory=memory, interfaces=end, limits=limits or {}))
