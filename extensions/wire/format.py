"""What a message cost on the wire: a record per message and direction, and the texts that carry records and counts.

The layout is `docs/trace-format.md`; other programs depend on every name here.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Iterator
from enum import IntEnum
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from dds_trace.tracefile.format.json_fields import JsonObject

MessageRows: TypeAlias = NDArray[np.void]
"""One-dimensional array of `MESSAGE_ROW`."""

NEVER_NS = -1
"""`resent_after_ns` of a message that was sent once."""

DISCOVERY_CLASSES = frozenset({"spdp", "sedp", "liveliness"})
AGAIN_CLASSES = frozenset({"data_again", "data_frag_again", "tcp_data_again"})
"""Classes of traffic that are discovery, and repeats."""

MESSAGE_ROW = np.dtype(
    [
        ("run_id", "<u8"),
        ("sequence", "<u8"),
        ("relay_id", "<u4"),
        ("direction", "u1"),
        ("fragments", "<u4"),
        ("fragments_again", "<u4"),
        ("repeats", "<u2"),
        ("sample_bytes", "<u4"),
        ("first_ns", "<i8"),
        ("last_ns", "<i8"),
        ("resent_after_ns", "<i8"),
        ("waited_heartbeats", "<u2"),
    ]
)
"""A message of ours on the wire, in one direction: 61 bytes, no padding (docs/reference/wire.md)."""

_ROWS_OF_A_TEXT = 8192
"""Most records of one text: 0.7 MB, a sixth of the longest text that a reader accepts."""


class Direction(IntEnum):
    """Direction of a frame; on the loopback interface every frame is both sent and received."""

    SENT = 0
    RECEIVED = 1
    LOCAL = 2


def row_texts(rows: MessageRows) -> Iterator[JsonObject]:
    """Yield the JSON objects that carry `rows`, sorted by run: some thousand of one run each."""
    for run_id in np.unique(rows["run_id"]).tolist():
        run_rows = rows[rows["run_id"] == run_id]
        for first in range(0, len(run_rows), _ROWS_OF_A_TEXT):
            block = run_rows[first : first + _ROWS_OF_A_TEXT]
            packed = base64.b64encode(block.tobytes()).decode()
            yield {"run_id": f"{run_id:016x}", "messages": len(block), "rows": packed}


def rows_of_text(text: JsonObject) -> MessageRows:
    """Return the records in a JSON object of `WIRE_TOPIC`; none of one with only counts, or of a damaged one."""
    packed = text.get("rows")
    if isinstance(packed, str):
        try:
            return np.frombuffer(base64.b64decode(packed, validate=True), MESSAGE_ROW)
        except (binascii.Error, ValueError):  # not base64, or no whole number of records
            pass
    return np.empty(0, MESSAGE_ROW)
