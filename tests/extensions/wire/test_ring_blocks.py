"""Blocks of a ring as the kernel fills them (TPACKET_V3), drawn by hand in plain memory."""

import struct

import numpy as np
import pytest

from dds_trace.extensions.wire.ring import PacketRing

BLOCK_BYTES, BLOCKS = 1024, 3


@pytest.fixture
def ring():
    made = PacketRing.__new__(PacketRing)
    memory = bytearray(BLOCK_BYTES * BLOCKS)
    made._block_bytes, made._blocks, made._next, made._unreleased = BLOCK_BYTES, BLOCKS, 0, 0
    made._memory, made._words = np.frombuffer(memory, np.uint8), memoryview(memory).cast("I")
    return made


def fill(ring, block, frames):
    """Write frames of (captured, wire bytes, s, ns, packet type, octets before the frame) and give the block to the user."""
    memory, start = memoryview(ring._words).cast("B"), block * BLOCK_BYTES
    at = start + 48
    struct.pack_into("IIIII", memory, start, 3, 0, 1, len(frames), 48)
    for captured, wire, seconds, ns, packet_type, before in frames:
        struct.pack_into("IIIIIIHH", memory, at, 160, seconds, ns, captured, wire, 0, before, before + 14)
        memory[at + 58] = packet_type
        at += 160


def rows(batch):
    columns = (batch.position, batch.captured_bytes, batch.wire_bytes, batch.wall_ns, batch.packet_type)
    return list(zip(*(column.tolist() for column in columns), strict=True))


def test_frames_are_read_in_their_order_from_all_blocks_that_are_ready(ring):
    fill(ring, 0, [(60, 1500, 1_790_000_000, 5, 4, 82), (54, 54, 1_790_000_000, 999_999_999, 0, 66)])
    fill(ring, 1, [(42, 142, 1_790_000_001, 0, 3, 82)])
    assert rows(ring.read()) == [
        (48 + 82, 60, 1500, 1_790_000_000_000_000_005, 4),
        (48 + 160 + 66, 54, 54, 1_790_000_000_999_999_999, 0),
        (1024 + 48 + 82, 42, 142, 1_790_000_001_000_000_000, 3),
    ]
    assert rows(ring.read()) == []  # not before they are given back


def test_released_blocks_are_the_kernels_and_the_next_ones_are_read(ring):
    status = [block * BLOCK_BYTES // 4 + 2 for block in range(BLOCKS)]
    for block in (0, 1, 2, 0, 1):
        fill(ring, block, [(50 + block, 60, 1, block, 0, 82)])
        assert [row[1] for row in rows(ring.read())] == [50 + block]
        assert [ring._words[at] for at in status].count(1) == 1
        ring.release()
        assert [ring._words[at] for at in status] == [0, 0, 0]


def test_a_full_ring_is_read_once(ring):
    for block in range(BLOCKS):
        fill(ring, block, [(50 + block, 60, 1, block, 0, 82)])
    assert [row[1] for row in rows(ring.read())] == [50, 51, 52]
    ring.release()
    fill(ring, 0, [(99, 99, 1, 1, 0, 82)])
    assert [row[1] for row in rows(ring.read())] == [99]
