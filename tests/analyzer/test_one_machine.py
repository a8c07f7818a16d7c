"""Clocks and breakdown on a real exchange over ROS 2 on this machine, where the truth about the clock is known: zero."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest
from processes import ping, relay

from dds_trace.analyzer import analyze
from dds_trace.analyzer.clocks.alignment import align_clocks, ping_boots
from dds_trace.analyzer.groups.breakdown import (
    STAGES,
    break_down,
    ping_wall_offsets,
    relay_wall_offsets,
    with_stamps,
)
from dds_trace.tracefile import EventColumns, Stage, find_traces, read_trace

pytestmark = pytest.mark.middleware

LOCAL = ("--discovery", "localhost", "--device", "this-machine")


def record(folder, domain_id):
    """200 messages at 50 Hz to a relay and back: the analysis, and the frame with the middleware's stamps."""
    with relay(domain_id, folder / "relay.mcap", *LOCAL) as process:
        more = ("--rate", 50, "--messages", 200, "--size", "1KB", "--label", "why=clock test")
        assert ping(domain_id, folder / "ping.mcap", *LOCAL, *more).status == 0
        assert process.stop().status == 0
    analysis = analyze(folder)
    traces = [read_trace(path) for path in find_traces(folder)]
    events = {s: EventColumns.concatenate(t.events[s] for t in traces) for s in (Stage.T2, Stage.T3)}
    return analysis, with_stamps(analysis.roundtrips, events)


def test_clocks_on_a_real_exchange(tmp_path, domain_id):
    analysis, frame = record(tmp_path, domain_id)
    boots = ping_boots(analysis.sessions, analysis.runs)
    (known,) = align_clocks(frame, boots).fits
    assert known.same_clock
    (fit,) = align_clocks(frame.with_columns(relay_device=pl.lit("another")), boots).fits
    assert not fit.same_clock  # two names: the fit has to find out by itself
    assert fit.steps == ()
    for knot in fit.segments[0].knots:
        assert abs(knot.offset_ns) <= knot.bound_ns

    # Real jitter, and a relay's clock that was put off by a known amount.
    true_ns = frame["relay_in_ns"] - frame["publish_ns"]
    for offset_ns, drift_ppb, step_ns in ((10**15, 40_000, 0), (-(10**12), -40_000, 10**9)):
        aligned = align_clocks(put_off(frame, offset_ns, drift_ppb, step_ns))
        error_ns = (aligned.roundtrips["outbound_ns"] - true_ns).abs()
        assert error_ns.count() > 150
        assert (error_ns <= aligned.roundtrips["clock_bound_ns"] + 1).drop_nulls().all()
        assert len(aligned.fits[0].steps) == (1 if step_ns else 0)

    assert_parts_add_up(analysis, frame)


def put_off(frame, offset_ns, drift_ppb, step_ns):
    """The frame as if the relay's clock had an offset and a drift, and a step halfway."""
    start_ns, end_ns = frame["publish_ns"].min(), frame["publish_ns"].max()
    later = pl.when(pl.col("publish_ns") > start_ns + (end_ns - start_ns) // 2).then(step_ns).otherwise(0)
    shifted = [
        (pl.col(stamp) + offset_ns + (pl.col(stamp) - start_ns) * drift_ppb // 10**9 + later).alias(stamp)
        for stamp in ("relay_in_ns", "relay_out_ns")
    ]
    return frame.with_columns(shifted).with_columns(relay_device=pl.lit("another"))


def assert_parts_add_up(analysis, frame):
    parts = break_down(
        align_clocks(frame).roundtrips,
        ping_wall_offsets(analysis.sessions, analysis.runs),
        relay_wall_offsets(analysis.sessions),
    ).filter(pl.col("outcome") == "completed")
    if parts["relay_received_ns"].null_count() == len(parts):
        return  # this client library gives no reception stamps
    values = parts.select(STAGES).to_numpy()
    assert np.isfinite(values).all()
    assert np.array_equal(values.sum(axis=1), parts["response_ns"].to_numpy())
    assert (values[:, 1:] >= 0).all()
    assert parts["delivery_bound_ns"].null_count() == 0
