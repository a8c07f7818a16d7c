"""The 91 bytes of an event, drawn by hand against the MCAP specification."""

from __future__ import annotations

import struct

import numpy as np
from event_cdr import pack_event
from mcap.data_stream import RecordBuilder
from mcap.records import Message

from dds_trace.tracefile.format.events import EVENT_RECORD_BYTES, EVENT_RECORD_DTYPE, fill_constants


def test_an_event_is_the_message_that_mcap_writes():
    event = pack_event(1, 2, 3, 4, 5, 6, 7, 8)
    (record,) = records = np.zeros(1, EVENT_RECORD_DTYPE)
    fill_constants(records)
    record["channel_id"], record["number"], record["times_ns"] = 9, 10, (11, 12)
    record["event"] = np.void(event[4:])
    builder = RecordBuilder()
    Message(channel_id=9, sequence=10, log_time=11, publish_time=12, data=event).write(builder)
    assert records.tobytes() == builder.end()
    assert len(records.tobytes()) == EVENT_RECORD_BYTES == 91
    assert struct.unpack_from("<BQ", records.tobytes()) == (5, 82)
