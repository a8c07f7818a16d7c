import contextlib
import itertools
import random
import socket
import time
from collections import Counter

import pytest

from dds_trace.extensions.campaigns.plan.link import Link
from dds_trace.extensions.campaigns.station import tap_forwarder

FRAME = b"\xff" * 12 + b"\x08\x00" + b"payload"
ARP = b"\xff" * 12 + b"\x08\x06" + b"who has"


@pytest.fixture
def ends():
    """Frames keep their borders on a datagram socket as they do on a TAP device: (send, source, sink, receive)."""
    send, source = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    sink, receive = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    source.setblocking(False)
    receive.setblocking(False)
    yield send, source, sink, receive
    for end in (send, source, sink, receive):
        end.close()


class Clock:
    def __init__(self, monkeypatch):
        self.now_ns = 1_000_000_000
        monkeypatch.setattr(time, "monotonic_ns", lambda: self.now_ns)


@pytest.fixture
def clock(monkeypatch):
    return Clock(monkeypatch)


def wire(ends, clock, **link):
    made = tap_forwarder.Wire(ends[1].fileno(), ends[2].fileno(), Link(**link).to_dict(), clock.now_ns)
    made._chance = random.Random(1)
    return made


def received(ends):
    frames = []
    with contextlib.suppress(BlockingIOError):
        while True:
            frames.append(ends[3].recv(65536))
    return frames


def test_frame_comes_out_after_the_delay_and_not_before(ends, clock):
    line = wire(ends, clock, delay_ms=5)
    ends[0].send(FRAME)
    line.take()
    assert line.due_ns == clock.now_ns + 5_000_000
    clock.now_ns += 4_999_999
    line.release()
    assert received(ends) == []
    clock.now_ns += 1
    line.release()
    assert received(ends) == [FRAME]
    assert line.due_ns is None


def test_lateness_is_what_was_added_to_the_delay(ends, clock):
    line = wire(ends, clock, delay_ms=1)
    for late_us in (10, 20, 400):
        ends[0].send(FRAME)
        line.take()
        clock.now_ns += 1_000_000 + late_us * 1000
        line.release()
    report = line.report()
    assert report["carried"] == 3
    assert (report["lateness_p50_us"], report["lateness_p99_us"], report["lateness_max_us"]) == (20, 400, 400)
    assert line.report()["carried"] == 0


def test_jitter_never_reorders(ends, clock):
    line = wire(ends, clock, delay_ms=5, jitter_ms=5)
    frames = [FRAME + bytes([number]) for number in range(200)]
    for frame in frames:
        ends[0].send(frame)
        line.take()
        clock.now_ns += 10_000
    got = []
    while line.due_ns is not None:  # one at a time, as a socket holds few datagrams
        clock.now_ns = line.due_ns
        line.release()
        got += received(ends)
    assert got == frames


def test_loss_takes_its_share_of_ip_frames_and_no_others(ends, clock):
    line = wire(ends, clock, loss_percent=50)
    got = Counter()
    for _ in range(200):
        ends[0].send(FRAME)
        ends[0].send(ARP)
        line.take()
        line.release()
        got.update(received(ends))
    assert got[ARP] == 200
    assert 70 < got[FRAME] < 130  # five standard deviations of 7
    assert line.report()["lost"] == 200 - got[FRAME]


def test_losses_in_bursts_have_their_share_and_their_length(ends, clock):
    line = wire(ends, clock, loss_percent=20, loss_burst=5)
    fates = [line._fate(FRAME, clock.now_ns) for _ in range(20_000)]
    lengths = [len([*run]) for fate, run in itertools.groupby(fates) if fate == "lost"]
    assert sum(lengths) / 20_000 == pytest.approx(0.2, rel=0.15)
    assert sum(lengths) / len(lengths) == pytest.approx(5, rel=0.15)
    assert tap_forwarder.burst_chances(1, 5) == (1, 0.2)


def test_two_directions_that_share_a_line_wait_for_each_other(ends, clock):
    link = {**Link(rate_mbit_s=8, shared=True).to_dict(), "has_rate": True}
    air = tap_forwarder.Line(8)
    for number in (1, 2):
        line = tap_forwarder.Wire(ends[1].fileno(), ends[2].fileno(), link, clock.now_ns, None, air)
        ends[0].send(FRAME)
        line.take()
        assert line.due_ns == clock.now_ns + number * len(FRAME) * 1000


