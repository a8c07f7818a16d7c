"""Real namespaces with a real link between them, seen by plain UDP datagrams; root only."""

import os
import struct
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest
from namespaces import needs_namespaces

from dds_trace.base.errors import BackendUnavailableError, OptionError
from dds_trace.extensions.campaigns.plan.cells import OutageBy
from dds_trace.extensions.campaigns.plan.link import PRESETS, Link
from dds_trace.extensions.campaigns.station.emulation import LinkEvents, ip, link_changes
from dds_trace.extensions.campaigns.station.namespaces import NamespacePair, remove_stale, require_root

UDP_ECHO = Path(__file__).parents[3] / "support" / "udp_echo.py"

FIRST = ("chrt", "-f", "5")
"""Start of a command with real-time priority, which other programs do not delay."""

skipped = needs_namespaces("tc", "iproute2")
needs_tap = pytest.mark.skipif(not Path("/dev/net/tun").exists(), reason="no TAP devices here")


@contextmanager
def echo(pair, *words):
    server = subprocess.Popen(
        [*pair.relay.prefix, *words, sys.executable, str(UDP_ECHO), "serve"], stdout=subprocess.PIPE, text=True
    )
    assert server.stdout.readline() == "ready\n"
    try:
        yield
    finally:
        server.terminate()
        server.communicate()


def spans(pairs, size_bytes, count, timeout_s=20, prefix=()):
    words = [str(word) for word in (size_bytes, count, timeout_s)]
    asking = [
        subprocess.Popen(
            [*pair.ping.prefix, *prefix, sys.executable, str(UDP_ECHO), "ask", pair.relay.address, *words],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )
        for pair in pairs
    ]  # fmt: skip
    for client in asking:
        assert client.stdout.readline() == "ready\n"
    for client in asking:
        client.stdin.write("\n")
        client.stdin.flush()
    lines = "".join(client.communicate()[0] for client in asking).splitlines()
    assert not any(client.returncode for client in asking)
    return [tuple(map(int, line.split())) for line in lines if line != "lost"]


def ask(pair, *arguments, **more):
    return [(end_ns - begin_ns) / 1e6 for begin_ns, end_ns in spans([pair], *arguments, **more)]


@skipped
@pytest.mark.parametrize(
    ("link", "applied_by"),
    [
        (Link(rate_mbit_s=10), "veth+tbf"),
        (Link(rate_mbit_s=10, shared=True), "veth+ifb+tbf"),
        pytest.param(Link(rate_mbit_s=10, shared=True, delay_ms=1), "tap_forwarder", marks=needs_tap),
    ],
)
def test_bytes_take_the_time_that_the_rate_says(link, applied_by):
    """25,000 bytes take 20 ms at 10 Mbit/s; up to 3,028 bytes of each direction pass at once."""
    with NamespacePair(link) as pair, echo(pair), echo(back := SimpleNamespace(ping=pair.relay, relay=pair.ping)):
        assert pair.applied_by == applied_by
        small, large = ask(pair, 100, 10), ask(pair, 25_000, 10)
        measured = pair.report()
        begins_ns, ends_ns = zip(*spans([pair, back], 25_000, 20), strict=True)
    assert min(large) > 2 * (25_000 - 3_028) * 8 / 10e6 * 1e3
    assert min(small) < min(large) / 5
    assert measured["ping"]["sent_bytes"] > 10 * 25_000
    assert (measured["forwarder"] is None) == (applied_by != "tap_forwarder")
    if link.shared:  # all that both sides send and answer, of which a line for each direction carries half
        assert max(ends_ns) - min(begins_ns) > 0.9 * 2 * len(ends_ns) * 25_000 * 8 / 10e6 * 1e9


@skipped
def test_a_pair_changes_from_one_line_to_another():
    with NamespacePair(None, has_air=True) as pair, echo(pair):
        for link, applied_by in ((Link(rate_mbit_s=100), "veth+tbf"), (PRESETS["air-30"], "veth+ifb+tbf")) * 2:
            pair.shape(link)
            assert (pair.applied_by, pair.report()["link"]) == (applied_by, link.to_dict())
            assert min(ask(pair, 25_000, 5)) > 2 * (25_000 - 3_028) * 8 / link.rate_mbit_s / 1e3


@skipped
@needs_tap
def test_every_round_trip_has_the_delay_and_a_report_counts_since_the_one_before():
    with NamespacePair(Link(delay_ms=20)) as pair, echo(pair):
        times = ask(pair, 100, 20)
        measured, second = pair.report(), pair.report()
    assert len(times) == 20
    assert min(times) >= 40
    assert measured["ping"]["sent_packets"] >= 20 > second["ping"]["sent_packets"]
    assert measured["link"]["delay_ms"] == 20
    if pair.applied_by == "tap_forwarder":
        assert measured["forwarder"]["from_ping"]["carried"] >= 20
        assert measured["forwarder"]["from_ping"]["lateness_p99_us"] >= 0


@skipped
@needs_tap
def test_fragments_are_lost_so_large_datagrams_suffer_more():
    with NamespacePair(Link(loss_percent=30)) as pair, echo(pair):
        # 33,000 bytes are 23 fragments each way: 0.7 ** 46 come back, 1 in 13 million
        assert ask(pair, 33_000, 3, timeout_s=0.2) == []
        # 0.49 of the small ones do: none or all of 40 is 1 in 10 ** 11
        assert 0 < len(ask(pair, 100, 40, timeout_s=0.2)) < 40


