import polars as pl
import pytest
from processes import ping, relay
from rewritten_traces import rewrite_sessions
from roundtrip_frames import with_one_way

from dds_trace.analyzer.groups.breakdown import STAGES
from dds_trace.analyzer.pipeline import analyze

pytestmark = pytest.mark.middleware

LOCAL = ("--discovery", "localhost")


def record(folder, domain_id, *, relay_device):
    folder.mkdir()
    with relay(domain_id, folder / "relay.mcap", *LOCAL, "--device", relay_device) as process:
        more = ("--rate", 50, "--messages", 200, "--size", "1KB", "--label", "why=clock test")
        device = ("--device", "this-machine")
        assert ping(domain_id, folder / "ping.mcap", *LOCAL, *device, *more).status == 0
        assert process.stop().status == 0
    return analyze(folder)


def test_one_way_times_of_a_real_exchange_hold_within_their_bound(tmp_path, domain_id):
    analysis = record(tmp_path / "one", domain_id, relay_device="this-machine")
    assert analysis.details.clock_fits["same_clock"].to_list() == [True]
    assert_parts_add_up(analysis)

    # Two names: the boot id tells that it is one machine; without it the fit has to find out by itself.
    named = record(tmp_path / "two", domain_id, relay_device="another")
    assert named.details.clock_fits["same_clock"].to_list() == [True]
    rewrite_sessions(tmp_path / "two", tmp_path / "untold", {"boot_id": None})
    details = analyze(tmp_path / "untold").details
    assert details.clock_fits["same_clock"].to_list() == [False]
    assert details.clock_fits["step_before_ns"].to_list() == [None]
    assert (details.clock_knots["offset_ns"].abs() <= details.clock_knots["bound_ns"]).all()

    # Real jitter, and a relay's clock that was put off by a known amount.
    frame = analysis.load_roundtrips()
    true_ns = frame["relay_in_ns"] - frame["publish_ns"]
    for offset_ns, drift_ppb, step_ns in ((10**15, 40_000, 0), (-(10**12), -40_000, 10**9)):
        aligned = with_one_way(put_off(frame, offset_ns, drift_ppb, step_ns))
        error_ns = (aligned["outbound_ns"] - true_ns).abs()
        assert error_ns.count() > 150
        assert (error_ns <= aligned["clock_bound_ns"] + 1).drop_nulls().all()


def put_off(frame, offset_ns, drift_ppb, step_ns):
    """The frame as if the relay's clock had an offset and a drift, and a step halfway."""
    start_ns, end_ns = frame["publish_ns"].min(), frame["publish_ns"].max()
    later = pl.when(pl.col("publish_ns") > start_ns + (end_ns - start_ns) // 2).then(step_ns).otherwise(0)
    shifted = [
        (pl.col(stamp) + offset_ns + (pl.col(stamp) - start_ns) * drift_ppb // 10**9 + later).alias(stamp)
        for stamp in ("relay_in_ns", "relay_out_ns")
    ]
    return frame.with_columns(shifted).with_columns(relay_device=pl.lit("another"))


def assert_parts_add_up(analysis):
    parts = analysis.details.breakdown.sort("order")
    if len(parts) != len(STAGES):
        return  # this client library gives no reception stamps
    assert parts["part"].to_list() == list(STAGES)
    complete = analysis.load_roundtrips().filter(outcome="completed")
    assert parts["messages"].unique().to_list() == [len(complete)]
    assert parts["mean_ns"].sum() == pytest.approx(complete["response_ns"].mean(), rel=1e-9)
    assert (parts["mean_ns"][1:] >= 0).all()
    assert parts["bound_ns"].null_count() == 0
