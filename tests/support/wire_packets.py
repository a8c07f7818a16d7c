"""Frames drawn by hand, octet by octet; nothing of the code under test takes part."""

import struct

import numpy as np

PING, RELAY, GROUP = "10.0.0.1", "10.0.0.2", "239.255.0.1"
PREFIX = bytes(range(1, 13))
WRITER, READER = 0x00001203, 0x00001304
SPDP_WRITER, SEDP_WRITER, LIVELINESS_WRITER = 0x000100C2, 0x000003C2, 0x000200C2
OUTGOING, HOST = 4, 0
ETHERNET = bytes(12) + b"\x08\x00"


def ipv4(payload, source=PING, destination=RELAY, *, protocol=17, ip_id=7, offset=0, more=False):
    header = struct.pack(
        ">BBHHHBBH4s4s",
        0x45,
        0,
        20 + len(payload),
        ip_id,
        (0x2000 if more else 0) | offset // 8,
        64,
        protocol,
        0,
        bytes(map(int, source.split("."))),
        bytes(map(int, destination.split("."))),
    )
    return ETHERNET + header + payload


def udp(payload, source_port=40000, destination_port=7411):
    return struct.pack(">HHHH", source_port, destination_port, 8 + len(payload), 0) + payload


def tcp(sequence, payload=b"", source_port=7500, destination_port=50000, flags=0x10):
    return (
        struct.pack(">HHIIBBHHH", source_port, destination_port, sequence, 1, 8 << 4, flags, 1000, 0, 0)
        + bytes(12)
        + payload
    )


def rtps(*submessages, prefix=PREFIX):
    return b"RTPS\x02\x03\x01\x10" + prefix + b"".join(submessages)


def submessage(kind, body, flags=1, length=None):
    order = "<" if flags & 1 else ">"
    return struct.pack(order + "BBH", kind, flags, len(body) if length is None else length) + body


def info_ts():
    return submessage(0x09, bytes(8))


def info_dst(prefix=PREFIX):
    return submessage(0x0E, prefix)


def entities(reader, writer):
    return struct.pack(">II", reader, writer)


def data(sequence, payload, writer=WRITER, order="<"):
    flags = 0x05 if order == "<" else 0x04
    head = struct.pack(order + "HH", 0, 16) + entities(READER, writer)
    return submessage(0x15, head + struct.pack(order + "iI", sequence >> 32, sequence & 0xFFFFFFFF) + payload, flags)


def data_with_inline_qos(sequence, payload):
    qos = struct.pack("<HH", 0x0071, 8) + bytes(8) + struct.pack("<HH", 1, 0)
    head = struct.pack("<HH", 0, 16) + entities(READER, WRITER) + struct.pack("<iI", 0, sequence)
    return submessage(0x15, head + qos + payload, 0x07)


def data_frag(sequence, fragment, payload, sample_bytes, writer=WRITER, count=1):
    head = struct.pack("<HH", 0, 28) + entities(READER, writer) + struct.pack("<iI", 0, sequence)
    return submessage(0x16, head + struct.pack("<IHHI", fragment, count, len(payload) // count, sample_bytes) + payload)


def heartbeat(first, last, writer=WRITER):
    return submessage(0x07, entities(READER, writer) + struct.pack("<iIiII", 0, first, 0, last, 1))


def acknack(base, missing=0, writer=WRITER):
    bitmap = struct.pack("<I", 0xFFFFFFFF) if missing else b""
    return submessage(
        0x06, entities(READER, writer) + struct.pack("<iII", 0, base, missing) + bitmap + struct.pack("<I", 1)
    )


def nack_frag(sequence, writer=WRITER):
    return submessage(0x12, entities(READER, writer) + struct.pack("<iIIIII", 0, sequence, 1, 1, 1 << 31, 1))


def stamped(run_id, sequence, relay_id=0, more=b""):
    stamp = b"dt1:%016x:%016x:%08x" % (run_id, sequence, relay_id)
    return b"\0\1\0\0" + bytes(8) + struct.pack("<I", 47) + stamp + b"\0\0" + more


def fragmented(datagram, piece_bytes, **address):
    """The IP fragments of a UDP datagram, `piece_bytes` (a multiple of 8) in each."""
    offsets = range(0, len(datagram), piece_bytes)
    return [
        ipv4(
            datagram[offset : offset + piece_bytes], offset=offset, more=offset + piece_bytes < len(datagram), **address
        )
        for offset in offsets
    ]


def frame_batch(frames, times_ns=None, captured=None, packet_type=OUTGOING):
    """Frames as a ring hands them over: one behind the other in one memory."""
    from dds_trace.extensions.wire.frames import FrameBatch

    kept = [frame[: captured[number] if captured else None] for number, frame in enumerate(frames)]
    lengths = np.array([len(frame) for frame in kept], np.int64)
    return FrameBatch(
        memory=np.frombuffer(b"".join(kept) or b"\0", np.uint8),
        position=np.cumsum(lengths) - lengths,
        captured_bytes=lengths,
        wire_bytes=np.array([len(frame) for frame in frames], np.int64),
        wall_ns=np.array(times_ns if times_ns is not None else range(len(frames)), np.int64),
        packet_type=np.full(len(frames), packet_type, np.uint8),
    )
