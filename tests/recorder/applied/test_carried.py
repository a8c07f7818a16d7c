"""Which path carried the payload, by hand: 100 messages of 100 KB there and 100 back are 10 MB each way."""

import pytest
from snapshots import applied, counted, port, segment, tcp, udp

from dds_trace.recorder.applied.applied import Traffic, is_excluded, payload_path, with_path

TRAFFIC = Traffic(sent=100, received=100, payload_bytes=100_000)
MB = 1_000_000
QUIET = {"lo": (1 * MB, 1 * MB), "eth0": (0, 0)}
OWN, THEIRS = segment(), segment("fastrtps_00000000000000bb", is_own=False)


def path(traffic=TRAFFIC, begin=None, end=None, **more):
    begin = dict.fromkeys(end, (0, 0)) if begin is None else begin
    return payload_path(applied(begin=counted(**begin), end=counted(**end), **more), traffic)


@pytest.mark.parametrize(
    ("end", "memory", "expected"),
    [
        ({"lo": (20 * MB, 20 * MB), "eth0": (0, 0)}, (), "lo"),  # both ways of both sides pass loopback twice
        ({"lo": (0, 0), "eth0": (10 * MB, 10 * MB)}, (), "eth0"),
        ({"lo": (0, 0), "eth0": (10 * MB, 10 * MB)}, (OWN,), "eth0"),  # the peer is on another machine
        (QUIET, (OWN, THEIRS), "shm"),
        (QUIET, (OWN,), "shm"),  # the peer has ended, its segment is gone
        (QUIET, (segment("1.zenoh", vendor="zenoh", is_own=None),), "shm"),
        (QUIET, (), "unknown"),
        (QUIET, (segment(is_own=False, is_deleted=True),), "unknown"),  # a remainder carries nothing
        ({"lo": (20 * MB, 20 * MB)}, (OWN, THEIRS), "unknown"),  # others' traffic, or this one's
        ({"lo": (20 * MB, 20 * MB)}, (OWN, port(is_own=False)), "unknown"),  # a peer in memory has been there
        ({"lo": (7 * MB, 7 * MB)}, (OWN, THEIRS), "unknown"),  # neither enough nor too little
        ({"lo": (20 * MB, 20 * MB)}, (OWN,), "lo"),  # a peer's memory was never mapped
        ({"lo": (90 * MB, 90 * MB)}, (OWN,), "lo"),  # also where others count
        ({"lo": (20 * MB, 20 * MB)}, (OWN, segment(is_own=False, is_deleted=True)), "unknown"),  # it is gone
        ({"lo": (7 * MB, 7 * MB)}, (), "unknown"),
        ({"lo": (20 * MB, 20 * MB), "eth0": (10 * MB, 10 * MB)}, (), "unknown"),  # two could have been it
        ({"lo": (500 * MB, 500 * MB)}, (), "unknown"),  # mostly others'
        ({"eth0": (10 * MB, 1 * MB)}, (), "unknown"),  # one way alone
        ({"eth0": (10 * MB, 1 * MB)}, (OWN, THEIRS), "shm"),  # others' traffic; nothing came back there
    ],
)
def test_the_path_is_named_where_nothing_else_explains_the_counters(end, memory, expected):
    assert path(end=end, memory=memory) == expected


def test_what_was_counted_before_the_beginning_does_not_count():
    begin = {"lo": (90 * MB, 90 * MB)}
    assert path(begin=begin, end={"lo": (91 * MB, 91 * MB)}, memory=(OWN, THEIRS)) == "shm"
    assert path(begin=begin, end={"lo": (110 * MB, 110 * MB)}) == "lo"


def test_small_payloads_are_not_told_from_discovery():
    small = Traffic(100, 100, 296)
    assert path(small, end={"lo": (1 * MB, 1 * MB)}) == "unknown"
    assert path(small, end={"lo": (0, 0)}, memory=(OWN, THEIRS)) == "unknown"


def test_bytes_of_the_own_tcp_connection_prove_it_on_a_busy_machine():
    busy = {"lo": (900 * MB, 900 * MB)}
    before, after = (tcp(5, 5),), (tcp(10 * MB + 5, 10 * MB + 5),)
    memory = (segment("1.zenoh", vendor="zenoh", is_own=None),)
    assert path(end=busy, begin_sockets=before, sockets=after, memory=memory) == "lo"
    assert path(end=busy, begin_sockets=before, sockets=before, memory=memory) == "unknown"


def test_tcp_to_another_machine_went_through_the_interface_that_counted_it():
    there = (tcp(10 * MB, 10 * MB, remote="192.0.2.9"),)
    end = {"lo": (0, 0), "eth0": (11 * MB, 11 * MB)}
    assert path(end=end, begin_sockets=(), sockets=there) == "eth0"


def test_a_connection_that_was_open_before_counts_from_the_beginning_on():
    sockets = (tcp(10 * MB, 10 * MB),)
    assert path(end=QUIET, begin_sockets=sockets, sockets=sockets) == "unknown"


def test_before_the_end_nothing_is_known():
    begun = applied(memory=(OWN,), begin=counted(lo=(0, 0)))
    assert with_path(begun, TRAFFIC).path == "unknown"
    assert not is_excluded(begun, "lo", TRAFFIC)


def test_an_interface_that_is_not_there_carried_nothing():
    ended = applied(begin=counted(lo=(0, 0)), end=counted(lo=(20 * MB, 20 * MB)))
    assert is_excluded(ended, "dummy0", TRAFFIC)
    assert not is_excluded(ended, "lo", TRAFFIC)
    assert not is_excluded(ended, "dummy0", Traffic(1, 1, 296))


def test_few_large_messages_may_have_been_under_way_at_a_snapshot():
    ended = applied(begin=counted(lo=(0, 0)), end=counted(lo=(4 * MB, 4 * MB)))
    assert not is_excluded(ended, "lo", Traffic(9, 9, 4_000_000))
    assert is_excluded(ended, "lo", Traffic(10, 10, 4_000_000))


def test_what_was_sent_for_nobody_is_no_proof():
    # The relay went away after ten of a hundred messages: nothing was sent after that.
    ended = applied(memory=(OWN,), begin=counted(eth0=(0, 0)), end=counted(eth0=(1 * MB, 1 * MB)))
    assert not is_excluded(ended, "eth0", Traffic(100, 10, 100_000))
    assert payload_path(ended, Traffic(100, 10, 100_000)) == "unknown"


def test_counters_that_went_away_or_began_anew_are_no_proof():
    begin = counted(lo=(0, 0), wlan0=(90 * MB, 90 * MB))
    gone, anew = counted(lo=(0, 0)), counted(lo=(0, 0), wlan0=(1 * MB, 1 * MB))
    for end in (gone, anew):
        ended = applied(memory=(OWN,), begin=begin, end=end)
        assert is_excluded(ended, "lo", TRAFFIC)
        assert not is_excluded(ended, "wlan0", TRAFFIC)
        assert payload_path(ended, TRAFFIC) == "unknown"


def test_a_relay_sent_messages_that_others_lost():
    # The kernel counts what was sent to it, whoever received it.
    assert path(Traffic(100, 20, 100_000), end={"eth0": (10 * MB, 2 * MB)}) == "eth0"


def test_the_ends_path_travels_with_the_read_back():
    ended = applied(begin=counted(lo=(0, 0)), end=counted(lo=(20 * MB, 20 * MB)), sockets=(udp(7411),))
    assert with_path(ended, TRAFFIC).path == "lo"


def test_without_counters_nothing_is_known():
    assert path(end={}, memory=(OWN, THEIRS)) == "unknown"
