import json
import socket
import struct
import subprocess
import sys
import threading
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from backend_pairs import all_data_types, events, options
from processes import PATIENCE_S, ping, record_pair
from waiting import wait_until

from dds_trace.base.errors import OptionError
from dds_trace.recorder.backends import open_node
from dds_trace.recorder.backends.socket import BACKEND, tcp, udp
from dds_trace.recorder.backends.socket.greeting import CROWD, HALF_OPEN, MALFORMED, MAX_PEERS, SLOW, TOO_LARGE
from dds_trace.recorder.backends.socket.udp import FRAGMENT_BYTES, MAX_MESSAGE_BYTES
from dds_trace.recorder.choices import Discovery, Transport
from dds_trace.recorder.payloads import BINARY, IMU
from dds_trace.recorder.roles.floor import measure_floor
from dds_trace.tracefile.format.descriptions import Qos
from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.reading.reader import read_trace

SOCKET = ("--backend", "socket")
FEW = ("--data", "imu", "--messages", 5, "--rate", 50)
UDP = ("--transport", "udp", "--reliability", "best_effort")
BEST_EFFORT = Qos(reliability="best_effort")


@contextmanager
def pair(domain_id, receive, **more):
    """A listening node that hands what it gets to `receive`, and the publisher of one that has met it."""
    with (
        open_node("socket", options(domain_id, name="relay", listens=True, **more)) as there,
        open_node("socket", options(domain_id, name="ping", **more)) as here,
    ):
        there.create_subscription(BINARY.topic, BINARY.type_name, receive)
        publisher = here.create_publisher(BINARY.topic, BINARY.type_name)
        there.start()
        here.start()
        wait_until(lambda: "relay" in [each.node_name for each in here.look_at(BINARY.topic).subscriptions])
        yield here, there, publisher


@pytest.mark.middleware
@pytest.mark.parametrize(("protocol", "more"), [("tcp", ()), ("udp", (*UDP, "--tuned"))])
def test_all_data_types_go_there_and_back(domain_id, tmp_path, protocol, more):
    """UDP with buffers that hold a whole run: the default ones overflow while a node of a busy machine sleeps for 100 ms."""
    here, there = all_data_types(domain_id, tmp_path, "socket", "socket", *more)
    for session in (here, there):
        assert (session.backend, session.vendor, session.rmw) == ("socket", "socket", None)
        assert session.connectivity == "loopback"
        assert session.host["middleware"]["protocol"] == protocol
        assert session.host["middleware"]["tuned"] == ("true" if "--tuned" in more else "false")


@pytest.mark.parametrize("transport", [Transport.DEFAULT, Transport.UDP])
def test_the_own_share_of_sockets_is_measured_beside_a_relay_of_the_domain(domain_id, transport):
    """Two nodes of one process, at a port of their own, as nodes on sockets do not hear themselves."""
    with open_node("socket", options(domain_id, listens=True)) as relay_node:
        began_ns = time.monotonic_ns()
        floor = measure_floor("socket", options(domain_id, transport=transport), 20, PATIENCE_S, 200)
        assert relay_node.count_participants() == 1
    assert 0 < floor.median_ns <= floor.p99_ns < time.monotonic_ns() - began_ns
    assert (floor.messages, floor.rate_hz) == (20, 200)


def independent_delays(domain_id, folder, delay_s):
    """RTT and the time within the relay, by the relay's own clock readings, of messages that it passes on at once, and of
    those that it delays, which take turns (ns)."""
    script = Path(__file__).parents[2] / "support" / "plain_echo.py"
    port = BACKEND.port_of(domain_id)
    with subprocess.Popen(
        [sys.executable, script, str(port), IMU.topic, IMU.type_name, str(delay_s)], stdout=subprocess.PIPE, text=True
    ) as echo:
        try:
            assert echo.stdout.readline() == "ready\n"
            done = ping(
                *(domain_id, folder / "ping.mcap", *SOCKET, "--data", "imu"),
                *("--messages", 60, "--warmup", 0, "--rate", 40),
            )
            assert done.status == 0, done.stderr
            stamps = [tuple(map(int, line.split())) for line in echo.stdout]
            assert echo.wait(PATIENCE_S) == 0
        finally:
            echo.kill()
    trace = read_trace(folder / "ping.mcap")
    run_id = trace.runs[0].run_id
    (sent, t1), (received, t2) = (events(trace, stage, run_id) for stage in (Stage.T1, Stage.T2))
    found = ([], [])
    for run, sequence, in_ns, out_ns in stamps:
        if run != run_id:  # a probe
            continue
        publish_ns, receive_ns = (int(t1.monotonic_ns[sent[sequence]]), int(t2.monotonic_ns[received[sequence]]))
        assert publish_ns <= in_ns <= out_ns <= receive_ns  # one machine, one clock
        found[sequence % 2].append((receive_ns - publish_ns, out_ns - in_ns))
    assert [len(each) for each in found] == [30, 30]
    return found


