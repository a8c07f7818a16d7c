import os
from contextlib import ExitStack

import numpy as np
import pytest
from processes import relay, running

from dds_trace.extensions.wire.format import rows_of_text
from dds_trace.tracefile.format.events import Stage, TapColumns
from dds_trace.tracefile.reading.reader import read_trace

pytest.importorskip("rclpy", reason="no ROS 2 here")
pytestmark = [
    pytest.mark.middleware,
    pytest.mark.slow,
    pytest.mark.skipif(os.geteuid() != 0, reason="a capture needs CAP_NET_RAW"),
]
MESSAGES = 150
ENOUGH = 20
"""The ping's topic is joined during its run, and a best-effort tap may lose messages on a busy machine."""
SAME_INSTANT_NS = 50_000
"""A packet's stamp is of CLOCK_REALTIME, turned into CLOCK_MONOTONIC."""


@pytest.fixture
def traces(tmp_path, domain_id):
    """A ping with its capture, and two taps on its topic, all over UDP; the second one misses its limits."""
    both = ("--transport", "udp", "--no-own-cost")
    (tmp_path / "limits.toml").write_text('[thresholds."/binary_*"]\nrate = "> 1000 Hz"\n')
    limits = ((), ("--limits", tmp_path / "limits.toml"))
    with ExitStack() as stack:
        echo = stack.enter_context(relay(domain_id, tmp_path / "relay.mcap", *both))
        words = ("--role", "tap", "--topics", "/binary_*", "--domain", domain_id, *both)
        taps = [
            stack.enter_context(running("dds-record", *words, *judged, "--out", tmp_path / f"tap{number}.mcap"))
            for number, judged in enumerate(limits)
        ]
        for tap in taps:
            tap.wait_for_line("joined /binary_image_relay")
        ping = stack.enter_context(
            running(
                *("dds-record", "--role", "ping", "--domain", domain_id, "--out", tmp_path / "ping.mcap", "--wire"),
                *(*both, "--messages", MESSAGES, "--warmup", 10, "--rate", 50, "--size", "5KB"),
            )
        )
        done = ping.finish()
        assert done.status == 0, done.stderr
        assert [one.stop().status for one in (*taps, echo)] == [0, 20, 0]
    names = ("ping", "relay", "tap0", "tap1")
    return {name: read_trace(tmp_path / f"{name}.mcap") for name in names}


def of_topic(trace, topic):
    described = next(text for text in trace.publishers if text["topic"] == topic)
    events = trace.events[Stage.TAP]
    return TapColumns.from_events(events.take(events.relay_id == described["publisher_id"])), described


def test_every_message_is_published_then_on_the_wire_then_received(traces):
    (session,) = traces["ping"].sessions
    t1 = traces["ping"].events[Stage.T1]
    rows = np.concatenate([rows_of_text(text) for text in traces["ping"].wire])
    rows = rows[rows["relay_id"] == 0]
    packet_of = dict(zip(rows["sequence"].tolist(), rows["first_ns"].tolist(), strict=True))
    published_of = dict(zip(t1.sequence.tolist(), t1.monotonic_ns.tolist(), strict=True))
    sequence_of = {session.wall_ns(publish_ns): sequence for sequence, publish_ns in published_of.items()}
    walls = np.array(sorted(sequence_of))
    seen = []
    for name in ("tap0", "tap1"):
        taps, described = of_topic(traces[name], "/binary_image")
        assert described["has_header"]
        checked = {}
        for header_ns, arrival_ns in zip(taps.header_ns.tolist(), taps.monotonic_ns.tolist(), strict=True):
            nearest = int(walls[np.abs(walls - header_ns).argmin()])
            if abs(nearest - header_ns) > 1_000_000:  # a probe before the run
                continue
            sequence = sequence_of[nearest]
            published_ns, packet_ns = published_of[sequence], packet_of[sequence]
            assert published_ns <= packet_ns + SAME_INSTANT_NS
            assert packet_ns <= arrival_ns + SAME_INSTANT_NS
            checked[sequence] = arrival_ns
        assert len(checked) >= ENOUGH
        seen.append(checked)
    assert len(seen[0].keys() & seen[1].keys()) >= ENOUGH


def test_two_taps_agree_about_publisher_number_time_and_content(traces):
    keys = []
    for name in ("tap0", "tap1"):
        taps, described = of_topic(traces[name], "/binary_image")
        columns = (taps.publication_sequence, taps.source_ns, taps.content_hash)
        keys.append({(described["publisher"], *row) for row in zip(*(one.tolist() for one in columns), strict=True)})
    common = keys[0] & keys[1]
    assert len(common) >= ENOUGH
    by_number = [{key[1]: key for key in one} for one in keys]
    assert all(by_number[0][number] == by_number[1][number] for number in by_number[0].keys() & by_number[1].keys())
