import gc
import struct
import threading
from dataclasses import replace

import pytest
from fake_clock import FakeClock
from fake_node import FakeNode, ListSink

from dds_trace.recorder.payloads import BINARY, IMU, STRING
from dds_trace.recorder.payloads.header import header_data_type
from dds_trace.recorder.payloads.stamp import RAW_HEADER_STAMP, stamp_text
from dds_trace.recorder.roles.ping import (
    DRAIN_NS,
    LEAD_NS,
    LONGEST_DRAIN_NS,
    LONGEST_SETTLE_NS,
    MAX_PENDING,
    UNMET,
    UNNAMED,
    UNSENT,
    UNSTAMPED,
    open_ping,
)
from dds_trace.recorder.roles.plan import RunPlan
from dds_trace.recorder.roles.progress import Silence

MS = 1_000_000
START_NS = 1_000_000_000_000
RELAY = 0x2A
NEVER = threading.Event()


class Link:
    """A relay behind a link: answers each message after `delay_ns(sequence)`, or never where that is None."""

    def __init__(self, plan, *, delay_ns=lambda _: 3 * MS, publish_ns=lambda _: 0, relays=(RELAY,)):
        self.clock, self.node = FakeClock(START_NS), FakeNode()
        self.sink = ListSink(self.clock)
        self.ping = open_ping(self.node, plan, self.clock)
        self.topic = plan.payload.data_type.topic
        self._delay_ns, self._publish_ns, self._relays = delay_ns, publish_ns, relays
        self.node.publishers[self.topic].on_publish = self._on_publish

    def _on_publish(self, message):
        stamp = RAW_HEADER_STAMP.read(message)
        self.clock.advance_to(self.clock.now_ns + self._publish_ns(stamp.sequence))
        if (delay_ns := self._delay_ns(stamp.sequence)) is not None:
            for relay in self._relays:
                self.clock.at(self.clock.now_ns + delay_ns, lambda relay=relay: self.reply(message, relay))

    def reply(self, message, relay=RELAY):
        answer = RAW_HEADER_STAMP.reply(message, b"%08x" % relay)
        self.node.deliver(f"{self.topic}_relay", bytes(answer), 11, 12)

    @property
    def sent(self):
        return self.node.publishers[self.topic].sent

    def run(self, stop=NEVER, hopeless=None):
        for relay in self._relays:
            self.ping.meet(relay)
        return self.ping.run(self.sink, stop, hopeless)


def plan(messages=5, rate_hz=100.0, warmup=0, data_type=IMU, **more):
    return RunPlan(data_type.make(None, 1), rate_hz, messages, warmup, **more)


def test_messages_go_when_they_were_planned():
    link = Link(plan(messages=4, rate_hz=100.0))
    run = link.run()
    t0 = START_NS + LEAD_NS
    expected = [(run.run_id, n, t0 + 10 * n * MS, t0 + 10 * n * MS, 0, 0, 296, 0) for n in range(4)]
    assert link.sink.of_stage(1) == expected
    assert link.sink.of_stage(2) == [(run.run_id, n, t0 + (10 * n + 3) * MS, 0, 11, 12, 296, RELAY) for n in range(4)]


def test_a_rate_that_does_not_divide_a_second_does_not_drift():
    planned = plan(rate_hz=3.0)
    assert [planned.scheduled_ns(0, n) for n in (0, 1, 2, 3, 300)] == [
        0,
        333_333_333,
        666_666_667,
        1_000_000_000,
        100_000_000_000,
    ]


def test_late_replies_move_no_later_send():
    link = Link(plan(messages=5, rate_hz=100.0), delay_ns=lambda n: 500 * MS if n == 0 else 3 * MS)
    link.run()
    t0 = START_NS + LEAD_NS
    assert [event[2] for event in link.sink.of_stage(1)] == [t0 + 10 * n * MS for n in range(5)]
    assert link.sink.of_stage(2)[-1][1:3] == (0, t0 + 500 * MS)


