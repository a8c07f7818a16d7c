import json
import random
import socket
import time
from collections import defaultdict
from contextlib import ExitStack, contextmanager, suppress

import pytest
from backend_pairs import MESSAGES, ROOMY, WARMUP, assert_whole
from middlewares import skip_without
from processes import relay, running

from dds_trace.recorder.backends import load_backend, open_node
from dds_trace.recorder.backends.node import RELAY_SUFFIX, NodeOptions
from dds_trace.recorder.choices import Call, Discovery, Transport
from dds_trace.recorder.payloads import data_types
from dds_trace.recorder.roles.relay import UNSTAMPED
from dds_trace.tracefile.format.descriptions import Qos
from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.reading.reader import read_trace

pytestmark = pytest.mark.middleware

UDP = {"transport": Transport.UDP, "qos": Qos(reliability="best_effort")}


def hostile_messages(seed):
    """Endless: good messages cut short, with lengths that lie, with noise after a good stamp, without a stamp; topic and bytes."""
    draw = random.Random(seed)
    while True:
        for data_type in data_types().values():
            data = data_type.make(None if data_type.name == "imu" else draw.choice((100, 5000)), 1).messages[0].data
            data_type.raw.stamp.write(data, draw.getrandbits(64) or 1, draw.getrandbits(draw.choice((8, 63))))
            good, at = bytes(data), draw.randrange(len(data))
            for message in (
                good[:at],
                good[:at] + b"\xff" * 8 + good[at + 8 :],
                good[:4] + draw.randbytes(at),
                good[:62] + draw.randbytes(draw.randrange(200)),
                good.replace(b"dt1:", b"cam:"),
                draw.randbytes(draw.randrange(100)),
                b"",
            ):
                yield draw.choice((data_type.topic, data_type.relay_topic)), message


@contextmanager
def node_stranger(backend, domain_id, other, **more):
    """A function that sends a message from a node that the relay meets, and from one that the ping meets."""
    options = {"discovery": Discovery.LOCALHOST, **more}
    with ExitStack() as stack:
        nodes = [open_node(backend, NodeOptions(domain_id=domain_id, name="stranger", **options))]
        if other is not None:
            nodes.append(open_node(backend, NodeOptions(domain_id=other, name="other", listens=True, **options)))
        publishers = defaultdict(list)
        for node in map(stack.enter_context, nodes):
            for each in data_types().values():
                for topic in (each.topic, each.relay_topic):
                    publishers[topic].append(node.create_publisher(topic, each.type_name))
            node.start()

        def send(topic, message):
            for publisher in publishers[topic]:
                publisher.publish(message)

        yield send


@contextmanager
def socket_stranger(domain_id, other, **more):
    address = ("127.0.0.1", load_backend("socket").port_of(domain_id))
    kind = socket.SOCK_DGRAM if more else socket.SOCK_STREAM
    with node_stranger("socket", domain_id, other, **more) as send_frame:

        def send(topic, message):
            send_frame(topic, message)
            with socket.socket(socket.AF_INET, kind) as raw, suppress(OSError):
                raw.connect(address)
                raw.sendall(message)

        yield send


@contextmanager
def zenoh_stranger(domain_id, other, *, calls=False):
    import zenoh

    relay_at, own = (f"tcp/127.0.0.1:{load_backend('zenoh').port_of(each)}" for each in (domain_id, other))
    configuration = {
        "mode": "peer",
        "listen": {"endpoints": [own]},
        "connect": {"endpoints": [relay_at]},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
    }
    with zenoh.open(zenoh.Config.from_json5(json.dumps(configuration))) as session:
        start, answers = f"dds_trace/{domain_id}/{'call/' * calls}data/", hostile_messages(2)
        for each in data_types().values() if calls else ():
            key = start + each.topic
            session.declare_queryable(key, lambda query, key=key: query.reply(key, next(answers)[1]))

        def send(topic, message):
            if calls:
                session.get(start + topic, lambda _: None, payload=message)
            else:
                session.put(start + topic, message)
                session.delete(start + topic)

        yield send