@pytest.mark.middleware
def test_a_known_delay_in_an_independent_relay_comes_back(domain_id, tmp_path):
    """Drawn out: RTT = way there + delay + way back, and the ways do not know of the delay."""
    delay_ns = 10_000_000
    plain, delayed = independent_delays(domain_id, tmp_path, delay_ns / 1e9)
    assert all(delay_ns <= inside_ns <= rtt_ns for rtt_ns, inside_ns in delayed)
    # The least of thirty, as other programs of the machine only add.
    ways = [min(rtt_ns - inside_ns for rtt_ns, inside_ns in each) for each in (plain, delayed)]
    assert abs(ways[1] - ways[0]) < delay_ns / 2
    rtts, inside = ([min(times_ns) for times_ns in zip(*each, strict=True)] for each in (plain, delayed))
    assert abs((rtts[1] - rtts[0]) - (inside[1] - inside[0])) < delay_ns / 2


@pytest.mark.parametrize(
    ("more", "sizes"),
    [
        ({}, (1, 33_000, 1_000_000, 4_000_000)),
        (
            {"transport": Transport.UDP, "qos": BEST_EFFORT, "tuned": True},
            (1, FRAGMENT_BYTES, FRAGMENT_BYTES + 1, 100_000),
        ),
    ],
    ids=["tcp", "udp"],
)
def test_bytes_arrive_as_they_were_sent(domain_id, more, sizes):
    got, some = [], threading.Event()

    def receive(message, *_):
        got.append(bytes(message))
        some.set()

    with pair(domain_id, receive, **more) as (here, there, publisher):
        for size in sizes:
            data = BINARY.make(size, 1).messages[0].data
            deadline = time.monotonic() + PATIENCE_S
            some.clear()
            publisher.publish(data)
            while not some.wait(1):  # UDP promises nothing
                assert more, "TCP lost a message"
                assert time.monotonic() < deadline
                publisher.publish(data)
            assert got[-1] == data
        assert here.error is None
        assert there.error is None
        assert here.count_participants() == there.count_participants() == 2


def test_a_relay_that_ends_and_comes_again_is_found_again(domain_id):
    with open_node("socket", options(domain_id, name="ping")) as here:
        publisher = here.create_publisher(BINARY.topic, BINARY.type_name)
        here.start()
        for _ in range(2):
            some = threading.Event()
            with open_node("socket", options(domain_id, name="relay", listens=True)) as there:
                there.create_subscription(BINARY.topic, BINARY.type_name, lambda *_, some=some: some.set())
                there.start()
                wait_until(some.is_set, meanwhile=lambda: publisher.publish(b"x"))
        assert here.error is None


def test_strangers_do_no_harm(domain_id):
    got = threading.Event()
    with pair(domain_id, lambda *_: got.set()) as (_, there, publisher):
        for noise in (b"GET / HTTP/1.1\r\n\r\n", b"\xff" * 4096, b"\0" * 6, b""):
            with socket.create_connection(("127.0.0.1", BACKEND.port_of(domain_id))) as stranger:
                stranger.sendall(noise)
        publisher.publish(b"x")
        assert got.wait(PATIENCE_S)
        assert there.error is None


def test_strangers_on_udp_do_no_harm(domain_id):
    got = threading.Event()
    with (
        pair(domain_id, lambda *_: got.set(), transport=Transport.UDP, qos=BEST_EFFORT) as (_, there, publisher),
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
    ):
        for noise in (b"", b"x", b"\xff" * 4096, b"\0" * 10 + b"{}", b"\0" * 6 + b"\1\0\0\0[]"):
            stranger.sendto(noise, ("127.0.0.1", BACKEND.port_of(domain_id)))
        while not got.wait(0.1):
            publisher.publish(b"x")
        assert there.error is None


