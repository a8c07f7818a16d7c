import os
from dataclasses import replace

import pytest
from fake_node import FakeNode

from dds_trace.base.streams import say
from dds_trace.recorder.applied.applied import Applied, Snapshot, Traffic
from dds_trace.recorder.applied.differences import Difference, Setting
from dds_trace.recorder.backends import BACKEND_MODULES, load_backend
from dds_trace.recorder.backends.node import Endpoint, Middleware, NodeOptions, TopicView
from dds_trace.recorder.choices import Discovery, Security, Transport
from dds_trace.recorder.errors import RelayLostError
from dds_trace.recorder.host.environment import kept_output
from dds_trace.recorder.kernel.sockets import Socket, TcpState
from dds_trace.recorder.payloads import BINARY, header_data_type
from dds_trace.recorder.payloads.base import Message, Payload
from dds_trace.recorder.roles import echo
from dds_trace.recorder.roles.echo import explain_silence, find_loss, look_for_relays, own_causes, unexpected_relays
from dds_trace.recorder.roles.plan import RunPlan
from dds_trace.recorder.roles.progress import Silence
from dds_trace.tracefile.format.descriptions import Qos

IMAGE = "sensor_msgs/msg/Image"


@pytest.fixture
def node():
    return FakeNode(NodeOptions(domain_id=5, name="me", discovery=Discovery.LOCALHOST))


@pytest.fixture
def plan():
    return RunPlan(BINARY.make(4, 1), 10.0, 5)


def see(node, *, listening=(), answering=(), incompatible=(), unassignable=()):
    own = Endpoint("me", IMAGE)
    node.views = {
        "binary_image": TopicView("binary_image", (own,), tuple(listening), tuple(incompatible), tuple(unassignable)),
        "binary_image_relay": TopicView("binary_image_relay", tuple(answering), (own,)),
    }


def test_nobody_there_but_a_bridge(node, plan, sentences):
    see(node)
    bridged = replace(plan, bridge="builtin", relay_domain_id=10)
    text = explain_silence(node, bridged, 20)
    sentences(*text.splitlines())
    assert not look_for_relays(node, BINARY).is_hopeless
    own = [Endpoint("dds_trace_bridge_5", IMAGE)]
    see(node, listening=own, answering=own)
    assert explain_silence(node, bridged, 20).splitlines()[-1] == text.splitlines()[-1]


@pytest.mark.parametrize("backend", BACKEND_MODULES)
def test_each_backend_says_what_lets_its_sides_meet(node, backend):
    see(node)
    node.middleware = Middleware(backend, "vendor", None)
    node.options = replace(node.options, peers=("pi4", "pi5"))
    text = explain_silence(node, RunPlan(BINARY.make(4, 1), 10.0, 5), 20)
    assert "(this device only), at pi4, pi5" in text
    advice = text.splitlines()[-1]
    assert f"record relay --backend {backend} --domain 5 " in advice
    assert "bridge" not in advice
    # Ports 8 and 9 of the 250 of domain 5, which begin at 8650, and whoever looks for others needs no address.
    expected = {
        "ros2": ("multicast", "8650 to 8899", "ROS_STATIC_PEERS"),
        "cyclonedds": ("multicast", "CYCLONEDDS_URI"),
        "connext": ("multicast", "--peer"),
        "zenoh": ("--backend zenoh", "--peer", "TCP port 8659"),
        "socket": ("--backend socket", "-o transport", "--peer", "port 8658"),
    }
    words = expected.get(backend, (load_backend(backend).meeting_needs,))
    assert all(word in advice for word in words)
    assert ("multicast" in advice) == ("multicast" in " ".join(words))


def test_a_relay_in_sight_that_stays_silent(node, plan):
    node.participants = 3
    see(node, listening=[Endpoint("relay_1", IMAGE)], answering=[Endpoint("relay_1", IMAGE)])
    text = explain_silence(node, plan, 20)
    assert "2 other nodes" in text
    assert f"relay_1 ({IMAGE}) subscribed to binary_image" in text
    assert "firewalls" in text


