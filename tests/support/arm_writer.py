"""Writes `events.mcap` and `events.mcap.ring` of the same events on every machine: arm_writer.py FOLDER."""

import sys
from pathlib import Path

import numpy as np

from dds_trace.tracefile.format.descriptions import Session
from dds_trace.tracefile.format.events import SESSION_TOPIC
from dds_trace.tracefile.format.ring import SLOT_DTYPE, Ring, ring_path
from dds_trace.tracefile.writing.writer import TraceWriter

EVENTS = 20_000

session = Session(
    session_id=1,
    role="ping",
    device="one",
    backend="socket",
    vendor="socket",
    rmw=None,
    domain_id=10,
    relay_id=None,
    connectivity="loopback",
    wall_anchor_ns=1_700_000_000_000_000_000,
    monotonic_anchor_ns=5_000_000_000,
    host={},
    extra={},
)
numbers = np.arange(EVENTS * SLOT_DTYPE.itemsize, dtype=np.uint64) * np.uint64(2_654_435_761)
slots = (numbers >> np.uint64(7)).astype(np.uint8).view(SLOT_DTYPE)
slots["monotonic_ns"] = 5_000_000_000 + np.arange(EVENTS) * 12_345
slots["stage"] = 1 + np.arange(EVENTS) % 4

path = Path(sys.argv[1]) / "events.mcap"
with TraceWriter(path, session) as writer:
    writer.write_text(SESSION_TOPIC, session.to_json(), session.wall_anchor_ns)
    writer.write_events(slots)
    writer.finish()
ring = Ring(ring_path(path), EVENTS, session)
ring.slots[:] = slots
ring.close(delete=False)
