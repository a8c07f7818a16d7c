"""Random traces against struct and loops: nothing about the order of events or files may matter."""

import random
import shutil
import tempfile
from pathlib import Path

import polars as pl
import pytest
from event_cdr import pack_event
from hypothesis import given, settings
from hypothesis import strategies as st
from plain_roundtrips import plain_roundtrips
from trace_files import event, ping_session, relay_session, run, write_trace

from dds_trace.analyzer.model.metrics import METRICS
from dds_trace.analyzer.pipeline import analyze
from dds_trace.analyzer.statistics.percentiles import PERCENTILES
from dds_trace.tracefile.format.events import Stage

MEASURED = [
    "scheduled_ns",
    "publish_ns",
    "receive_ns",
    "relay_in_ns",
    "relay_out_ns",
    "rtt_ns",
    "intermediate_ns",
    "latency_ns",
    "response_ns",
    "outcome",
    "duplicates",
    "reordered",
]
RELAYS = (0xA, 0xB)
RUNS = (1, 2)


@st.composite
def recordings(draw):
    """Events by file (`ping`, `relay A`, `relay B`) and stage; any may be missing, repeated or out of order."""
    chance = random.Random(draw(st.integers(0, 2**32)))
    keep, twice = draw(st.sampled_from([0.2, 0.7, 1.0])), draw(st.sampled_from([0.0, 0.3]))
    absurd = draw(st.booleans())
    files = {"ping": {stage: [] for stage in Stage}, **{relay: {stage: [] for stage in Stage} for relay in RELAYS}}
    for run_id in RUNS:
        for sequence in range(draw(st.integers(0, 12))):
            number = sequence + (2**63 if absurd and sequence > 8 else 0)
            t0 = 1000 * sequence + 1  # 0 throughout would be no schedule
            t1 = t0 + chance.randrange(200)
            if chance.random() < keep:
                files["ping"][Stage.T1].append(event(number, t1, run_id=run_id, scheduled_ns=t0))
            for relay in RELAYS:
                for stage, where, earliest in (
                    (Stage.T3, relay, 50),
                    (Stage.T4, relay, 150),
                    (Stage.T2, "ping", t1 + 100),
                ):
                    for _ in range(1 + (chance.random() < twice)):
                        if chance.random() < keep:
                            instant = earliest + chance.randrange(3000)
                            files[where][stage].append(event(number, instant, run_id=run_id, relay_id=relay))
    for stages in files.values():
        for events in stages.values():
            chance.shuffle(events)
    return files


WARMUP = {1: 0, 2: 2}


def write(folder, files, *, reverse=False, copies=False, names=("ping", "relay")):
    shutil.rmtree(folder, ignore_errors=True)
    for position, (where, stages) in enumerate(files.items()):
        ping = where == "ping"
        path = write_trace(
            folder / f"{position if not reverse else 9 - position}{names[not ping]}.mcap",
            ping_session() if ping else relay_session(session_id=where, relay_id=where, monotonic_anchor_ns=10**6),
            [run(run_id=run_id, warmup_messages=WARMUP[run_id]) for run_id in RUNS] if ping else (),
            {stage: list(reversed(events)) if reverse else events for stage, events in stages.items()},
        )
        if copies:
            shutil.copy(path, folder / f"{position}copy.mcap")


def expected_rows(files):
    packed = {stage.value: [pack_event(*e)[4:] for stages in files.values() for e in stages[stage]] for stage in Stage}
    return {
        (run_id, *key): row for run_id in RUNS for key, row in plain_roundtrips(run_id, WARMUP[run_id], packed).items()
    }


def found_rows(analysis):
    return {
        (r["run_id"], r["relay_id"], r["sequence"]): tuple(r[name] for name in MEASURED)
        for r in analysis.load_roundtrips().to_dicts()
    }


CHANGES = st.sampled_from([{"reverse": True}, {"copies": True}, {"reverse": True, "copies": True}])


@settings(max_examples=40)
@given(recordings(), CHANGES)
def test_rows_are_those_of_the_loops_in_any_order_and_any_number_of_copies(files, changed):
    expected = expected_rows(files)
    published = {run_id for run_id in RUNS if any(e[0] == run_id for e in files["ping"][Stage.T1])}
    if not published:
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "runs"
        write(folder, files)
        analysis = analyze(folder)
        found = found_rows(analysis)
        assert found == {key: tuple(getattr(row, n) for n in MEASURED) for key, row in expected.items()}
        assert len(found) == analysis.load_roundtrips().height
        write(folder, files, **changed)
        again = analyze(folder)
        assert again.load_roundtrips().equals(analysis.load_roundtrips())
        assert again.summary.equals(analysis.summary)
        assert again.timeline.equals(analysis.timeline)
        assert again.distributions.equals(analysis.distributions)


@settings(max_examples=25)
@given(recordings())
def test_the_summary_is_that_of_its_rows(files):
    if not files["ping"][Stage.T1]:
        return
    with tempfile.TemporaryDirectory() as name:
        write(Path(name), files)
        analysis = analyze(name)
    keys = ["relay_device", "relay_vendor", "relay_domain_id", "setting"]  # nothing else differs in these recordings
    for group in analysis.summary.to_dicts():
        rows = (
            analysis.load_roundtrips().filter(*(pl.col(key).eq_missing(pl.lit(group[key])) for key in keys)).to_dicts()
        )
        assert group["published"] == len(rows)
        assert group["received"] == sum(row["outcome"] == "completed" for row in rows)
        for outcome in ("lost_outbound", "lost_in_relay", "lost_return", "lost_unknown"):
            assert group[outcome] == sum(row["outcome"] == outcome for row in rows)
        assert group["duplicates"] == sum(row["duplicates"] for row in rows)
        assert group["reordered"] == sum(row["reordered"] for row in rows)
        for metric in METRICS:
            values = sorted(row[f"{metric}_ns"] for row in rows if row[f"{metric}_ns"] is not None)
            assert group[f"{metric}_min_ns"] == (values[0] if values else None)
            assert group[f"{metric}_max_ns"] == (values[-1] if values else None)
            assert group[f"{metric}_mean_ns"] == (pytest.approx(sum(values) / len(values)) if values else None)
            for percentile in PERCENTILES:
                value = group[f"{metric}_{percentile.name}_ns"]
                assert (value is None) == (len(values) < percentile.needs)
                if value is not None:
                    position = percentile.quantile * (len(values) - 1)
                    low = int(position)
                    high = min(low + 1, len(values) - 1)
                    assert value == pytest.approx(values[low] + (values[high] - values[low]) * (position - low))
