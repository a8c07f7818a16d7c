import threading
import time

import pytest
from backend_pairs import all_data_types, options
from processes import PATIENCE_S, record_pair
from waiting import wait_until

from dds_trace.base.errors import OptionError
from dds_trace.recorder.backends import cyclonedds, open_node
from dds_trace.recorder.backends.cyclone_settings import CYCLONE_LOOPBACK, cyclone_loopback
from dds_trace.recorder.backends.node import ROUND_S
from dds_trace.recorder.choices import Discovery
from dds_trace.recorder.payloads import IMU, data_types
from dds_trace.tracefile.format.descriptions import Qos

pytest.importorskip("cyclonedds", reason="no Cyclone DDS here")
pytestmark = pytest.mark.middleware

CYCLONE = ("--backend", "cyclonedds")


def test_all_data_types_go_there_and_back(domain_id, tmp_path):
    here, there = all_data_types(domain_id, tmp_path, "cyclonedds", "cyclonedds", has_source=True)
    for session in (here, there):
        assert (session.backend, session.vendor, session.rmw) == ("cyclonedds", "cyclonedds", None)
        versions = session.host["versions"]
        assert versions["cyclonedds"].split(".")[:2] == versions["libddsc"].split(".")[:2]
        settings = session.host["middleware"]
        assert settings["tuned"] == "false"
        assert "FragmentSize" not in settings["CYCLONEDDS_URI"]
        assert '<NetworkInterface name="lo"/>' in settings["CYCLONEDDS_URI"]


def test_tuned_is_applied_and_recorded(domain_id):
    with open_node("cyclonedds", options(domain_id, tuned=True)) as node:
        settings = node.middleware.settings
    assert settings["tuned"] == "true"
    assert "<FragmentSize>60000B</FragmentSize>" in settings["CYCLONEDDS_URI"]


def test_a_node_without_subscriptions_waits_and_does_not_spin(domain_id):
    with open_node("cyclonedds", options(domain_id)) as node:
        began_s = time.monotonic()
        node._make_round()()
    assert time.monotonic() - began_s > ROUND_S / 2


@pytest.mark.parametrize("data_type", data_types().values(), ids=lambda data_type: data_type.name)
def test_bytes_arrive_as_they_were_sent(domain_id, data_type):
    message = data_type.make(None, 1).messages[0].data
    got, some = [], threading.Event()

    def receive(*arguments):
        got.append(arguments)
        some.set()

    with open_node("cyclonedds", options(domain_id)) as node:
        node.create_subscription(data_type.topic, data_type.type_name, receive)
        publisher = node.create_publisher(data_type.topic, data_type.type_name)
        node.start()
        before_ns, deadline = time.time_ns(), time.monotonic() + PATIENCE_S
        while not some.wait(0.1):
            assert time.monotonic() < deadline
            publisher.publish(message)
        received, source_ns, *_ = got[0]
        assert received[: len(message)] == message
        assert len(received) - len(message) < 4  # filled up to whole words
        assert before_ns <= source_ns <= time.time_ns()
        assert node.error is None


def test_all_that_waits_is_handed_on_in_its_order_and_each_to_its_reader(domain_id):
    """A wait tells which readers have something; each then gives one message, and triggers again for the next."""
    messages = [IMU.make(None, seed).messages[0].data for seed in range(5)]
    got = {"one": [], "two": []}
    with (
        open_node("cyclonedds", options(domain_id)) as there,
        open_node("cyclonedds", options(domain_id, name="two")) as here,
    ):
        for topic, kept in got.items():
            there.create_subscription(topic, IMU.type_name, lambda message, *_, kept=kept: kept.append(bytes(message)))
        there.create_subscription("closed", IMU.type_name, pytest.fail).close()
        publishers = [here.create_publisher(topic, IMU.type_name) for topic in (*got, "closed")]
        wait_until(lambda: all(here.look_at(topic).subscriptions for topic in got))
        for message in messages:
            for publisher in publishers:
                publisher.publish(message)
        there.start()
        wait_until(lambda: all(len(kept) >= len(messages) for kept in got.values()))
        assert there.error is None
    assert got == {topic: [bytes(message) for message in messages] for topic in got}


def test_quality_of_service_that_never_matches_is_seen(domain_id, sentences):
    with (
        open_node("cyclonedds", options(domain_id, name="one")) as one,
        open_node("cyclonedds", options(domain_id, name="two")) as two,
    ):
        one.create_publisher(IMU.topic, IMU.type_name, qos=Qos(reliability="best_effort"))
        two.create_subscription(IMU.topic, IMU.type_name, lambda *_: None, qos=Qos(durability="transient_local"))
        wait_until(lambda: one.look_at(IMU.topic).incompatible and two.look_at(IMU.topic).incompatible)
        (line,) = one.look_at(IMU.topic).incompatible
        sentences(line)
        assert one.count_participants() == 2


def test_a_ping_that_can_never_match_says_so(domain_id, tmp_path):
    done = record_pair(domain_id, tmp_path, CYCLONE, ("--reliability", "best_effort", "--wait", PATIENCE_S))
    assert done.status == 8
    assert "reliability (best_effort offered, reliable requested)" in done.stderr