def test_what_the_ping_saw_comes_first_and_a_firewall_last(node):
    see(node, listening=[Endpoint("relay_1", IMAGE)])
    node.options = replace(node.options, qos=Qos("best_effort"))
    udp = Socket("udp", "ipv4", "0.0.0.0", 7400, "0.0.0.0", 0, 212_992, 212_992, dropped=3)
    tcp = replace(udp, protocol="tcp", remote_port=7447, dropped=0, tcp=TcpState(acked_bytes=9_000_000))
    applied = Applied(Snapshot(sockets=()), Snapshot(sockets=(udp, tcp)))
    causes = own_causes(Traffic(18, 0, 5_000_000), applied, "open_and_lock_file failed")
    advice = explain_silence(node, RunPlan(BINARY.make(5_000_000, 1), 10.0, 5), 20, (), causes).splitlines()[-1]
    words = ("open_and_lock_file", "3 datagrams", "90 MB", "carried 9 MB", "5 MB with best_effort", "firewalls")
    assert sorted(words, key=advice.index) == list(words)
    assert not list(own_causes(Traffic(2, 0, 5_000_000), applied, ""))[1:]


def test_what_a_middleware_prints_is_read_and_passed_on_and_our_own_lines_at_once(capfd):
    with kept_output() as read_error:
        os.write(
            1, b"\x1b[31;1m Error] \x1b[37mFailed init_port: open_and_lock_file failed\x1b[34;1m -> Function open\n"
        )
        say("waiting")
        assert capfd.readouterr() == ("", "waiting\n")
        assert read_error() == "Failed init_port: open_and_lock_file failed"
        assert "open_and_lock_file failed" in capfd.readouterr().err
        os.write(2, b"the last words\n")
    assert capfd.readouterr().err == "the last words\n"
    said = "type [COMPLETE ef]: invalid object"
    with kept_output() as read_error:
        os.write(2, f"1795870701.539528 [38] dq.builtin: {said}\n".encode())
        assert read_error() == said


def test_no_socket_is_missed_where_no_relay_is_seen(node, plan):
    missing = Difference(Setting.TRANSPORT, "tcp", "no TCP socket is open", "asked for TCP, no TCP socket is open")
    see(node)
    assert "not applied" not in explain_silence(node, plan, 20, (missing,))
    see(node, listening=[Endpoint("relay_1", IMAGE)])
    assert "not applied" in explain_silence(node, plan, 20, (missing,))


def test_a_receiver_of_another_user_is_named_and_what_helps(node, plan, monkeypatch):
    see(node, listening=[Endpoint("relay_1", IMAGE)], answering=[Endpoint("relay_1", IMAGE)])
    node.middleware = Middleware("ros2", "fastdds", None)
    monkeypatch.setattr(echo, "ports_of_others", lambda _ports: {"fastrtps_port8661": 1000})
    assert "fastrtps_port8661 belongs to user 1000" in explain_silence(node, plan, 20)
    assert "-o transport=udp" in explain_silence(node, plan, 20)
    node.options = replace(node.options, transport=Transport.UDP)
    assert "firewalls" in explain_silence(node, plan, 20)


def test_the_printed_command_repeats_what_decides_whether_the_sides_meet(node, plan):
    see(node)
    qos = Qos("best_effort", "transient_local", extra={"deadline_ns": 20_000_000, "lifespan_ns": 5})
    node.options = replace(node.options, qos=qos, transport=Transport.SHM, rmw="rmw_fastrtps_cpp")
    options = "--rmw rmw_fastrtps_cpp -o transport=shm --reliability best_effort -o durability=transient_local -o deadline=20ms --out"
    assert options in explain_silence(node, plan, 20)
    node.options = replace(node.options, security=Security.ENCRYPT_RTPS, keys="my keys")
    assert "-o keys='my keys' " in explain_silence(node, plan, 20)


