import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from trace_files import RELAY_ID, Message, event, ping_events, ping_session, run, write_trace

from dds_trace.analyzer.groups.timeline import _rows_to_draw
from dds_trace.analyzer.pairing.pair import LOSSES, OUTCOMES
from dds_trace.analyzer.pairing.roundtrips import RoundTrips
from dds_trace.analyzer.pipeline import analyze
from dds_trace.tracefile.format.events import Stage

MS = 1_000_000


def test_a_short_run_is_drawn_whole(tmp_path):
    messages = [Message(s, t0=(s + 7) * MS, t1=(s + 7) * MS, t2=(s + 7) * MS + 100 + s) for s in range(50)]
    write_trace(tmp_path / "ping.mcap", ping_session(), [run(warmup_messages=10)], ping_events(messages))
    analysis = analyze(tmp_path)
    assert not analysis.timeline_decimated
    assert analysis.timeline["sequence"].to_list() == list(range(10, 50))
    assert analysis.timeline["elapsed_s"].to_list() == pytest.approx([s / 1000 for s in range(40)])
    assert analysis.timeline["rtt_ns"].to_list() == [100 + s for s in range(10, 50)]


def worth_drawing(exchanges, share):
    """The rule of `timeline_frame` in loops: rows of exchanges, each row its latency, or the outcome of a lost message."""
    kept, row = set(), 0
    for rows in exchanges:
        stretches = len(rows) if len(rows) <= share else share // 4
        of_stretch = {}
        for position, latency in enumerate(rows):
            of_stretch.setdefault(position * stretches // len(rows), []).append((latency, row + position))
        for drawn in of_stretch.values():
            times = [(latency, place) for latency, place in drawn if not isinstance(latency, str)]
            if times:
                kept |= {min(times)[1], min(times, key=lambda one: (-one[0], one[1]))[1]}
            kept |= {place for kind, place in drawn if kind in LOSSES and (kind, place) == first_of(drawn, kind)}
        kept |= {row} if rows else set()
        row += len(rows)
    return sorted(kept)


def first_of(drawn, kind):
    return next(one for one in drawn if one[0] == kind)


RUN = st.tuples(st.booleans(), st.lists(st.sampled_from([5, 6, 7, *LOSSES[:2]]), min_size=1, max_size=90))


@given(runs=st.lists(RUN, min_size=1, max_size=4), share=st.integers(8, 40))
def test_rows_rows_to_draw_are_those_of_the_rule(runs, share):
    """Runs whose relay is recorded are drawn by latency, and their round trips would choose others."""
    rows = [(recorded, one) for recorded, of_run in runs for one in of_run]
    lost = [one if isinstance(one, str) else "completed" for _, one in rows]
    times = pl.DataFrame(
        [
            (one if recorded else None, -one if recorded else one) if kind == "completed" else (None, None)
            for (recorded, one), kind in zip(rows, lost, strict=True)
        ],
        schema={"latency_ns": pl.Int64, "rtt_ns": pl.Int64},
        orient="row",
    )
    codes = [outcome.value for outcome in OUTCOMES]
    held = RoundTrips(
        measured=times,
        described=pl.DataFrame(),
        outcome=np.array([codes.index(outcome) for outcome in lost], np.uint8),
        bounds=np.cumsum([0, *(len(of_run) for _, of_run in runs)]),
        counts=pl.DataFrame(),
        stamps=(),
        clock_knots=pl.DataFrame(),
    )
    kept = _rows_to_draw(held, np.array([recorded for recorded, _ in runs]), share)
    assert kept.tolist() == worth_drawing([of_run for _, of_run in runs], share)


def test_a_long_run_keeps_extremes_and_losses(tmp_path):
    count, spike, dip, lost = 20_000, 7_777, 12_345, 15_001
    rtt = np.random.default_rng(3).integers(500, 600, count)
    rtt[spike], rtt[dip] = 5_000, 3
    t1 = [event(s, s * MS, scheduled_ns=s * MS) for s in range(count)]
    t2 = [event(s, s * MS + int(rtt[s]), relay_id=RELAY_ID) for s in range(count) if s != lost]
    write_trace(tmp_path / "ping.mcap", ping_session(), [run()], {Stage.T1: t1, Stage.T2: t2})
    analysis = analyze(tmp_path)
    timeline = analysis.timeline
    assert analysis.timeline_decimated
    assert timeline.height <= 4000
    assert timeline["sequence"].is_sorted()
    assert timeline["sequence"][0] == 0
    assert {spike, dip, lost} <= set(timeline["sequence"])
    assert timeline.filter(sequence=lost)["outcome"].to_list() == ["lost_unknown"]
    assert timeline["elapsed_s"].to_list() == pytest.approx([s / 1000 for s in timeline["sequence"]])
    # Every stretch of a thousandth of the run shows its own extremes.
    stretch = slice(4000, 4020)
    drawn = timeline.filter(timeline["sequence"].is_between(stretch.start, stretch.stop - 1))["rtt_ns"]
    assert (drawn.min(), drawn.max()) == (rtt[stretch].min(), rtt[stretch].max())


def test_losses_everywhere_are_drawn_once_a_stretch(tmp_path):
    t1 = [event(s, s * MS, scheduled_ns=s * MS) for s in range(9000)]
    write_trace(tmp_path / "ping.mcap", ping_session(), [run()], {Stage.T1: t1})
    timeline = analyze(tmp_path).timeline
    assert timeline.height == 1000
    assert set(timeline["outcome"]) == {"lost_unknown"}


def test_without_a_schedule_time_runs_from_the_first_publication(tmp_path):
    t1 = [event(s, (5 + s) * MS) for s in range(3)]
    write_trace(tmp_path / "ping.mcap", ping_session(), [run()], {Stage.T1: t1})
    analysis = analyze(tmp_path)
    assert analysis.timeline["elapsed_s"].to_list() == pytest.approx([0, 0.001, 0.002])
    assert analysis.load_roundtrips()["scheduled_ns"].null_count() == 3
    assert "no_schedule" in {finding.code for finding in analysis.findings}
