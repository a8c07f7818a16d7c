"""The timeline of devices that were recorded in several boots: what is drawn is held against the true times."""

from collections import defaultdict
from dataclasses import replace

import numpy as np
import polars as pl
import pytest
import trace_files
from tap_traces import FAR_NS, LAPTOP, ROBOT, Hearing, arrivals, camera, write_beacon, write_tap

from dds_trace.analyzer.pipeline import analyze
from dds_trace.extensions.exports.perfetto import timeline_slices, write_perfetto

MS, SECOND, DAY = 10**6, 10**9, 86_400 * 10**9


class Booted:
    """A device in one boot: its monotonic clock is 0 at `booted_ns` of the true time, its wall clock off by `wall_off_ns`."""

    def __init__(self, device, booted_ns, wall_off_ns, number, has_id):
        self.device, self.booted_ns = device, booted_ns
        self.wall_ns = trace_files.WALL_ANCHOR_NS + wall_off_ns
        self.extra = {"boot_id": f"{number:08x}-0000-4000-8000-000000000000"} if has_id else {}

    def session(self, make, true_ns, session_id, **changes):
        anchors = {"wall_anchor_ns": self.wall_ns + true_ns, "monotonic_anchor_ns": true_ns - self.booted_ns}
        return make(
            session_id=session_id, device=self.device, extra=self.extra, connectivity="wired", **anchors, **changes
        )


def record(folder, number, ping, relays, start_ns, draw):
    """Record a run of 20 messages at 10 Hz and return (run, relay, sequence) -> true times of its four stamps."""
    run_id = int(draw.integers(2**62, 2**64, dtype=np.uint64))
    session_id = 1000 + 100 * number
    described = trace_files.run(
        run_id=run_id, planned_messages=20, published=20, extra={"session_id": f"{session_id:016x}"}
    )
    truth, parts = {}, []
    for index, relay in enumerate(relays):
        relay_id = int(draw.integers(1, 2**32))
        messages = []
        for sequence in range(20):
            sent_ns = start_ns + (sequence + 1) * 100 * MS
            out_ns, back_ns = (int(ns) for ns in draw.integers(200_000, 300_000, 2))
            times = np.cumsum([sent_ns, out_ns, 20_000, back_ns]).tolist()
            truth[run_id, relay_id, sequence] = times
            t1, t2 = (times[at] - ping.booted_ns for at in (0, 3))
            t3, t4 = (times[at] - relay.booted_ns for at in (1, 2))
            messages.append(trace_files.Message(sequence, t0=t1, t1=t1, t3=t3, t4=t4, t2=t2))
        fields = {"run_id": run_id, "relay_id": relay_id}
        sent = trace_files.ping_events(messages, **fields)
        parts.append(sent if not index else {stage: events for stage, events in sent.items() if stage.name == "T2"})
        there = relay.session(trace_files.relay_session, start_ns, session_id + 1 + index, relay_id=relay_id)
        trace_files.write_trace(
            folder / f"{number}.relay{index}.mcap", there, (), trace_files.relay_events(messages, **fields)
        )
    here = ping.session(trace_files.ping_session, start_ns, session_id)
    trace_files.write_trace(folder / f"{number}.ping.mcap", here, [described], trace_files.merged_events(parts))
    return truth


@pytest.mark.parametrize(("seed", "has_ids"), [(1, True), (2, True), (3, False), (4, True)])
def test_every_slice_of_every_boot_is_at_its_true_time(tmp_path, seed, has_ids):
    draw = np.random.default_rng(seed)
    truth, number = {}, 0
    for boot in range(3):
        start_ns = boot * int(draw.integers(DAY, 5 * DAY))
        uptime = [int(draw.integers(SECOND, 3 * DAY)) for _ in range(3)]
        alpha = Booted("alpha", start_ns - uptime[0], 0, 3 * boot, has_ids)
        beta = Booted("beta", start_ns - uptime[1], -3 * SECOND, 3 * boot + 1, has_ids)
        gamma = Booted("gamma", start_ns - uptime[2], 7 * SECOND, 3 * boot + 2, has_ids)
        relays = [(beta, gamma)[index % 2] for index in range(int(draw.integers(2, 11)))]
        for ping, others in ((alpha, relays), (beta, [alpha]), (gamma, [beta])):
            truth |= record(tmp_path, number, ping, others, start_ns + number * 10 * SECOND, draw)
            number += 1
    analysis = analyze(tmp_path)
    by_row, flows = defaultdict(list), defaultdict(set)
    for part in timeline_slices(analysis):
        run_id, relay_id, sequence = part.row.split()
        row = int(run_id, 16), int(relay_id, 16), int(sequence)
        by_row[row].append(part)
        flows[part.message].add(row)
    assert by_row.keys() == truth.keys()
    assert all(len(rows) == 1 for rows in flows.values())
    for row, (sending, reception) in by_row.items():
        assert sending.message == reception.message
        drawn = [sending.begin_ns, reception.begin_ns, reception.end_ns, sending.end_ns]
        assert np.abs(np.array(drawn) - trace_files.WALL_ANCHOR_NS - truth[row]).max() < 1 * MS
    rows = analysis.load_roundtrips().filter(ping_device="alpha")
    for run_id, relay_id, sequence, utc_ns in rows.select(
        "run_id", "relay_id", "sequence", pl.col("publish_utc").to_physical()
    ).iter_rows():
        assert by_row[run_id, relay_id, sequence][0].begin_ns == utc_ns


