import itertools
import random

import pytest
from fake_clock import FakeClock
from fake_node import FakeNode, ListSink

from dds_trace.recorder.payloads import data_types
from dds_trace.recorder.payloads.stamp import NO_REPLY
from dds_trace.recorder.roles import relay as relay_module
from dds_trace.recorder.roles.relay import UNSTAMPED, Relay
from dds_trace.tracefile.format.descriptions import Qos

RELAY = 0xBEEF


class Bench:
    """A relay on a fake node; its clock ticks one microsecond at every look."""

    def __init__(self):
        self.node, self.clock = FakeNode(), FakeClock()
        self.sink = ListSink(self.clock)
        ticks = itertools.count(1000, 1000)
        self.clock.monotonic_ns = lambda: next(ticks)
        self.relay = Relay(self.node, self.sink, RELAY, data_types=data_types().values(), qos=Qos(), clock=self.clock)

    def message(self, name, run_id, sequence, size=None):
        data_type = data_types()[name]
        data = data_type.make(size, 1).messages[0].data
        data_type.raw.stamp.write(data, run_id, sequence)
        return bytes(data)


@pytest.fixture
def bench():
    return Bench()


@pytest.mark.parametrize(("name", "size"), [("binary", 145_000), ("string", 1405), ("imu", 296)])
def test_every_data_type_is_served_at_once(bench, name, size):
    data_type = data_types()[name]
    message = bench.message(name, 7, 3, size)
    bench.node.deliver(data_type.topic, message, 11, 12)
    (reply,) = bench.node.publishers[data_type.relay_topic].sent
    raw = data_type.raw.stamp
    assert raw.read(reply) == (7, 3, RELAY)
    assert len(reply) == len(message)
    assert bench.sink.events == [(3, 7, 3, 1000, 0, 11, 12, size, RELAY), (4, 7, 3, 2000, 0, 0, 0, size, RELAY)]


@pytest.mark.parametrize("name", ["binary", "string", "imu"])
def test_the_next_message_of_a_run_is_foreseen(name):
    """Whatever comes, events and replies are those of a message that comes alone."""
    bench, data_type = Bench(), data_types()[name]
    sizes = {"binary": (1000, 1001), "string": (91, 92), "imu": (None, None)}[name]
    came = [
        *((7, sequence, sizes[0]) for sequence in range(4)),
        (7, 4, sizes[1]),  # as the string's, perhaps of the same length on the way
        (7, 5, sizes[1]),
        (7, 9, sizes[1]),
        (8, 0, sizes[1]),
        (7, 10, sizes[1]),
        (7, 11, sizes[1]),
    ]
    for run_id, sequence, size in came:
        bench.node.deliver(data_type.topic, bytearray(bench.message(name, run_id, sequence, size)), 11, 12)
    raw, sent = data_type.raw, bench.node.publishers[data_type.relay_topic].sent
    assert [raw.stamp.read(reply) for reply in sent] == [(run_id, sequence, RELAY) for run_id, sequence, _ in came]
    assert [event[1:3] + event[5:] for event in bench.sink.events if event[0] == 3] == [
        (run_id, sequence, 11, 12, raw.payload_bytes_of(bench.message(name, run_id, sequence, size)), RELAY)
        for run_id, sequence, size in came
    ]
    assert [event[1:3] for event in bench.sink.events if event[0] == 4] == [each[:2] for each in came]
    assert (bench.relay.progress().relayed, bench.relay.progress().runs) == (len(came), 2)
    assert bench.sink.foreseen == (6 if name == "imu" else 5)


def test_both_events_are_kept_before_the_reply_leaves(bench):
    """A relay that is killed while it hands the reply over leaves no T2 without T3 and T4."""
    kept = []
    bench.node.publishers["imu_data_relay"].on_publish = lambda _: kept.extend(bench.sink.events)
    bench.node.deliver("imu_data", bench.message("imu", 7, 0))
    assert [event[0] for event in kept] == [3, 4]
    assert kept == bench.sink.events


def test_probes_are_answered_and_not_recorded(bench):
    bench.node.deliver("imu_data", bench.message("imu", 0, 99))
    assert len(bench.node.publishers["imu_data_relay"].sent) == 1
    assert bench.sink.events == []
    assert bench.relay.progress().relayed == 0


