"""One event as an MCAP Message record: 91 bytes of the same shape for every event, written and read as arrays.

offset  type      field
0       uint8     opcode of a Message, 5
1       uint64    length of what follows: 82
9       uint16    channel id
11      uint32    number of the message in its channel (MCAP's `sequence`)
15      uint64    log time
23      uint64    publish time
31      4 bytes   CDR encapsulation
35      56 bytes  the event (`EVENT_DTYPE`)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from mcap.opcode import Opcode

from .events import EVENT_CDR_BYTES, EVENT_DTYPE
from .framing import MESSAGE_HEADER, RECORD_HEADER
from .string_cdr import CDR_HEADER

if TYPE_CHECKING:
    from numpy.typing import NDArray

Records: TypeAlias = "NDArray[np.void]"
"""One-dimensional array of `EVENT_RECORD_DTYPE`, or of `EVENT_DTYPE` where that is said."""

_DATA_AT = RECORD_HEADER.size + MESSAGE_HEADER.size
EVENT_RECORD_BYTES = _DATA_AT + EVENT_CDR_BYTES
"""Length of one event in a chunk, 91 bytes."""

EVENT_RECORD_DTYPE = np.dtype(
    {
        "names": ["head", "length_top", "channel_id", "number", "times_ns", "cdr_header", "cdr", "event"],
        "formats": [
            "<u8",
            "u1",
            "<u2",
            "<u4",
            ("<u8", (2,)),
            f"V{len(CDR_HEADER)}",
            "<u2",
            f"V{EVENT_DTYPE.itemsize}",
        ],
        "offsets": [0, 8, 9, 11, 15, _DATA_AT, _DATA_AT, _DATA_AT + len(CDR_HEADER)],
        "itemsize": EVENT_RECORD_BYTES,
    },
)
"""The record's fields: `head` is the opcode and the seven low bytes of the length, which one comparison checks together;
`length_top` the length's last byte; `times_ns` log and publish time; `cdr` the first half of `cdr_header`."""

EVENT_HEAD = Opcode.MESSAGE | (MESSAGE_HEADER.size + EVENT_CDR_BYTES) << 8
"""`head` of every event; `length_top` is 0."""

EVENT_CDR = int.from_bytes(CDR_HEADER[:2], "little")
"""`cdr` of every event."""


def fill_constants(records: Records) -> None:
    """Write the fields that are the same for every event into an array of `EVENT_RECORD_DTYPE`."""
    records["head"] = EVENT_HEAD
    records["length_top"] = 0
    records["cdr_header"] = np.void(CDR_HEADER)