def test_a_send_that_blocks_delays_what_is_due_and_moves_no_plan():
    # Message 1 takes 25 ms to hand over: 2 and 3 are due meanwhile and go at once, 4 is on time again.
    link = Link(plan(messages=5, rate_hz=100.0), publish_ns=lambda n: 25 * MS if n == 1 else 0)
    link.run()
    t0 = START_NS + LEAD_NS
    events = link.sink.of_stage(1)
    assert [(event[2] - t0) // MS for event in events] == [0, 10, 35, 35, 40]
    assert [(event[3] - t0) // MS for event in events] == [0, 10, 20, 30, 40]


def test_the_message_carries_stamp_and_send_time():
    link = Link(plan(messages=2, rate_hz=10.0))
    run = link.run()
    t1 = START_NS + LEAD_NS + 100 * MS
    seconds, nanoseconds = divmod(t1 + link.clock.wall_offset_ns, 1_000_000_000)
    assert link.sent[1][4:12] == struct.pack("<iI", seconds, nanoseconds)
    assert link.sent[1][16:62] == stamp_text(run.run_id, 1)


def test_the_event_is_kept_before_the_message_leaves():
    """A ping that is killed while it hands a message over leaves no T3 without its T1."""
    link, kept = Link(plan(messages=3)), []
    publisher = link.node.publishers[link.topic]
    publisher.on_publish = lambda _: kept.append([event[1] for event in link.sink.of_stage(1)])
    link.run()
    assert kept == [[0], [0, 1], [0, 1, 2]]


def test_the_run_is_described_at_start_and_end():
    link = Link(plan(messages=3, warmup=2, data_type=BINARY, bridge="builtin", relay_domain_id=10, labels={"a": "b"}))
    run = link.run()
    started, finished = link.sink.runs
    assert finished == run
    assert (started.state, started.published) == ("started", 0)
    assert (finished.state, finished.published) == ("finished", 5)
    assert finished.run_id == started.run_id != 0
    assert (finished.planned_messages, finished.warmup_messages) == (3, 2)
    assert (finished.data_type, finished.payload_bytes, finished.rate_hz) == ("binary", 33_000, 100.0)
    assert (finished.bridge, finished.relay_domain_id, finished.labels) == ("builtin", 10, {"a": "b"})
    assert [event[1] for event in link.sink.of_stage(1)] == [0, 1, 2, 3, 4]


def test_a_lost_reply_is_waited_for_and_then_given_up():
    link = Link(plan(messages=5), delay_ns=lambda n: None if n == 2 else 3 * MS)
    link.run()
    progress = link.ping.progress()
    assert (progress.sent, progress.received, progress.lost) == (5, 4, 1)
    last_reply = START_NS + LEAD_NS + 43 * MS
    assert DRAIN_NS < link.clock.now_ns - last_reply < DRAIN_NS + 100 * MS


def test_the_wait_ends_with_the_last_reply():
    link = Link(plan(messages=5), delay_ns=lambda n: 1500 * MS if n == 4 else 3 * MS)
    link.run()
    assert link.ping.progress().received == 5
    assert link.clock.now_ns - (START_NS + LEAD_NS + 1540 * MS) < 100 * MS


def test_slow_links_get_more_patience():
    # A round trip takes 3 s, as the probes have shown, and the second reply 4.5 s.
    link = Link(plan(messages=2), delay_ns=lambda n: 4500 * MS if n == 1 else 3000 * MS)
    assert link.ping.wait_for_echo(10, NEVER)
    link.run()
    assert link.ping.progress().received == 2


def test_two_relays_answer_each_for_itself():
    link = Link(plan(messages=3), relays=(1, 2))
    link.run()
    assert sorted(event[-1] for event in link.sink.of_stage(2)) == [1, 1, 1, 2, 2, 2]
    assert link.ping.progress().received == 3


def test_a_duplicate_is_recorded_and_counted_once():
    link = Link(plan(messages=3), relays=(1, 1), delay_ns=lambda n: None if n == 0 else 3 * MS)
    link.run()
    assert len(link.sink.of_stage(2)) == 4
    assert link.ping.progress().received == 2


def test_messages_of_other_runs_are_left_alone():
    link = Link(plan(messages=1))
    run = link.run()
    before = len(link.sink.events)
    message = bytearray(link.sent[-1])
    for run_id, sequence in ((run.run_id + 1, 0), (run.run_id, 1), (0, 5)):
        RAW_HEADER_STAMP.write(message, run_id, sequence)
        link.reply(message)
    link.node.deliver("imu_data_relay", b"\0\1\0\0rubbish")
    assert len(link.sink.events) == before


def test_a_stop_ends_the_sending_and_still_collects_replies():
    link = Link(plan(messages=100, rate_hz=100.0))
    stop = threading.Event()
    link.clock.at(START_NS + LEAD_NS + 31 * MS, stop.set)
    run = link.run(stop)
    assert run.published == 4
    assert run.state == "finished"
    assert len(link.sink.of_stage(2)) == 4


def test_readiness_takes_an_echo_and_records_no_event():
    link = Link(plan())
    assert link.ping.wait_for_echo(5, NEVER)
    assert link.sink.events == []
    stamps = [RAW_HEADER_STAMP.read(message) for message in link.sent]
    assert [stamp.run_id for stamp in stamps] == [0]


def test_readiness_of_several_relays_takes_an_echo_of_each():
    link = Link(plan(), relays=(1, 2))
    assert link.ping.wait_for_echo(5, NEVER, relays=2)
    assert link.ping.echoing_relays == 2
    assert len(link.sent) == 1
    assert not link.ping.wait_for_echo(2, NEVER, relays=3)
    assert link.ping.wait_for_echo(2, NEVER, relays=2)  # at once: they have answered


def test_probes_are_repeated_with_new_numbers_and_slow_down():
    link = Link(plan(), delay_ns=lambda _: None)
    assert not link.ping.wait_for_echo(4, NEVER)
    sequences = [RAW_HEADER_STAMP.read(message).sequence for message in link.sent]
    assert sequences == list(range(sequences[0], sequences[0] + len(sequences)))
    assert len(sequences) == 8  # at 0, 0.1, 0.3, 0.5, 1, 1.5, 2.5 and 3.5 s
    assert link.clock.now_ns - START_NS < 4200 * MS


def test_a_probe_of_another_ping_is_no_echo():
    link = Link(plan(), delay_ns=lambda _: None)
    message = bytearray(plan().payload.messages[0].data)
    RAW_HEADER_STAMP.write(message, 0, 12345)
    link.clock.at(START_NS + 100 * MS, lambda: link.reply(message))
    assert not link.ping.wait_for_echo(1, NEVER)


def test_a_late_echo_of_a_probe_does_not_disturb_the_run():
    link = Link(plan(messages=2), delay_ns=lambda n: 30 * MS if n > 1 else 3 * MS)
    assert link.ping.wait_for_echo(5, NEVER)
    probe = link.sent[0]
    link.clock.at(link.clock.now_ns + LEAD_NS + MS, lambda: link.reply(probe))
    link.run()
    assert len(link.sink.of_stage(2)) == 2


def test_during_the_run_a_message_is_lost_once_a_later_one_is_answered():
    link, seen = Link(plan(messages=4), delay_ns=lambda n: None if n in (1, 3) else 2 * MS), []
    link.clock.at(START_NS + LEAD_NS + 35 * MS, lambda: seen.append(link.ping.progress()))
    link.run()
    assert [(each.sent, each.received, each.lost) for each in seen] == [(4, 2, 1)]


def test_at_the_end_a_trailing_message_without_a_reply_is_lost_too():
    link = Link(plan(messages=4), delay_ns=lambda n: None if n in (1, 3) else (2 + n) * MS)
    link.run()
    progress = link.ping.progress()
    assert (progress.planned, progress.sent, progress.received, progress.lost) == (4, 4, 2, 2)
    assert (progress.rtt_p50_ns, progress.rtt_p99_ns) == (2 * MS, 4 * MS)


def test_garbage_collection_is_off_during_the_run_and_on_after_it():
    states = []
    link = Link(plan(messages=1), publish_ns=lambda _: states.append(gc.isenabled()) or 0)
    link.run()
    assert states == [False]
    assert gc.isenabled()


def test_endpoints_are_taken_off_at_the_end():
    link = Link(plan())
    link.ping.close()
    assert not link.node.publishers["imu_data"].is_open
    assert not link.node.subscriptions["imu_data_relay"].is_open


@pytest.mark.parametrize("size", [4, 2675])
def test_strings_have_no_time_and_their_own_place(size):
    clock, node = FakeClock(START_NS), FakeNode()
    sink = ListSink(clock)
    ping = open_ping(node, RunPlan(STRING.make(size, 1), 10.0, 1), clock)
    ping.meet(RELAY)
    node.publishers["string_data"].on_publish = lambda message: node.deliver(
        "string_data_relay", STRING.raw.stamp.reply(message, b"%08x" % RELAY)
    )
    ping.run(sink, NEVER)
    assert [event[6] for event in sink.of_stage(2)] == [size]


def test_the_silence_of_a_run_is_what_was_sent_behind_the_last_answered_message():
    link = Link(plan(messages=6, rate_hz=1.0), delay_ns=lambda n: 3 * MS if n in (0, 1) else None)
    link.run()
    assert link.ping.silence == Silence(messages=4, duration_ns=3000 * MS, before=2, answered=2)


def test_a_hopeless_run_waits_for_no_reply():
    link, hopeless = Link(plan(messages=3), delay_ns=lambda _: None), threading.Event()
    link.clock.at(START_NS + LEAD_NS + 40 * MS, hopeless.set)
    link.run(hopeless=hopeless)
    assert link.clock.now_ns <= START_NS + LEAD_NS + 60 * MS


def forged(link, sequence, relay=RELAY):
    message = bytearray(plan().payload.messages[0].data)
    RAW_HEADER_STAMP.write(message, link.ping.run_id, sequence)
    link.reply(message, relay)


def test_a_reply_to_a_message_that_was_not_sent_is_a_strangers():
    link = Link(plan(messages=100))
    link.clock.at(START_NS + LEAD_NS + 5 * MS, lambda: [forged(link, number) for number in (50, 99, 100)])
    link.run()
    assert [event[1] for event in link.sink.of_stage(2)] == list(range(100))
    assert link.node.strangers.counts == {UNSENT: 3}
    assert link.ping.progress().received == 100


@pytest.mark.parametrize("digits", [b"-fffffffffffffff", b"+000000000000001", b"0x00000000000001", b"00000000_0000001"])
def test_numbers_that_are_no_hex_digits_are_no_stamp(digits):
    link = Link(plan(messages=3))
    answer = bytearray(plan().payload.messages[0].data)
    answer[16:62] = stamp_text(link.ping.run_id, 0).replace(b"0" * 16, digits)
    link.clock.at(START_NS + LEAD_NS + 5 * MS, lambda: link.node.deliver("imu_data_relay", bytes(answer)))
    link.run()
    assert [event[1] for event in link.sink.of_stage(2)] == [0, 1, 2]
    assert link.node.strangers.counts == {UNSTAMPED: 1}


@pytest.mark.parametrize("data_type", [BINARY, STRING, IMU, header_data_type("sensor_msgs/msg/PointCloud2")])
@pytest.mark.parametrize("other_bytes", [1, 40, 100_000])
def test_a_reply_has_the_size_that_came(data_type, other_bytes):
    """The sender of a reply may have cut it or filled it up."""
    payload = (
        replace(BINARY.make(400, 1), data_type=data_type)
        if data_type.name == "pointcloud2"
        else data_type.make(None, 1)
    )
    node, sink = FakeNode(), ListSink(clock := FakeClock(START_NS))
    ping = open_ping(node, RunPlan(payload, 100.0, 3), clock)
    ping.meet(RELAY)

    def answer(message):
        reply = data_type.raw.stamp.reply(bytes(message), b"%08x" % RELAY)
        if len(sink.of_stage(1)) > 1:
            reply = reply[: len(message) - 40] if other_bytes < 40 else reply + bytes(other_bytes)
        node.deliver(f"{data_type.topic}_relay", reply)

    node.publishers[data_type.topic].on_publish = answer
    ping.run(sink, NEVER)
    first, *others = (event[6] for event in sink.of_stage(2))
    assert first == data_type.raw.payload_bytes_of(payload.messages[0].data)
    assert first not in others
    assert len(others) == 2 or node.strangers.counts == {
        UNSTAMPED: 2
    }  # a string that is shorter than it claims is none


@pytest.mark.parametrize("relay", [0, 0xFFFFFFFF])
@pytest.mark.parametrize("is_probe", [True, False])
def test_a_reply_that_names_no_relay_is_a_strangers(relay, is_probe):
    link = Link(plan(messages=5))
    if is_probe:
        link.ping._probe()
        link.clock.at(START_NS + 1, lambda: link.reply(link.sent[0], relay))
    else:
        link.clock.at(START_NS + LEAD_NS + 5 * MS, lambda: forged(link, 0, relay))
    link.run()
    assert link.node.strangers.counts == {UNNAMED: 1}
    assert link.ping.echoing_relays == 1
    assert {event[-1] for event in link.sink.of_stage(2)} == {RELAY}


def test_replies_of_relays_that_answer_no_probe_are_strangers_and_take_no_memory():
    link = Link(plan(messages=5))
    for relay in range(100, 100 + 2 * MAX_PENDING):
        link.clock.at(START_NS + LEAD_NS + 5 * MS, lambda relay=relay: forged(link, 0, relay))
    link.run()
    assert {event[-1] for event in link.sink.of_stage(2)} == {RELAY}
    assert link.node.strangers.counts == {UNMET: 2 * MAX_PENDING}
    assert link.clock.now_ns < START_NS + LEAD_NS + 100 * MS


def test_a_relay_that_comes_within_the_run_is_met_by_a_probe_and_loses_no_reply():
    link = Link(plan(messages=6), relays=(RELAY,))
    link.ping.meet(7)  # the one that has ended
    link.ping.run(link.sink, NEVER)
    assert [event[1] for event in link.sink.of_stage(2)] == list(range(6))
    assert {event[-1] for event in link.sink.of_stage(2)} == {RELAY}
    assert link.node.strangers.counts == {}
    probes = [stamp for stamp in map(RAW_HEADER_STAMP.read, link.sent) if stamp.run_id == 0]
    assert len(probes) == 1


def test_no_reply_moves_the_end_of_the_drain():
    """A relay that answers one message a second, later and later, and the last one never."""
    link = Link(plan(messages=200), delay_ns=lambda n: None if n == 199 else (1 + n) * 1000 * MS)
    link.run()
    sending_ns = LEAD_NS + 1990 * MS
    assert link.clock.now_ns - START_NS - sending_ns < LONGEST_DRAIN_NS + 100 * MS


def test_echoes_without_end_do_not_keep_a_run_from_starting():
    link = Link(plan())

    def echo_again():
        link.reply(link.sent[0])
        link.clock.at(link.clock.now_ns + 50 * MS, echo_again)

    link.clock.at(START_NS + 100 * MS, echo_again)
    assert link.ping.wait_for_echo(2, NEVER)
    assert link.clock.now_ns - START_NS < 2000 * MS + LONGEST_SETTLE_NS + 100 * MS


def test_a_probe_wakes_the_way_before_each_message():
    link = Link(plan(3, wake_ns=5 * MS))
    link.run()
    stamps = [RAW_HEADER_STAMP.read(message) for message in link.sent]
    assert [stamp.run_id == link.ping.run_id for stamp in stamps] == [False, True] * 3
    assert len({stamp.sequence for stamp in stamps[::2]}) == 1