def frame(topic, body):
    return struct.pack("<IH", len(body), len(topic)) + topic + body


def greeting(**more):
    return json.dumps({"name": "x", "subscriptions": {}, "publishers": {}, **more}).encode()


def connect(domain_id, *sent):
    stranger = socket.create_connection(("127.0.0.1", BACKEND.port_of(domain_id)), PATIENCE_S)
    for part in sent:
        stranger.sendall(part)
    return stranger


SUBSCRIBED = greeting(subscriptions={BINARY.relay_topic: BINARY.type_name})


@pytest.mark.parametrize(
    ("sent", "kind"),
    [
        ([frame(b"", b"[" * 10_000)], MALFORMED),
        ([frame(b"", b'{"name": "\\u001b[31m", "subscriptions": {}, "publishers": {}}')], MALFORMED),
        ([frame(b"", greeting(publishers=[["a", 1]]))], MALFORMED),
        ([frame(BINARY.topic.encode(), b"x")], MALFORMED),  # before a greeting
        ([struct.pack("<IH", 1 << 30, 5) + b"abcde"], MALFORMED),
        ([frame(b"", greeting()), struct.pack("<IH", (1 << 30) + 1, 1) + b"a"], MALFORMED),
        ([frame(b"", greeting()), struct.pack("<IH", 1 << 30, 1) + b"a"] * 3, TOO_LARGE),
    ],
)
def test_a_frame_that_is_none_ends_its_connection_and_nothing_else(domain_id, sent, kind, monkeypatch):
    monkeypatch.setattr(tcp, "MEMORY_BYTES", (3 << 30) - 1)
    got = threading.Event()
    with pair(domain_id, lambda *_: got.set()) as (_, there, publisher):
        strangers = [connect(domain_id, *sent[at : at + 2]) for at in range(0, len(sent), 2)]
        before = memory_bytes()
        wait_until(lambda: there.strangers.counts.get(kind))
        publisher.publish(b"x")
        assert got.wait(PATIENCE_S)
        assert there.error is None
        assert memory_bytes() - before < 512 << 20  # stacks and arenas of threads included
        for stranger in strangers:
            stranger.close()


def memory_bytes():
    return int(Path("/proc/self/statm").read_text().split()[0]) * 4096


def test_idle_connections_are_bounded_and_keep_nobody_out(domain_id):
    got = threading.Event()
    with pair(domain_id, lambda *_: got.set()) as (_, there, publisher):
        strangers = [connect(domain_id) for _ in range(3 * MAX_PEERS)]
        wait_until(lambda: there.strangers.counts.get(CROWD, 0) >= 2 * MAX_PEERS)
        assert there.count_participants() <= 1 + MAX_PEERS
        wait_until(lambda: threading.active_count() < MAX_PEERS + 20)  # those of closed connections end a little later
        publisher.publish(b"x")
        assert got.wait(PATIENCE_S)
        with open_node("socket", options(domain_id, name="late")) as late:
            late.start()
            wait_until(lambda: late.look_at(BINARY.topic).subscriptions)
        for stranger in strangers:
            stranger.close()


def test_a_connection_without_a_greeting_is_ended(domain_id, monkeypatch):
    monkeypatch.setattr(tcp, "HALF_OPEN_S", 0.2)
    with pair(domain_id, lambda *_: None) as (_, there, _publisher), connect(domain_id, b"\1") as stranger:
        wait_until(lambda: there.strangers.counts.get(HALF_OPEN))
        while stranger.recv(4096):
            pass