@skipped
@pytest.mark.parametrize("link", [None, *PRESETS.values()], ids=str)
def test_every_preset_can_be_applied_and_leaves_nothing_behind(link):
    if link and not link.needs_only_rate and not Path("/dev/net/tun").exists():
        pytest.skip("no TAP devices here")
    pair = NamespacePair(link)
    with pair:
        assert pair.ping.namespace in ip("netns", "list")
        assert pair.report()["link"] == (link.to_dict() if link else None)
        routes = ip("-n", pair.ping.namespace, "route", "show")
        assert "224.0.0.0/4 dev link0" in routes
    assert pair.ping.namespace not in ip("netns", "list")
    assert pair._forwarder is None


@skipped
def test_an_outage_begins_and_ends_when_the_kernel_says_and_not_with_the_command():
    with NamespacePair(Link(rate_mbit_s=10)) as pair:
        for by in set(OutageBy) - {OutageBy.RELAY}:
            before_ns = time.monotonic_ns()
            down_ns = pair.cut(by)
            between_ns = time.monotonic_ns()
            with LinkEvents([pair.ping.namespace, pair.relay.namespace]) as events:
                up_ns = pair.restore(by)
            assert before_ns < down_ns < between_ns < up_ns < time.monotonic_ns()
            # The second observer saw it too, as it came from the kernel.
            assert events.first_ns(passes=True) <= events.last_ns(passes=True)
            pair.repair()


def test_messages_of_the_kernel_about_other_interfaces_and_disciplines_are_no_outage():
    def message(kind, index, value):
        return struct.pack("IHHIIBBHiI", 32, kind, 0, 0, 0, 0, 0, 0, index, value) + bytes(4)

    up, dropping = 0x10001, 0xFF0000
    several = [message(16, 2, up), message(16, 1, 0), message(16, 2, 1), message(36, 2, 0x10000), message(20, 2, 0)]
    assert [*link_changes(b"".join(several))] == [True, False]
    assert [*link_changes(message(37, 2, dropping) + message(36, 2, dropping))] == [True, False]
    assert [*link_changes(bytes(15))] == [*link_changes(bytes(64))] == []


@skipped
def test_a_side_has_its_own_shared_memory_and_machine_id():
    own = Path("/etc/machine-id").read_text().split() if Path("/etc/machine-id").is_file() else []
    look = ("sh", "-c", "ls /dev/shm; touch /dev/shm/ddstrace-test; cat /etc/machine-id || true")
    with NamespacePair(None) as pair:
        sides = (pair.ping, pair.relay, pair.ping)
        done = [subprocess.run([*side.prefix, *look], capture_output=True, text=True, check=True) for side in sides]
    assert not Path("/dev/shm/ddstrace-test").exists()
    seen = [each.stdout.split() for each in done]
    assert (seen[0] == seen[2], len({*own, *seen[0], *seen[1]})) == (True, 3 if own else 0)


@skipped
def test_namespaces_of_a_killed_sweep_are_removed_by_the_next():
    ended = subprocess.Popen(["true"])
    ended.wait()
    stale, own = f"ddstrace-{ended.pid}-0-ping", f"ddstrace-{os.getpid()}-999-ping"
    ip("netns", "add", stale)
    ip("netns", "add", own)
    try:
        remove_stale()
        while stale in ip("netns", "list"):  # a test beside this one may be about to delete it
            pass
        assert own in ip("netns", "list")
    finally:
        ip("netns", "delete", own)


@skipped
def test_failure_half_way_leaves_nothing_behind(monkeypatch):
    from dds_trace.extensions.campaigns.station import namespaces

    def refuse(*_arguments):
        raise BackendUnavailableError("tc: Specified qdisc kind is unknown.")

    monkeypatch.setattr(namespaces, "tc", refuse)
    pair = NamespacePair(Link(rate_mbit_s=10))
    with pytest.raises(BackendUnavailableError, match="unknown"), pair:
        pass
    assert pair.ping.namespace not in ip("netns", "list")


def test_without_root_the_error_says_what_to_do(monkeypatch):
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    with pytest.raises(OptionError, match="sudo"):
        require_root()


@skipped
@needs_tap
@pytest.mark.slow
def test_delay_and_rate_of_a_replayed_link_are_those_of_its_file_within_one_percent(tmp_path):
    """The least of several round trips, as a busy machine only adds to the link's time."""
    file = tmp_path / "two.csv"
    file.write_text("time_s,rate_mbit_s,delay_ms\n0,8,20\n2,4,50\n1000,8,20\n")
    with NamespacePair(Link(name="two", file=str(file))) as pair, echo(pair, *FIRST):
        at_rest = min(ask(pair, 100, 30, prefix=FIRST))
        pair.drive(starts=True)
        started_ns = pair.report()["drive_started_ns"]
        time.sleep(2.1)
        small, large = min(ask(pair, 100, 30, prefix=FIRST)), min(ask(pair, 25_000, 20, prefix=FIRST))
        measured = pair.report()
    assert started_ns is not None
    assert measured["forwarder"]["from_ping"]["carried"] >= 200  # 17 fragments of each large one
    for seen_ms, delay_ms, frame_bytes, mbit_s in (
        (at_rest, 20, 142, 8),
        (small, 50, 142, 4),
        (large, 50, 25_000 + 8 + 17 * 34, 4),
    ):
        assert seen_ms == pytest.approx(2 * (delay_ms + frame_bytes * 8 / mbit_s / 1000), rel=0.01)