def test_outage_is_at_the_end_of_each_period(ends, clock):
    line = wire(ends, clock, outage_every_s=1, outage_ms=300)
    fates = []
    for _ in range(20):  # every 100 ms for two seconds
        ends[0].send(FRAME)
        line.take()
        line.release()
        fates.append(len(received(ends)))
        clock.now_ns += 100_000_000
    assert fates == ([1] * 7 + [0] * 3) * 2
    assert line.report()["in_outage"] == 6


def test_frames_on_a_full_wire_are_dropped_and_counted(ends, clock):
    line = wire(ends, clock, delay_ms=1000)
    line._in_flight.extend((clock.now_ns + 1, FRAME) for _ in range(tap_forwarder.MOST_FRAMES))
    ends[0].send(FRAME)
    line.take()
    assert line.report()["overflow"] == 1


def test_frames_for_a_side_that_is_down_are_counted_as_refused(ends, clock):
    line = wire(ends, clock)
    ends[0].send(FRAME)
    line.take()
    ends[3].close()
    line.release()
    assert line.report()["refused"] == 1


def test_quantile_of_counted_values():
    assert tap_forwarder.quantile(Counter(), 0.5) is None
    assert tap_forwarder.quantile(Counter({1: 99, 7: 1}), 0.99) == 1
    assert tap_forwarder.quantile(Counter({1: 98, 7: 2}), 0.99) == 7


DRIVE = [[0, 8, 20, 0, 0], [1, 4, 50, 0, 0], [2, 0, 50, 0, 0], [3, 8, 30, 100, 0], [4, 8, 20, 0, 0]]
"""Rows of time in s, rate in Mbit/s, delay in ms, loss in percent, jitter in ms."""
LONG_FRAME = FRAME.ljust(1000, b"x")
SECOND = 1_000_000_000


def replaying(ends, clock, **link):
    replay = tap_forwarder.Replay(DRIVE)
    values = {**Link(**link).to_dict(), "has_rate": True}
    made = tap_forwarder.Wire(ends[1].fileno(), ends[2].fileno(), values, clock.now_ns, replay)
    return made, replay


def carried_after(ends, clock, line):
    began_ns = clock.now_ns
    ends[0].send(LONG_FRAME)
    line.take()
    if line.due_ns is None:
        return None
    clock.now_ns = line.due_ns
    line.release()
    assert received(ends) == [LONG_FRAME]
    return clock.now_ns - began_ns


def test_each_row_of_a_drive_has_its_rate_and_delay_from_its_time_on(ends, clock):
    line, replay = replaying(ends, clock)
    replay.started_ns = started_ns = clock.now_ns
    times = []
    for at_s in (0, 0.9, 1, 1.9, 2, 3, 4, 5):  # starts over at 4 s
        clock.now_ns = started_ns + round(at_s * SECOND)
        times.append(carried_after(ends, clock, line))
    # 8,000 bits take 1 ms at 8 Mbit/s and 2 ms at 4
    assert times == [21_000_000, 21_000_000, 52_000_000, 52_000_000, None, None, 21_000_000, 52_000_000]
    report = line.report()
    assert (report["carried"], report["in_outage"], report["lost"]) == (6, 1, 1)


def test_a_drive_at_rest_stays_in_its_first_row(ends, clock):
    line, _ = replaying(ends, clock)
    for _ in range(3):
        clock.now_ns += SECOND
        assert carried_after(ends, clock, line) == 21_000_000


def test_a_full_line_has_its_rate_and_drops_what_waits_too_long(ends, clock):
    line, _ = replaying(ends, clock, queue_ms=5)
    sent_ns = clock.now_ns
    for _ in range(10):
        ends[0].send(LONG_FRAME)
    line.take()
    due = []
    while line.due_ns is not None:
        clock.now_ns = line.due_ns
        due.append(line.due_ns - sent_ns)
        line.release()
        received(ends)
    # a frame is sent each ms, the seventh would wait for more than 5
    assert due == [(21 + number) * 1_000_000 for number in range(6)]
    assert line.report()["overflow"] == 4