@pytest.mark.parametrize("sends", [False, True])
def test_a_subscriber_that_reads_nothing_is_dropped(domain_id, sends, monkeypatch):
    """The kernel waits so long for it and no longer, and it is waited for until it is dropped, not once more."""
    got, patience, shut_down = [], [], tcp._TcpPeer.shut_down

    def dropping(peer):
        if peer.is_slow and not patience:
            patience.append(peer._connection.getsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, 16))
        shut_down(peer)

    monkeypatch.setattr(tcp._TcpPeer, "shut_down", dropping)
    # Longer than a thread that reads is kept from running.
    monkeypatch.setattr(tcp, "READER_PATIENCE_S", 2.0)
    monkeypatch.setattr(tcp, "SENDER_PATIENCE_S", 4.0)
    with pair(domain_id, lambda *_: None) as (here, there, _):
        here.create_subscription(BINARY.relay_topic, BINARY.type_name, lambda *_: got.append(1))
        replies = there.create_publisher(BINARY.relay_topic, BINARY.type_name)
        sent = [frame(b"x", b"y")] if sends else []
        with connect(domain_id, frame(b"", SUBSCRIBED), *sent):
            wait_until(lambda: len(there.look_at(BINARY.relay_topic).subscriptions) == 2)
            for _ in range(100):
                replies.publish(bytes(500_000))
            wait_until(lambda: len(got) == 100 and there.strangers.counts)
        ((seconds, microseconds),) = (struct.unpack("@ll", timeout) for timeout in patience)
        assert seconds + microseconds / 1e6 == pytest.approx(4 if sends else 2, abs=0.02)  # in ticks of the kernel
        assert there.strangers.counts == {SLOW: 1}


@pytest.fixture
def udp_relay(domain_id):
    udp_options = options(domain_id, name="relay", listens=True, transport=Transport.UDP, qos=BEST_EFFORT)
    with open_node("socket", udp_options) as node:
        node.create_subscription(BINARY.topic, BINARY.type_name, lambda *_: None)
        node.replies = node.create_publisher(BINARY.relay_topic, BINARY.type_name)
        node.start()
        yield node


def udp_stranger():
    stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    stranger.settimeout(0.3)
    return stranger


def answers(stranger):
    received = []
    with suppress(TimeoutError):
        while True:
            received.append(stranger.recv(65_535))
    return received


UDP_HEAD = struct.pack("<IHHH", 1, 0, 1, 0)


def test_an_address_that_returns_no_cookie_gets_less_than_it_sent(domain_id, udp_relay):
    with udp_stranger() as victim:
        greeted = UDP_HEAD + SUBSCRIBED
        victim.sendto(greeted, ("127.0.0.1", BACKEND.port_of(domain_id)))
        time.sleep(0.3)
        udp_relay.replies.publish(bytes(500_000))
        time.sleep(1)  # a greeting is due
        assert sum(map(len, answers(victim))) <= len(greeted)
        assert udp_relay.count_participants() == 1


