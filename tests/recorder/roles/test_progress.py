import dataclasses
from pathlib import Path

import pytest

from dds_trace.base.errors import OptionError
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.base_recording import default_connectivity
from dds_trace.recorder.choices import Discovery, Serialization
from dds_trace.recorder.options import PingOptions, RecordOptions
from dds_trace.recorder.payloads import IMU, header_data_type
from dds_trace.recorder.roles.plan import plan_run
from dds_trace.recorder.roles.progress import Replies, Silence
from dds_trace.tracefile.writing.destination import TraceDestination


def sent(*publish_ns):
    replies = Replies(len(publish_ns))
    for sequence, t1_ns in enumerate(publish_ns):
        replies.publish_ns[sequence] = t1_ns
    return replies


def test_before_any_reply():
    replies = sent(1000, 2000)
    assert (replies.received, replies.highest, replies.last_ns, replies.longest_rtt_ns) == (0, -1, 0, 0)
    assert replies.percentiles_ns() == (None, None)
    assert not replies.are_complete(2)
    assert replies.are_complete(0)  # nothing was sent, nothing is missing


def test_the_first_reply_to_a_message_makes_its_round_trip():
    replies = sent(1000, 2000, 3000)
    replies.note(2, 7, 3400)
    replies.note(0, 7, 3500)
    replies.note(0, 8, 9000)  # of another relay, later
    assert (replies.received, replies.highest) == (2, 2)
    assert (replies.last_ns, replies.longest_rtt_ns) == (9000, 2500)
    assert replies.percentiles_ns() == (400, 2500)


def test_it_is_complete_when_every_relay_that_answered_has_answered_all():
    replies = sent(1000, 2000)
    replies.note(0, 7, 1100)
    replies.note(0, 7, 1200)  # once more: one answer still
    assert not replies.are_complete(2)
    replies.note(1, 7, 2100)
    assert replies.are_complete(2)
    replies.note(1, 8, 2200)
    assert not replies.are_complete(2)


SECOND_NS = 1_000_000_000


@pytest.mark.parametrize(
    ("messages", "seconds", "before", "answered", "is_lasting"),
    [
        (0, 60, 100, 100, False),  # the last message was answered
        (100, 2.9, 100, 100, False),  # too short
        (4, 4, 100, 100, True),  # not one of 100 was lost before
        (2, 4, 100, 100, False),  # two in a row may be chance
        (10, 10, 100, 10, False),  # 90 % lost: ten in a row are nothing special
        (150, 10, 100, 10, True),
        (10, 10, 0, 0, False),  # nothing was answered, and not much was sent
        (20, 10, 0, 0, True),
    ],
)
def test_a_silence_is_lasting_if_the_losses_before_it_do_not_explain_it(
    messages, seconds, before, answered, is_lasting
):
    assert Silence(messages, int(seconds * SECOND_NS), before, answered).is_lasting is is_lasting


def test_a_round_trip_within_a_step_of_the_clock_counts_once():
    replies = sent(1000, 2000)
    replies.note(0, 7, 1000)
    replies.note(0, 8, 1004)
    assert (replies.received, replies.received_of(slice(1)), replies.percentiles_ns()) == (1, 1, (0, 0))


ROUTES = """\
Iface	Destination	Gateway 	Flags	RefCnt	Use	Metric	Mask		MTU	Window	IRTT
eth1	0001A8C0	00000000	0001	0	0	100	00FFFFFF	0	0	0
wlan0	00000000	0101A8C0	0003	0	0	600	00000000	0	0	0
"""


@pytest.fixture
def root(tmp_path):
    (tmp_path / "proc/net").mkdir(parents=True)
    (tmp_path / "proc/net/route").write_text(ROUTES)
    return tmp_path


def test_localhost_is_loopback_whatever_the_routes_say(root):
    assert default_connectivity(Discovery.LOCALHOST, root) == "loopback"


def test_the_interface_of_the_default_route_decides(root):
    assert default_connectivity(Discovery.SUBNET, root) == "wired"
    (root / "sys/class/net/wlan0/wireless").mkdir(parents=True)
    assert default_connectivity(Discovery.SUBNET, root) == "wireless"


def test_a_system_without_routes_is_wired(tmp_path):
    assert default_connectivity(Discovery.SUBNET, tmp_path) == "wired"


@pytest.mark.parametrize(("interfaces", "connectivity"), [("lo", "loopback"), ("lo eth0", "wired")])
def test_a_namespace_without_another_interface_is_loopback(root, interfaces, connectivity):
    (root / "proc/net/route").write_text(ROUTES.splitlines()[0] + "\n")
    (root / "proc/self/net").mkdir(parents=True)
    lines = ["", "", *(f"{name}: {'0 ' * 16}" for name in interfaces.split())]
    (root / "proc/self/net/dev").write_text("\n".join(lines) + "\n")
    assert default_connectivity(Discovery.SUBNET, root) == connectivity


MADE = IMU.make(None, 1)
RECORDED = dataclasses.replace(MADE, rate_hz=30.0, source="bag:x#/imu")


def planned(payload=MADE, duration_s=None, serialization=Serialization.RAW, **asked):
    options = RecordOptions(
        TraceDestination(Path("x.mcap")), NodeOptions(), serialization=serialization, duration_s=duration_s
    )
    return plan_run(options, PingOptions(**asked), payload, session_id=0xAB, seed=4)


@pytest.mark.parametrize(
    ("payload", "asked", "rate_hz", "messages"),
    [
        (MADE, {}, 10.0, 1000),
        (RECORDED, {}, 30.0, 1000),
        (RECORDED, {"rate_hz": 7.0}, 7.0, 1000),
        (MADE, {"duration_s": 10, "rate_hz": 50}, 50, 490),
        (RECORDED, {"duration_s": 10}, 30.0, 290),
        (MADE, {"duration_s": 10, "messages": 5}, 10.0, 5),
        (MADE, {"duration_s": 0.1, "rate_hz": 1}, 1, 1),
    ],
)
def test_rate_and_count(payload, asked, rate_hz, messages):
    plan = planned(payload, **asked)
    assert (plan.rate_hz, plan.messages) == (rate_hz, messages)


def test_the_trace_says_where_the_data_is_from():
    assert planned().extra == {"session_id": "00000000000000ab", "seed": 4, "settings": {}}
    assert planned(RECORDED).extra == {"session_id": "00000000000000ab", "data_source": "bag:x#/imu", "settings": {}}
    assert planned(bridge="builtin", bridge_running=True).extra["bridge_running"] is True


def test_data_that_cannot_be_sent_is_refused():
    live = dataclasses.replace(RECORDED, feed=object())
    with pytest.raises(OptionError, match="--rate cannot be given with topic:/NAME"):
        planned(live, rate_hz=5.0)
    other = dataclasses.replace(MADE, data_type=header_data_type("sensor_msgs/msg/PointCloud2"))
    with pytest.raises(OptionError, match="-o serialization=typed: sensor_msgs/msg/PointCloud2"):
        planned(other, serialization=Serialization.TYPED)
