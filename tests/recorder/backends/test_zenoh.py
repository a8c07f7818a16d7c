import threading

import pytest
from backend_pairs import all_data_types, options
from waiting import wait_until

from dds_trace.base.errors import OptionError
from dds_trace.recorder.backends import open_node
from dds_trace.recorder.backends.zenoh import BACKEND
from dds_trace.recorder.choices import Discovery
from dds_trace.recorder.payloads import BINARY, IMU
from dds_trace.tracefile.format.descriptions import Qos

pytest.importorskip("zenoh", reason="no eclipse-zenoh here")
pytestmark = pytest.mark.middleware

ZENOH = ("--backend", "zenoh")


def test_all_data_types_go_there_and_back(domain_id, tmp_path):
    here, there = all_data_types(domain_id, tmp_path, "zenoh", "zenoh")
    for session in (here, there):
        assert (session.backend, session.vendor, session.rmw) == ("zenoh", "zenoh", None)
        assert session.host["versions"]["eclipse-zenoh"][0].isdigit()
        assert session.host["middleware"]["multicast"] == "false"
    address = f"tcp/127.0.0.1:{BACKEND.port_of(domain_id)}"
    assert there.host["middleware"]["listen"] == here.host["middleware"]["connect"] == address
    assert there.host["middleware"]["connect"] == here.host["middleware"]["listen"] == ""


def test_a_ping_may_be_there_first_and_a_relay_may_come_again(domain_id):
    data = BINARY.make(1_000_000, 1).messages[0].data
    with open_node("zenoh", options(domain_id, name="ping")) as here:
        publisher = here.create_publisher(BINARY.topic, BINARY.type_name)
        here.start()
        assert here.count_participants() == 1
        for _ in range(2):
            got, some = [], threading.Event()

            def receive(message, *_, got=got, some=some):
                got.append(message)
                some.set()

            with open_node("zenoh", options(domain_id, name="relay", listens=True)) as there:
                there.create_subscription(BINARY.topic, BINARY.type_name, receive)
                there.start()
                wait_until(some.is_set, step_s=0.1, meanwhile=lambda: publisher.publish(data))
                assert got[0] == data
                view = here.look_at(BINARY.topic)
                assert [each.node_name for each in view.publishers] == ["ping"]
                assert [(each.node_name, each.type_name) for each in view.subscriptions] == [
                    ("relay", BINARY.type_name)
                ]
                assert here.count_participants() == 2


def test_domains_stay_apart_even_at_one_address(domains):
    one, other = domains.take(), domains.take()
    got = threading.Event()
    peers = (f"127.0.0.1:{BACKEND.port_of(one)}",)
    with (
        open_node("zenoh", options(one, name="relay", listens=True)) as there,
        open_node("zenoh", options(other, name="stranger", peers=peers)) as stranger,
        open_node("zenoh", options(one, name="ping")) as here,
    ):
        there.create_subscription(IMU.topic, IMU.type_name, lambda message, *_: got.set() or seen.add(message))
        seen = set()
        there.start()
        strange = stranger.create_publisher(IMU.topic, IMU.type_name)
        ours = here.create_publisher(IMU.topic, IMU.type_name)
        wait_until(
            lambda: got.is_set() and stranger.count_participants() >= 2,
            meanwhile=lambda: (strange.publish(b"strange"), ours.publish(b"ours")),
        )
        assert stranger.look_at(IMU.topic).subscriptions == ()
    assert seen == {b"ours"}


@pytest.mark.parametrize(
    ("more", "line"),
    [
        ({"discovery": Discovery.SUBNET}, "--peer HOST"),
        ({"peers": ("multicast",)}, "--discovery subnet"),
        ({"qos": Qos(durability="transient_local")}, "keeps no message"),
        ({"qos": Qos(extra={"deadline_ns": 5})}, "-o deadline: the backend zenoh has no such"),
        ({"qos": Qos(extra={"lifespan_ns": 5})}, "-o lifespan: the backend zenoh has no such"),
    ],
)
def test_options_without_a_meaning_are_refused(domain_id, more, line):
    with pytest.raises(OptionError, match=line):
        open_node("zenoh", options(domain_id, **more))