def test_foreign_messages_are_counted_and_left_alone(bench):
    for message in (b"", b"\0\1\0\0camera", bench.message("imu", 7, 0).replace(b"dt1:", b"cam:")):
        bench.node.deliver("imu_data", message)
    assert bench.node.publishers["imu_data_relay"].sent == []
    assert bench.sink.events == []
    assert bench.relay.progress().foreign == 3


def test_a_stamp_that_is_damaged_is_no_event(bench):
    bench.node.deliver("imu_data", bench.message("imu", 7, 0).replace(b"dt1:0000", b"dt1:zzzz"))
    assert bench.sink.events == []


def test_runs_of_two_pings_are_told_apart(bench):
    for run_id, sequence in ((7, 0), (8, 0), (7, 1)):
        bench.node.deliver("string_data", bench.message("string", run_id, sequence))
    progress = bench.relay.progress()
    assert (progress.relayed, progress.runs) == (3, 2)
    assert [event[1:3] for event in bench.sink.events if event[0] == 3] == [(7, 0), (8, 0), (7, 1)]


def test_endpoints_are_taken_off_at_the_end(bench):
    bench.relay.close()
    assert not any(each.is_open for each in bench.node.publishers.values())
    assert not any(each.is_open for each in bench.node.subscriptions.values())
    assert len(bench.relay.topics) == 6


def test_probes_call_back_behind_their_reply_and_messages_do_not():
    bench, called = Bench(), []
    relay = Relay(
        bench.node,
        bench.sink,
        RELAY,
        data_types=data_types().values(),
        qos=Qos(),
        on_probe=lambda: called.append(len(bench.node.publishers["imu_data_relay"].sent)),
    )
    bench.node.deliver("imu_data", bench.message("imu", 0, 99))
    assert called == [1]
    bench.node.deliver("imu_data", bench.message("imu", 7, 0))
    assert called == [1]
    assert (relay.traffic.sent, relay.traffic.received, relay.traffic.payload_bytes) == (1, 1, 296)


def test_runs_are_counted_once_however_they_take_turns_and_old_ones_are_forgotten(monkeypatch):
    monkeypatch.setattr(relay_module, "RECENT_RUNS", 3)
    relay = object.__new__(relay_module.Relay)
    relay._runs, relay._last_run, relay._recent_runs = 0, 0, {}
    relay._relayed = relay._payload_bytes = 0
    for run_id in (7, 8, 7, 9, 8, 7):
        relay._note(run_id, 1)
    assert (relay._runs, list(relay._recent_runs)) == (3, [9, 8, 7])
    relay._note(10, 1)
    relay._note(7, 1)
    assert (relay._runs, list(relay._recent_runs)) == (4, [8, 10, 7])  # 9 was the longest ago


@pytest.mark.parametrize("name", ["binary", "string", "imu"])
@pytest.mark.parametrize("form", [bytes, bytearray])
def test_any_bytes_cost_only_their_message(name, form):
    """Every beginning of a message, lengths that lie, and noise behind a good stamp: the next message is answered as ever."""
    bench, data_type, draw = Bench(), data_types()[name], random.Random(5)
    good = bench.message(name, 7, 1, None if name == "imu" else 100)
    hostile = [good[:end] for end in range(len(good))]
    hostile += [good[:at] + b"\xff" * 8 + good[at + 8 :] for at in range(0, len(good), 4)]
    hostile += [good[:62] + draw.randbytes(draw.randrange(80)) for _ in range(200)]
    for message in hostile:
        bench.node.deliver(data_type.topic, form(message), 11, 12)
    before = len(bench.sink.events)
    bench.node.deliver(data_type.topic, form(good), 11, 12)
    assert [event[:3] for event in bench.sink.events[before:]] == [(3, 7, 1), (4, 7, 1)]
    assert bench.node.strangers.counts[UNSTAMPED] >= 62 - 16
    assert all(0 <= event[2] < 2**64 and 0 <= event[7] < 2**32 for event in bench.sink.events)


@pytest.mark.parametrize("name", ["binary", "string", "imu"])
def test_a_message_that_wants_no_reply_is_recorded_and_not_sent_back(bench, name):
    data_type = data_types()[name]
    message = bytearray(bench.message(name, 7, 3))
    data_type.raw.stamp.write(message, 7, 3, NO_REPLY)
    bench.node.deliver(data_type.topic, bytes(message), 11, 12)
    assert not bench.node.publishers[data_type.relay_topic].sent
    ((stage, run_id, sequence, *_),) = bench.sink.events
    assert (stage, run_id, sequence) == (3, 7, 3)
    assert bench.relay.progress().relayed == 1