def ros2_stranger(domain_id, _other):
    """Cyclone DDS itself sends only what it can read, so this is its stranger, too."""
    skip_without("ros2")
    return node_stranger("ros2", domain_id, None)


@contextmanager
def service_stranger(domain_id, _other):
    """Only calls: of two servers' responses a client takes the first one, so a call may be lost."""
    skip_without("ros2")
    options = NodeOptions(domain_id=domain_id, name="stranger", discovery=Discovery.LOCALHOST, call=Call.SERVICE)
    with open_node("ros2", options) as node:
        from rcl_interfaces.msg import Parameter, ParameterValue
        from rcl_interfaces.srv import SetParameters

        clients = {each.topic: node._node.create_client(SetParameters, each.topic) for each in data_types().values()}
        node.start()

        def send(topic, message):
            value = ParameterValue(
                type=len(message) % 256, integer_value=-len(message), integer_array_value=list(message[:9])
            )
            parameter = Parameter(name=message.decode("latin-1").replace("\0", ""), value=value)
            request = SetParameters.Request(parameters=[parameter] * (len(message) % 3))
            clients[topic.removesuffix(RELAY_SUFFIX)].call_async(request)

        yield send


STRANGERS = {
    "tcp": (socket_stranger, ("--backend", "socket")),
    "udp": (
        lambda *domains: socket_stranger(*domains, **UDP),
        ("--backend", "socket", "--transport", "udp", "--tuned", "--reliability", "best_effort"),
    ),
    "zenoh": (zenoh_stranger, ("--backend", "zenoh")),
    "cyclonedds": (ros2_stranger, ("--backend", "cyclonedds")),
    "ros2": (ros2_stranger, ("--backend", "ros2")),
    "ros2 typed": (ros2_stranger, ("--backend", "ros2", "--serialization", "typed")),
    "ros2 service": (service_stranger, ("--backend", "ros2", "--call", "service")),
    "zenoh service": (
        lambda *domains: zenoh_stranger(*domains, calls=True),
        ("--backend", "zenoh", "--call", "service"),
    ),
}


@pytest.mark.keeps(1)
@pytest.mark.parametrize("kind", STRANGERS)
def test_any_bytes_of_a_stranger_cost_only_themselves(kind, domains, tmp_path):
    make_stranger, arguments = STRANGERS[kind]
    skip_without(arguments[1])
    domain_id, other = domains.take(), domains.take()
    common = (*arguments, *ROOMY, "--discovery", "localhost", "--no-own-cost")
    backend = load_backend(arguments[1])
    peers = ()
    if backend.relay_port is not None:
        peers = ("--peer", "127.0.0.1", "--peer", f"127.0.0.1:{backend.port_of(other)}")
    plan = ("--data", "imu", "--messages", MESSAGES, "--warmup", WARMUP, "--rate", 20)
    ping = ("dds-record", "--role", "ping", "--domain", domain_id, "--out", tmp_path / "ping.mcap")
    with (
        relay(domain_id, tmp_path / "relay.mcap", *common) as relaying,
        make_stranger(domain_id, other) as send,
        running(*ping, *common, *peers, *plan) as pinging,
    ):
        for topic, message in hostile_messages(1):
            send(topic, message)
            time.sleep(0.002)
            if not pinging.is_alive:
                break
        pinged, relayed = pinging.finish(), relaying.stop()
    assert (pinged.status, relayed.status) == (0, 0), (pinged, relayed)
    traces = [read_trace(tmp_path / f"{role}.mcap") for role in ("ping", "relay")]
    if kind == "zenoh service":  # of several replies to a call zenoh delivers one
        assert len(traces[0].events[Stage.T2]) > 0
    else:
        assert_whole(*traces, has_source=None)
    for trace in traces:
        (session,) = trace.sessions[-1:]
        assert session.state == "closed"
        assert not session.extra.get("error")
        assert session.extra.get("strangers", {}).get(UNSTAMPED) or (kind, session.role) == ("ros2 service", "ping")
