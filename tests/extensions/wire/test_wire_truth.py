"""The capture against a link whose forwarder keeps the list of all frames and of what it dropped; root only."""

import json
import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from lossy_link import SUPPORT, lossy_link, record_watched, running_session
from namespaces import needs_namespaces
from processes import executed
from record_reader import events_of
from waiting import read_past
from wire_truth import truth_of

from dds_trace.base.records import from_json
from dds_trace.extensions.wire.capture import WireOptions, domain_ports
from dds_trace.extensions.wire.classes import WireClass
from dds_trace.extensions.wire.counts import WireCounts
from dds_trace.extensions.wire.format import NEVER_NS, Direction
from dds_trace.extensions.wire.packet_filter import PortRange

pytestmark = [
    pytest.mark.middleware,
    pytest.mark.slow,
    needs_namespaces("tc", "iproute2"),
    pytest.mark.skipif(not Path("/dev/net/tun").exists(), reason="no TAP devices here"),
]

PORTS = (domain_ports(30),)
OPTIONS = WireOptions(("link0",), rtps_ports=PORTS, udp_ports=PORTS, tcp_ports=PORTS)
SLACK_NS = 100_000
"""Two stamps of neighbouring instants, one of them turned from CLOCK_REALTIME into CLOCK_MONOTONIC."""


def within(share, value):
    return pytest.approx(value, rel=share, abs=0)


def sent(counts, *kinds):
    return [one for one in counts.classes if one.direction == "sent" and (not kinds or one.name in kinds)]


def fragments_again(counts):
    return sum(one.fragments for one in sent(counts, "data_again", "data_frag_again"))


@pytest.fixture(scope="module", params=["cyclonedds", "ros2"])
def watched(request, tmp_path_factory):
    """A reliable recording of 100 messages over a link that drops one frame of fifty."""
    pytest.importorskip({"cyclonedds": "cyclonedds", "ros2": "rclpy"}[request.param])
    folder = tmp_path_factory.mktemp(request.param)
    size = {"cyclonedds": "33KB", "ros2": "10KB"}[request.param]
    more = ("--size", size, "--messages", 90, "--warmup", 10, "--rate", 40, "--wait", 60)
    return folder, record_watched(folder, OPTIONS, request.param, *more, loss=0.02)


def test_what_was_sent_again_is_what_the_link_saw_again(watched):
    _, found = watched
    for counts, truth in zip(found.counts, found.truth, strict=True):
        assert counts.complete
        assert counts.unseen_headers == 0
        # What a peer says before anything of it was known to be of this domain.
        assert counts.foreign_packets <= 0.01 * counts.packets
        assert truth.made_good > 5
        assert fragments_again(counts) == within(0.01, truth.again)
        # The list of what was dropped: each entry that was made good is one repetition that was needed.
        assert fragments_again(counts) - truth.needless == within(0.01, truth.made_good)


def test_first_sendings_are_those_the_link_saw(watched):
    _, found = watched
    for counts, truth in zip(found.counts, found.truth, strict=True):
        first = sum(one.fragments for one in sent(counts, "data", "data_frag"))
        assert first == sum(map(len, truth.sent.values())) - truth.again


@pytest.mark.parametrize(("name", "kind"), [("heartbeat_frag", 0x13), ("nack_frag", 0x12), ("gap", 0x08)])
def test_kinds_that_discovery_does_not_use_are_those_the_link_saw(watched, name, kind):
    _, found = watched
    for counts, truth in zip(found.counts, found.truth, strict=True):
        seen = sum(one.submessages for one in sent(counts, name))
        assert seen <= truth.submessages[kind]
        if name != "gap":  # discovery uses it, too
            assert seen == truth.submessages[kind]


def test_the_classes_bytes_sum_to_the_links_and_to_the_interfaces(watched):
    _, found = watched
    for counts, truth in zip(found.counts, found.truth, strict=True):
        size = sum(one.bytes for one in sent(counts))
        (interface,) = counts.interface_counts
        assert size == within(0.01, truth.bytes)
        assert size == within(0.01, interface.sent_bytes)
        received = sum(one.bytes for one in counts.classes if one.direction == "received")
        assert received == within(0.01, interface.received_bytes)