def test_late_subscriptions_get_what_transient_local_kept(domain_id):
    kept, message = Qos(durability="transient_local"), IMU.make(None, 1).messages[0].data
    got = threading.Event()
    with (
        open_node("cyclonedds", options(domain_id, qos=kept, name="one")) as one,
        open_node("cyclonedds", options(domain_id, qos=kept, name="two")) as two,
    ):
        one.create_publisher(IMU.topic, IMU.type_name).publish(message)
        two.create_subscription(IMU.topic, IMU.type_name, lambda *_: got.set())
        two.start()
        assert got.wait(PATIENCE_S)


def test_a_message_older_than_its_lifespan_is_not_delivered(domain_id):
    short = Qos(durability="transient_local", extra={"lifespan_ns": 100_000_000})
    old, new = (IMU.make(None, seed).messages[0].data for seed in (1, 2))
    got, some = [], threading.Event()

    def receive(message, *_):
        got.append(bytes(message[: len(old)]))
        some.set()

    with (
        open_node("cyclonedds", options(domain_id, qos=short, name="one")) as one,
        open_node("cyclonedds", options(domain_id, qos=short, name="two")) as two,
    ):
        publisher = one.create_publisher(IMU.topic, IMU.type_name)
        publisher.publish(old)
        time.sleep(0.2)
        two.create_subscription(IMU.topic, IMU.type_name, receive)
        two.start()
        wait_until(some.is_set, meanwhile=lambda: publisher.publish(new))
        assert set(got) == {bytes(new)}
        assert one.look_at(IMU.topic).publishers[0].qos.extra == {"lifespan_ns": 100_000_000}


def test_types_and_qualities_that_it_does_not_know_are_refused(domain_id):
    with open_node("cyclonedds", options(domain_id)) as node:
        with pytest.raises(OptionError, match="does not know the type nowhere_msgs/msg/None"):
            node.create_publisher("x", "nowhere_msgs/msg/None")
        with pytest.raises(OptionError, match="rather"):
            node.create_publisher("x", IMU.type_name, qos=Qos(reliability="rather"))


def test_a_peer_of_an_unassignable_type_is_seen(domain_id, monkeypatch, sentences):
    with open_node("cyclonedds", options(domain_id)) as one:
        one.create_publisher("imu_data", IMU.type_name)
        one.create_subscription("imu_data_relay", IMU.type_name, lambda *_: None)
        cyclonedds._message_type.cache_clear()
        monkeypatch.setitem(cyclonedds.DDS_TYPES, IMU.type_name, {"data": "string"})
        try:
            with open_node("cyclonedds", options(domain_id, name="two")) as two:
                two.create_subscription("imu_data", IMU.type_name, lambda *_: None)
                two.create_publisher("imu_data_relay", IMU.type_name)
                topics = ("imu_data", "imu_data_relay")
                wait_until(lambda: all(one.look_at(topic).unassignable for topic in topics))
                there, back = map(one.look_at, topics)
        finally:
            cyclonedds._message_type.cache_clear()
    sentences(*there.unassignable, *back.unassignable)
    assert there.incompatible == back.incompatible == ()


LOOPBACK = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface {}/></Interfaces></General></Domain></CycloneDDS>"
)


@pytest.mark.parametrize("attribute", ['name="lo"', 'address="127.0.0.1"', "priority='5' name='lo'"])
@pytest.mark.parametrize("is_file", [False, True])
def test_a_user_who_names_the_loopback_interface_is_not_told_twice(
    domain_id, tmp_path, monkeypatch, attribute, is_file
):
    path = tmp_path / "mine.xml"
    path.write_text(LOOPBACK.format(attribute))
    monkeypatch.setenv("CYCLONEDDS_URI", path.as_uri() if is_file else path.read_text())
    with open_node("cyclonedds", options(domain_id)) as node:
        settings = node.middleware.settings["CYCLONEDDS_URI"]
        assert node.count_participants() == 1
    assert settings.count("<NetworkInterface ") == (0 if is_file else 1)


def test_the_users_other_interfaces_leave_loopback_to_us():
    for own in ("", LOOPBACK.format('name="eth0"'), "file:///nowhere.xml"):
        assert cyclone_loopback(Discovery.LOCALHOST, {"CYCLONEDDS_URI": own}) == CYCLONE_LOOPBACK
        assert cyclone_loopback(Discovery.SUBNET, {"CYCLONEDDS_URI": own}) == ""
    old = "<CycloneDDS><Domain><General><NetworkInterfaceAddress>lo</NetworkInterfaceAddress></General></Domain></CycloneDDS>"
    assert cyclone_loopback(Discovery.LOCALHOST, {"CYCLONEDDS_URI": old}) == ""


def test_two_nodes_make_their_topics_one_after_the_other(monkeypatch):
    entered, most = [], []

    def slow_topic(*_):
        entered.append(1)
        most.append(len(entered))
        time.sleep(0.02)
        entered.pop()

    monkeypatch.setattr("cyclonedds.topic.Topic", slow_topic)
    nodes = [cyclonedds.CycloneNode.__new__(cyclonedds.CycloneNode) for _ in range(3)]
    for node in nodes:
        node._participant = None
    threads = [threading.Thread(target=node._topic, args=("notes", "std_msgs/msg/String")) for node in nodes]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert most == [1, 1, 1]