def test_an_arrow_of_the_file_joins_one_sending_and_its_reception(tmp_path):
    trace_pb2 = pytest.importorskip("perfetto.protos.perfetto.trace.perfetto_trace_pb2")
    draw = np.random.default_rng(5)
    alpha, *others = (Booted(name, -DAY, 0, 9, has_id=True) for name in ("alpha", *("beta" for _ in range(10))))
    truth = record(tmp_path, 0, alpha, others, 0, draw)
    truth |= record(tmp_path, 1, alpha, others[:1], 10 * SECOND, draw)
    write_perfetto(analyze(tmp_path), tmp_path / "timeline.pftrace")
    ends = defaultdict(list)
    for packet in trace_pb2.Trace.FromString((tmp_path / "timeline.pftrace").read_bytes()).packet:
        for flow in packet.track_event.flow_ids if packet.HasField("track_event") else ():
            (annotation,) = packet.track_event.debug_annotations
            ends[flow].append((annotation.name, annotation.string_value))
    assert len(ends) == len(truth) == 220
    assert {len(slices) for slices in ends.values()} == {2}
    assert {slices[0] for slices in ends.values()} == {
        ("row", f"{run_id:016x} {relay_id:08x} {sequence}") for run_id, relay_id, sequence in truth
    }


def test_a_topic_of_every_boot_is_at_its_true_time(tmp_path):
    """Two publishers number their messages alike; in the second boot all clocks but the wall clocks begin again."""
    sent_ns = {}
    for boot in range(2):
        later = {"boot_id": f"{boot + 3:08x}", "since_boot_ns": (90 + 7 * boot) * SECOND}
        robot = replace(ROBOT, **later, wall_off_ns=boot * 3 * DAY)
        laptop = replace(LAPTOP, **{**later, "boot_id": f"{boot + 5:08x}"}, wall_off_ns=boot * 3 * DAY - 2 * SECOND)
        folder = tmp_path / str(boot)
        published = [
            replace(camera(seconds=5), topic=f"/boot_{boot}/{side}", clock=robot, guid=f"{boot}{number}" * 16)
            for number, side in enumerate(("left", "right"))
        ]
        published = [replace(one, headers=robot.wall(one.sent_ns - 5 * MS)) for one in published]
        for number, (clock, way_ns) in enumerate(((robot, 60_000), (laptop, FAR_NS)), 1):
            heard = [Hearing(one, arrivals(one, way_ns, seed=number)) for one in published]
            write_tap(folder / f"{number}.mcap", clock, heard, session_id=2 * boot + number)
        write_beacon(folder, laptop, robot, seconds=8, number=boot)
        sent_ns |= {one.topic: laptop.wall(one.sent_ns) for one in published}
    flows, count = defaultdict(list), 0
    for part in timeline_slices(analyze(tmp_path)):
        flows[part.message].append(part)
        if part.name.endswith(" one way"):
            topic, sequence, *_ = part.name.split()
            assert abs(part.begin_ns - sent_ns[topic][int(sequence) - 1]) < 1 * MS
            count += 1
        elif part.name.endswith(" stamp"):
            assert 4 * MS < part.end_ns - part.begin_ns < 6 * MS
    assert count == 2 * 2 * 2 * 150
    assert {len(slices) for slices in flows.values()} == {2}
