"""Latencies of the messages of a case, lost ones included."""

from __future__ import annotations

import math

import polars as pl
from roundtrip_frames import MS, steady

from dds_trace.analyzer.verdicts.cases import delivered_latencies


def test_lost_messages_are_infinitely_late_and_replies_without_stamps_take_half_their_round_trip():
    frame = pl.concat(
        [steady([5 * MS, None]), steady([7 * MS]).with_columns(latency_ns=pl.lit(None, pl.Int64))]
    )
    assert frame["rtt_ns"][2] == 14 * MS + 1000
    assert delivered_latencies(frame).tolist() == [5 * MS, math.inf, 7 * MS + 500]