def test_addresses_are_bounded(domain_id, udp_relay, monkeypatch):
    monkeypatch.setattr(udp, "FORGET_S", PATIENCE_S)
    port = BACKEND.port_of(domain_id)
    strangers = [udp_stranger() for _ in range(MAX_PEERS + 10)]
    for stranger in strangers:
        stranger.settimeout(PATIENCE_S)
        stranger.sendto(UDP_HEAD + SUBSCRIBED, ("127.0.0.1", port))
        cookie = stranger.recv(1000)[len(UDP_HEAD) :].removeprefix(b"cookie ").decode()
        returned = {**json.loads(SUBSCRIBED), "cookie": cookie}
        stranger.sendto(UDP_HEAD + json.dumps(returned).encode(), ("127.0.0.1", port))
    wait_until(lambda: udp_relay.strangers.counts.get(CROWD) == 10)
    assert udp_relay.count_participants() == 1 + MAX_PEERS
    for index in range(100):  # of a message that is never whole
        head = struct.pack("<IHHH", index, 7, -(-MAX_MESSAGE_BYTES // FRAGMENT_BYTES), 1)
        strangers[0].sendto(head + b"a" + bytes(1000), ("127.0.0.1", port))
    wait_until(lambda: udp_relay._links._unfinished_bytes == 8 * 1000)
    strangers[0].sendto(struct.pack("<IHHH", 1, 0, 65_535, 1) + b"a", ("127.0.0.1", port))
    wait_until(lambda: udp_relay.strangers.counts.get(MALFORMED))
    assert udp_relay.error is None
    for stranger in strangers:
        stranger.close()


@pytest.mark.parametrize(
    ("more", "line"),
    [
        ({"discovery": Discovery.SUBNET}, "--peer HOST"),
        ({"peers": ("pi4:x",)}, "write HOST or HOST:PORT"),
        ({"transport": Transport.UDP}, "--reliability best_effort"),
        ({"congestion_control": "none_such"}, "-o congestion_control=none_such: the kernel refuses it"),
        ({"transport": Transport.UDP, "qos": BEST_EFFORT, "congestion_control": "reno"}, "UDP has none"),
        ({"qos": Qos(durability="transient_local")}, "keep no messages"),
        ({"qos": Qos(extra={"deadline_ns": 5})}, "-o deadline: the backend socket has no such"),
        ({"qos": Qos(extra={"lifespan_ns": 5})}, "-o lifespan: the backend socket has no such"),
    ],
)
def test_options_without_a_meaning_are_refused(domain_id, more, line):
    with pytest.raises(OptionError, match=line):
        open_node("socket", options(**{"domain_id": domain_id, **more}))


def test_another_backend_has_no_congestion_control(domain_id):
    with pytest.raises(OptionError, match="the backend zenoh has no TCP of its own"):
        open_node("zenoh", options(domain_id, congestion_control="reno"))


@pytest.mark.middleware
def test_congestion_control_is_set_read_back_and_told(domain_id, tmp_path):
    """`reno` is in every kernel; the other side keeps the system's, as `sysctl` has it."""
    usual = Path("/proc/sys/net/ipv4/tcp_congestion_control").read_text().strip()
    done = record_pair(domain_id, tmp_path, SOCKET, (*FEW, "--congestion-control", "reno", "--strict"))
    assert done.status == 0, done.stderr
    for name, control in (("ping", "reno"), ("relay", usual)):
        session = read_trace(tmp_path / f"{name}.mcap").sessions[-1]
        assert session.host["middleware"]["congestion_control"] == control
        states = [each["tcp"] for each in session.extra["applied"]["begin"]["sockets"] if each.get("tcp")]
        assert {state["congestion_control"] for state in states} == {control}
        assert session.extra["settings"].get("congestion_control") == ("reno" if name == "ping" else None)


def test_frames_of_unlike_sizes_and_topics_follow_each_other(domain_id):
    """A read expects a frame like the last one: what comes instead, several at once or in pieces, is put together."""
    import random

    got, done = [], threading.Event()
    chance = random.Random(4)
    sizes = [chance.choice((1, 7, 33_000, 33_000, 33_000, 200_000)) for _ in range(300)]

    def receive_one(message, *_):
        got.append(bytes(message))
        if len(got) == len(sizes):
            done.set()

    with pair(domain_id, receive_one) as (here, there, publisher):
        there.create_subscription(IMU.topic, IMU.type_name, receive_one)
        other = here.create_publisher(IMU.topic, IMU.type_name)
        wait_until(lambda: here.look_at(IMU.topic).subscriptions)
        sent = [bytes([number % 256]) * size for number, size in enumerate(sizes)]
        for number, data in enumerate(sent):
            (other if number % 5 == 0 else publisher).publish(data)
        assert done.wait(PATIENCE_S)
        assert got == sent
        assert there.error is None


def test_several_connections_call_back_one_at_a_time(domain_id):
    inside, most, count, done = [0], [0], [0], threading.Event()

    def receive(_message, *_):
        inside[0] += 1
        most[0] = max(most[0], inside[0])
        time.sleep(0)  # gives the interpreter lock away
        inside[0] -= 1
        count[0] += 1
        if count[0] == 600:
            done.set()

    with pair(domain_id, receive) as (_, there, publisher), open_node("socket", options(domain_id)) as third:
        second = third.create_publisher(BINARY.topic, BINARY.type_name)
        third.start()
        wait_until(lambda: there.count_participants() >= 3 and third.look_at(BINARY.topic).subscriptions)
        senders = [
            threading.Thread(target=lambda by=by: [by.publish(b"x") for _ in range(300)]) for by in (publisher, second)
        ]
        for sender in senders:
            sender.start()
        assert done.wait(PATIENCE_S)
        for sender in senders:
            sender.join()
        assert most == [1]
        assert there.error is None


@pytest.mark.middleware
def test_a_ping_takes_the_relays_address(domain_id, tmp_path):
    address = f"127.0.0.1:{BACKEND.port_of(domain_id)}"
    done = record_pair(domain_id, tmp_path, SOCKET, (*FEW, "--discovery", "subnet", "--peer", address))
    assert done.status == 0, done.stderr
    assert len(read_trace(tmp_path / "ping.mcap").events[Stage.T2]) == 15