def test_each_message_has_a_row_that_fits_its_stamps(watched):
    folder, found = watched
    counts, rows = found.counts[0], found.rows[0]
    out = {one["sequence"]: one["monotonic_ns"] for one in events_of(folder / "ping.mcap", "t1")}
    arrived = {one["sequence"]: one["monotonic_ns"] for one in events_of(folder / "relay.mcap", "t3")}
    mine = rows[rows["direction"] == Direction.SENT]
    assert mine["sequence"].tolist() == sorted(out)
    for row in mine:
        assert out[row["sequence"]] <= row["first_ns"] + SLACK_NS
        assert row["first_ns"] <= arrived.get(row["sequence"], row["first_ns"]) + SLACK_NS
        assert (row["resent_after_ns"] > 0) == (row["repeats"] > 0)
        assert row["resent_after_ns"] <= row["last_ns"] - row["first_ns"]
    never = mine["resent_after_ns"] == NEVER_NS
    assert sum(never) == sum(mine["fragments_again"] == 0)
    assert 0 < mine["fragments_again"].sum() <= fragments_again(counts)
    assert [one.messages for one in counts.repeats if one.repeats == 0] == [sum(never)]


def test_a_row_says_how_often_its_message_was_on_the_link(watched):
    _, found = watched
    for rows, truth in zip(found.rows, found.truth, strict=True):
        mine = rows[rows["direction"] == Direction.SENT]
        repeated = sorted(len(sendings) - 1 for sendings in truth.sent.values() if len(sendings) > 1)
        if set(mine["fragments"].tolist()) == {1}:  # probes are repeated as well, and have no row
            assert np.sort(mine["repeats"])[::-1][:5].max() <= repeated[-1]
            assert np.count_nonzero(mine["repeats"]) <= len(repeated)


def test_the_beginning_and_the_kernels_own_counters(watched):
    _, found = watched
    for counts in found.counts:
        assert counts.first_spdp_ns < counts.first_data_ns < counts.first_reply_ns
        assert counts.match_ns > 0
        assert counts.discovery_bytes_per_minute > 0
        assert counts.ip["fragments_created"] > 0
        assert counts.ip["reassembly_requested"] > counts.ip["reassembly_ok"] > 0


@pytest.mark.parametrize("backend", ["socket", "zenoh"])
def test_tcp_retransmissions_agree_with_tcp_info(tmp_path, backend):
    if backend == "zenoh":
        pytest.importorskip("zenoh")
    more = ("--size", "33KB", "--messages", 90, "--warmup", 10, "--rate", 40, "--wait", 60)
    found = record_watched(tmp_path, OPTIONS, backend, *more, loss=0.02)
    for counts, truth in zip(found.counts, found.truth, strict=True):
        assert truth.tcp_dropped_segments > 5
        segments = sum(one.packets for one in sent(counts, "tcp_data_again"))
        assert segments == within(0.01, truth.tcp_again_segments)
        assert segments == within(0.01, sum(one.retransmitted_segments for one in counts.tcp))
        assert counts.tcp_again_bytes == within(0.01, truth.tcp_again_bytes)
        assert counts.tcp_again_bytes == within(0.01, sum(one.bytes_retransmitted for one in counts.tcp))
        assert sum(one.bytes for one in sent(counts)) == within(0.01, truth.bytes)
        assert max(one.rtt_us for one in counts.tcp) > 0
        assert max(one.congestion_window for one in counts.tcp) > 0


@pytest.mark.parametrize(
    ("count", "size", "unit_bytes"),
    [
        (400, 1000, 1000 + 4 + 4),  # length of the sequence, encapsulation
        (150, 10_000, 1344),  # sent whole, repeated in fragments of this size
    ],
)
def test_cyclones_own_statistics_agree(tmp_path, count, size, unit_bytes):
    pytest.importorskip("cyclonedds")
    program = (sys.executable, SUPPORT / "cyclone_statistics.py")
    with lossy_link(tmp_path, loss=0.03) as link, running_session(link, 1, *program, "read") as reader:
        read_past(reader.stdout, "ready")
        said = link.watch(0, OPTIONS, tmp_path / "writer", *program, "write", count, size)
        link.stop()
    counts = from_json(WireCounts, json.loads((tmp_path / "writer.json").read_text()))
    again = fragments_again(counts)
    assert again > 5
    assert again == within(0.01, truth_of(link.log, 0).again)
    assert again * unit_bytes == within(0.01, int(said))