def test_quality_of_service_that_never_matches_is_named_and_hopeless(node, plan):
    see(node, listening=[Endpoint("relay_1", IMAGE)], incompatible=["they differ in reliability"])
    assert look_for_relays(node, BINARY).is_hopeless
    text = explain_silence(node, plan, 3)
    assert "they differ in reliability" in text
    assert "--reliability" in text


def test_one_suitable_relay_makes_the_wait_worthwhile(node):
    two = [Endpoint("relay_1", IMAGE), Endpoint("relay_2", IMAGE)]
    see(node, listening=two, incompatible=["relay_1 differs"])
    assert not look_for_relays(node, BINARY).is_hopeless


def test_another_type_on_the_topic_is_named_by_a_backend_that_cannot_count(node, plan):
    node.participants = None
    see(node, listening=[Endpoint("camera", "sensor_msgs/msg/CompressedImage")])
    text = explain_silence(node, plan, 3)
    assert "another program uses binary_image with sensor_msgs/msg/CompressedImage" in text
    assert "an unknown number of other nodes" in text


def test_a_type_and_a_flow_that_the_relay_needs_as_options_are_named(node):
    payload = Payload(header_data_type("sensor_msgs/msg/PointCloud2"), (Message(bytearray(200), 136),), 136)
    text = explain_silence(node, RunPlan(payload.in_flow("left"), 10.0, 5, relay_domain_id=5), 20)
    options = "--discovery localhost -o flow=left --type sensor_msgs/msg/PointCloud2 --out relay.mcap`"
    assert options in text


def test_a_relay_of_an_unassignable_type_is_named_and_no_firewall(node, plan, sentences):
    line = "a subscription's type has another definition"
    see(node, listening=[Endpoint("relay", IMAGE)], unassignable=[line])
    text = explain_silence(node, plan, 3)
    assert line in text
    assert "firewall" not in text
    sentences(text.splitlines()[-1])


def test_sides_without_a_common_dev_shm_are_told_so_and_no_firewall(node, plan, sentences):
    see(node, listening=[Endpoint("relay", IMAGE)], answering=[Endpoint("relay", IMAGE)])
    words = "messages for a receiver on this host go to fastdds_port8660, where nobody reads them"
    apart = Difference(Setting.MEMORY_NAMESPACE, "default", "fastdds_port8660", words)
    *_, advice, settings = explain_silence(node, plan, 3, (apart,)).splitlines()
    sentences(advice)
    assert "firewall" not in advice
    assert settings == f"  not applied: {words}"
    smaller = Difference(Setting.KERNEL_LIMIT, "4000000", "212992", "net.core.rmem_max is 212,992")
    assert "firewalls" in explain_silence(node, plan, 3, (smaller,))  # explains no silence


LASTING = Silence(messages=40, duration_ns=4_000_000_000, before=100, answered=100)


def test_a_relay_that_is_silent_and_out_of_sight_is_lost(node, sentences):
    see(node)
    error = find_loss(node, BINARY, LASTING, ended=False)
    assert isinstance(error, RelayLostError)
    sentences(str(error))


def test_a_silent_relay_in_sight_may_come_back_until_the_run_has_ended(node):
    see(node, answering=[Endpoint("relay", IMAGE)])
    assert find_loss(node, BINARY, LASTING, ended=False) is None
    assert find_loss(node, BINARY, LASTING, ended=True) is not None


def test_a_short_silence_is_no_loss_of_a_relay(node):
    see(node)
    assert find_loss(node, BINARY, replace(LASTING, duration_ns=1), ended=True) is None


@pytest.mark.parametrize(
    ("answering", "discovered", "requested", "words"),
    [(1, 1, 1, ""), (2, 2, 2, ""), (1, 2, 1, "1 of 2 discovered"), (2, 2, 1, "give -o relays=2")],
)
def test_a_second_relay_is_named_before_the_first_message(answering, discovered, requested, words):
    assert words in "".join(unexpected_relays(answering, discovered, requested))
    assert bool(words) is bool(list(unexpected_relays(answering, discovered, requested)))
