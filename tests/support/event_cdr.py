"""Events as bytes, packed and unpacked by hand after `docs/trace-format.md`: what the writer and the reader are held to."""

import struct

CDR_HEADER = b"\x00\x01\x00\x00"
EVENT = struct.Struct("<QQqqqqII")


def pack_event(
    run_id: int,
    sequence: int,
    monotonic_ns: int,
    scheduled_ns: int = 0,
    source_ns: int = 0,
    received_ns: int = 0,
    payload_bytes: int = 0,
    relay_id: int = 0,
) -> bytes:
    fields = (run_id, sequence, monotonic_ns, scheduled_ns, source_ns, received_ns, payload_bytes, relay_id)
    return CDR_HEADER + EVENT.pack(*fields)


def unpack_event(data: bytes) -> tuple[int, ...]:
    assert len(data) == len(CDR_HEADER) + EVENT.size
    assert data[: len(CDR_HEADER)] == CDR_HEADER
    return EVENT.unpack_from(data, len(CDR_HEADER))