@pytest.fixture(scope="module")
def fastdds_statistics(tmp_path_factory):
    if shutil.which("cargo") is None:
        pytest.skip("no cargo here to build the listener with")
    folder = SUPPORT / "fastdds_statistics"
    target = tmp_path_factory.mktemp("target")
    built = executed(
        ["cargo", "build", "--release", "--quiet", "--manifest-path", folder / "Cargo.toml"],
        env={**os.environ, "CARGO_TARGET_DIR": str(target)},
    )
    if built.returncode != 0:
        pytest.skip(f"the listener cannot be built: {built.stderr.splitlines()[-1:]}")
    return target / "release" / "fastdds-statistics"


def test_fast_dds_own_statistics_agree(tmp_path, fastdds_statistics):
    pytest.importorskip("rclpy")
    program = Path(sys.executable).with_name("dds-record")
    names = ("RESENT_DATAS", "HEARTBEAT_COUNT")
    variable = "FASTDDS_STATISTICS=" + ";".join(f"{name}_TOPIC" for name in names)
    both, heard = ("--backend", "ros2", "--domain", 30), tmp_path / "heard"
    with lossy_link(tmp_path, loss=0.03) as link:
        relay = (program, "--role", "relay", *both, "--out", tmp_path / "relay.mcap")
        listener = ("sh", "-c", f'exec "$0" 30 >{heard}', fastdds_statistics)
        with running_session(link, 1, *relay) as session, running_session(link, 0, *listener):
            read_past(session.stderr, "serves domain")
            more = ("--size", "10KB", "--messages", 790, "--warmup", 10, "--rate", 50, "--wait", 60)
            ping = (program, "--role", "ping", *both, "--out", tmp_path / "ping.mcap", *more)
            link.watch(0, OPTIONS, tmp_path / "ping", "env", variable, *ping)
        link.stop()
    counts = from_json(WireCounts, json.loads((tmp_path / "ping.json").read_text()))
    own = {tuple(line.split()[:2]): int(line.split()[2]) for line in heard.read_text().splitlines()[1:]}

    def counted(topic):
        """Of all writers or readers of user topics, whose ids end in 03 and 04."""
        return sum(count for (name, entity), count in own.items() if name == topic and entity[-2:] in ("03", "04"))

    # One of them may still have been on its way to the listener when the ping ended.
    again = fragments_again(counts)
    assert again > 100
    assert counted("resent_datas") == within(0.01, again)
    heartbeats = sum(one.submessages for one in sent(counts, "heartbeat"))
    assert counted("heartbeat_count") == within(0.01, heartbeats)


def test_a_flow_of_100_mbit_s_is_followed_whole(tmp_path):
    packets = 30_000
    with lossy_link(tmp_path, loss=0, rate_mbit=100, log=Path("/dev/null")) as link:
        flood = (sys.executable, SUPPORT / "rtps_flood.py", link.sides[1].address, packets)
        options = WireOptions(("link0",), rtps_ports=(PortRange(7411, 7411),))
        link.watch(0, options, tmp_path / "flood", *flood)
        link.stop()
    counts = from_json(WireCounts, json.loads((tmp_path / "flood.json").read_text()))
    (one,) = counts.classes
    assert (one.name, one.direction) == (WireClass.DATA_FRAG.value, "sent")
    assert (counts.kernel_drops, counts.kernel_freezes) == (0, 0)
    # Not against `packets`: some never leave the socket while the neighbour's address is still unknown.
    (interface,) = counts.interface_counts
    assert one.packets == one.submessages == within(0.01, interface.sent_packets)
    assert one.bytes == within(0.01, interface.sent_bytes)
    rate_mbit = one.bytes * 8 / counts.duration_s / 1e6
    print(f"{rate_mbit:.0f} Mbit/s, {counts.packets_per_s:.0f} packets/s, {counts.cpu_s:.2f} s CPU")
