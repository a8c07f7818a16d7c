"""Each bridge's configuration against its product's documented format, field by field.

The formats: zenoh-plugin-dds 1.10 `src/config.rs` and DEFAULT_CONFIG.json5; zenoh-plugin-ros2dds DEFAULT_CONFIG.json5;
Integration Service "YAML Configuration" and "ROS 2 System Handle"; DDS Router 3 "Configuration" (v5.0) and its JSON schema;
RTI Routing Service 7 "Configuration"; domain_bridge `parse_domain_bridge_yaml_config.cpp`.
"""

import json
import re
from xml.etree import ElementTree as ET

import pytest
from ruamel.yaml import YAML

from dds_trace.base.errors import OptionError, TraceFormatError
from dds_trace.extensions.bridges import BRIDGE_MODULES
from dds_trace.extensions.bridges.base import (
    BRIDGED_TOPICS,
    BridgedTopic,
    BridgeOptions,
    Half,
    Halves,
    bridged_topic,
    load_bridge,
    split_halves,
)
from dds_trace.extensions.bridges.builtin import options_from_json
from dds_trace.extensions.bridges.texts import element, xml_text, yaml_text
from dds_trace.recorder.choices import Discovery, Transport
from dds_trace.tracefile.format.descriptions import Qos

IMAGE, STRING, IMU = ("sensor_msgs::msg::dds_::Image_", "std_msgs::msg::dds_::String_", "sensor_msgs::msg::dds_::Imu_")
BEST_EFFORT = Qos("best_effort", "transient_local", "keep_all", 7)
ONE_TOPIC = (BridgedTopic("string_data", "std_msgs/msg/String"),)


def texts(name, **options):
    bridge = load_bridge(name)
    return [bridge.configuration(part) for part in split_halves(bridge, BridgeOptions(**options))]


def from_yaml(text):
    return YAML(typ="safe").load(text)


@pytest.mark.parametrize("name", BRIDGE_MODULES)
def test_configuration_depends_on_the_options_alone(name):
    assert texts(name) == texts(name)
    assert texts(name) != texts(name, relay_domain_id=11)
    assert all(text.endswith("\n") for text in texts(name))


@pytest.mark.parametrize("name", BRIDGE_MODULES)
def test_name_of_every_bridge_is_that_of_its_row_and_its_install_text_one_line(name):
    bridge = load_bridge(name)
    assert bridge.name == name
    assert bridge.install
    assert "\n" not in bridge.install


@pytest.mark.parametrize("name", BRIDGE_MODULES)
def test_every_topic_and_its_twin_is_named_and_no_other(name):
    together = "".join(texts(name))
    for topic in BRIDGED_TOPICS:
        assert topic.name in together
    assert "binary_image" not in "".join(texts(name, topics=ONE_TOPIC))


@pytest.mark.parametrize("name", BRIDGE_MODULES)
def test_localhost_settings_are_not_in_a_configuration_for_the_subnet(name):
    here, there = "".join(texts(name, discovery=Discovery.LOCALHOST)), "".join(texts(name))
    if name not in ("integration-service", "domain_bridge"):
        assert here != there
    else:  # their ROS 2 reads it from the environment
        environment = load_bridge(name).environment(BridgeOptions(discovery=Discovery.LOCALHOST))
        assert environment == {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_LOCALHOST_ONLY": "1"}


def test_builtin_reads_back_what_it_wrote(tmp_path):
    asked = BridgeOptions(3, 4, ONE_TOPIC, BEST_EFFORT, Discovery.LOCALHOST)
    path = tmp_path / "configuration.json"
    path.write_text(load_bridge("builtin").configuration(asked))
    assert options_from_json(path) == asked


def test_a_file_that_is_no_configuration_of_ours_is_named(tmp_path):
    path = tmp_path / "configuration.json"
    path.write_text('{"ping_domain_id": 5}')
    with pytest.raises(TraceFormatError, match=r"configuration.json: is not a configuration"):
        options_from_json(path)


def test_builtin_zenoh_writes_one_half_for_each_domain():
    ping, relay = map(json.loads, texts("builtin-zenoh"))
    assert (ping["half"], ping["listen"], ping["peers"]) == ("ping", "127.0.0.1:7447", [])
    assert (relay["half"], relay["listen"], relay["peers"]) == ("relay", None, ["127.0.0.1:7447"])


def test_zenoh_bridge_dds():
    ping, relay = map(json.loads, texts("zenoh-bridge-dds", discovery=Discovery.LOCALHOST))
    assert set(ping) == {"plugins", "mode", "listen", "connect", "scouting"}
    assert ping["plugins"]["dds"]["domain"] == 5
    assert relay["plugins"]["dds"]["domain"] == 10
    for half in (ping, relay):
        # `deny_unknown_fields`: one field too many and the plugin does not start.
        assert set(half["plugins"]["dds"]) == {"domain", "localhost_only", "allow", "reliable_routes_blocking"}
        assert half["plugins"]["dds"]["localhost_only"] is True
        assert half["mode"] == "router"
        assert half["scouting"] == {"multicast": {"enabled": False}, "gossip": {"enabled": False}}
    assert ping["listen"]["endpoints"] == ["tcp/127.0.0.1:7447"]
    assert ping["connect"]["endpoints"] == []
    assert relay["listen"]["endpoints"] == []
    assert relay["connect"]["endpoints"] == ["tcp/127.0.0.1:7447"]


def test_zenoh_bridge_dds_allows_whole_names_only():
    allow = re.compile(json.loads(texts("zenoh-bridge-dds")[0])["plugins"]["dds"]["allow"])
    for topic in BRIDGED_TOPICS:
        assert allow.search(f"rt/{topic.name}")
        assert allow.search(f"rt/{topic.reply_name}")
    for other in ("rt/string_data2", "rt/my_string_data", "ros_discovery_info", "string_data", "p/rt/string_data"):
        assert not allow.search(other)


def test_a_half_on_another_device_has_its_domain_and_addresses():
    (relay,) = texts("zenoh-bridge-dds", half=Half.RELAY, peers=("192.168.0.5:7447", "10.0.0.1:7448"))
    relay = json.loads(relay)
    assert relay["plugins"]["dds"]["domain"] == 10
    assert relay["plugins"]["dds"]["localhost_only"] is False
    assert relay["connect"]["endpoints"] == ["tcp/192.168.0.5:7447", "tcp/10.0.0.1:7448"]


def test_zenoh_bridge_ros2dds():
    ping, relay = (json.loads(text)["plugins"]["ros2dds"] for text in texts("zenoh-bridge-ros2dds"))
    there = ["/binary_image", "/string_data", "/imu_data"]
    back = ["/binary_image_relay", "/string_data_relay", "/imu_data_relay"]
    assert ping["allow"] == {"publishers": there, "subscribers": back}
    assert relay["allow"] == {"publishers": back, "subscribers": there}
    assert (ping["domain"], relay["domain"]) == (5, 10)
    for half in (ping, relay):
        assert set(half) == {"nodename", "domain", "ros_localhost_only", "allow", "reliable_routes_blocking"}


@pytest.mark.parametrize(("name", "plugin"), [("zenoh-bridge-dds", "dds"), ("zenoh-bridge-ros2dds", "ros2dds")])
def test_zenohs_router_is_a_bridge_if_its_plugin_is_beside_it(name, plugin, tmp_path, monkeypatch):
    folder = tmp_path / "dds-trace" / "zenoh-bridge-dds"
    folder.mkdir(parents=True)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    bridge = load_bridge(name)
    (folder / "zenohd").touch()
    for other in {"dds", "ros2dds"} - {plugin}:
        (folder / f"libzenoh_plugin_{other}.so").touch()
    assert bridge.find() is None
    (folder / f"libzenoh_plugin_{plugin}.so").touch()
    assert bridge.find() == folder / "zenohd"
    library = f"{plugin}:{folder / f'libzenoh_plugin_{plugin}.so'}"
    assert bridge.arguments(folder / "zenohd") == ("-P", library, "-c")
    assert bridge.arguments(tmp_path / name) == ("-c",)


def test_integration_service():
    (text,) = texts("integration-service", qos=BEST_EFFORT)
    found = from_yaml(text)
    assert list(found) == ["systems", "routes", "topics"]
    assert found["systems"] == {
        "domain_5": {"type": "ros2", "domain": 5, "node_name": "dds_trace_bridge_5"},
        "domain_10": {"type": "ros2", "domain": 10, "node_name": "dds_trace_bridge_10"},
    }
    assert found["routes"] == {
        "ping_to_relay": {"from": "domain_5", "to": "domain_10"},
        "relay_to_ping": {"from": "domain_10", "to": "domain_5"},
    }
    assert set(found["topics"]) == {name for t in BRIDGED_TOPICS for name in (t.name, t.reply_name)}
    qos = {"reliability": "BEST_EFFORT", "durability": "TRANSIENT_LOCAL", "history": {"kind": "KEEP_ALL"}}
    ends = {"domain_5": {"qos": qos}, "domain_10": {"qos": qos}}
    image = {"type": "sensor_msgs/Image"}
    assert found["topics"]["binary_image"] == {**image, "route": "ping_to_relay", **ends}
    assert found["topics"]["binary_image_relay"] == {**image, "route": "relay_to_ping", **ends}


def test_ddsrouter():
    (text,) = texts("ddsrouter", qos=BEST_EFFORT, discovery=Discovery.LOCALHOST)
    found = from_yaml(text)
    assert list(found) == ["version", "allowlist", "topics", "participants"]
    assert found["version"] == "v5.0"
    assert found["allowlist"] == [
        {"name": "rt/binary_image", "type": IMAGE},
        {"name": "rt/binary_image_relay", "type": IMAGE},
        {"name": "rt/string_data", "type": STRING},
        {"name": "rt/string_data_relay", "type": STRING},
        {"name": "rt/imu_data", "type": IMU},
        {"name": "rt/imu_data_relay", "type": IMU},
    ]
    qos = {"reliability": False, "durability": True, "history-depth": 7}
    assert found["topics"] == [{**topic, "qos": qos} for topic in found["allowlist"]]
    local = {"kind": "local", "whitelist-interfaces": ["127.0.0.1"]}
    assert found["participants"] == [
        {"name": "domain_5", "domain": 5, **local},
        {"name": "domain_10", "domain": 10, **local},
    ]


@pytest.mark.parametrize(
    ("transport", "expected"),
    [(Transport.DEFAULT, None), (Transport.UDP, "udp"), (Transport.SHM, "shm"), (Transport.LARGE_DATA, None)],
)
def test_ddsrouter_has_the_transports_of_its_own(transport, expected):
    for participant in from_yaml(texts("ddsrouter", transport=transport)[0])["participants"]:
        assert participant.get("transport") == expected


@pytest.mark.parametrize(
    ("discovery", "addresses"), [(Discovery.LOCALHOST, ["127.0.0.1"]), (Discovery.SUBNET, [])], ids=str
)
def test_a_tuned_ddsrouter_has_a_profile_for_each_domain(discovery, addresses):
    (text,) = texts("ddsrouter", tuned=True, discovery=discovery)
    found = from_yaml(text)
    assert found["participants"] == [
        {"name": f"domain_{number}", "kind": "xml", "profile": f"domain_{number}"} for number in (5, 10)
    ]
    root = ET.fromstring(found["xml"]["raw"])
    profiles = root.findall(".//{*}participant")
    domains = [(profile.get("profile_name"), profile.findtext("{*}domainId")) for profile in profiles]
    assert domains == [("domain_5", "5"), ("domain_10", "10")]
    # A default profile would be the router's other participants', too.
    assert not any(profile.get("is_default_profile") for profile in profiles)
    (transport,) = root.findall(".//{*}transport_descriptor")
    assert transport.findtext("{*}type") == "UDPv4"
    assert transport.findtext("{*}receiveBufferSize") == "4000000"
    assert [address.text for address in transport.findall("{*}interfaceWhiteList/{*}address")] == addresses
    assert all(profile.findtext(".//{*}useBuiltinTransports") == "false" for profile in profiles)


def test_a_tuned_half_of_ddsrouter_has_one_profile_and_an_untouched_link():
    (relay,) = map(from_yaml, texts("ddsrouter", half=Half.RELAY, tuned=True, peers=("pi1:11666",)))
    assert [participant["kind"] for participant in relay["participants"]] == ["xml", "wan"]
    assert re.findall("<domainId>([0-9]+)<", relay["xml"]["raw"]) == ["10"]


def test_ddsrouter_as_a_half_on_each_device():
    (ping,) = map(from_yaml, texts("ddsrouter", half=Half.PING, listen="0.0.0.0:11666"))
    (relay,) = map(from_yaml, texts("ddsrouter", half=Half.RELAY, peers=("192.168.0.5:11666", "pi1:11666")))
    assert ping["participants"] == [
        {"name": "domain_5", "kind": "local", "domain": 5},
        {"name": "link", "kind": "wan", "listening-addresses": [{"ip": "0.0.0.0", "port": 11666, "transport": "tcp"}]},
    ]
    assert relay["participants"] == [
        {"name": "domain_10", "kind": "local", "domain": 10},
        {
            "name": "link",
            "kind": "wan",
            "connection-addresses": [
                {"ip": "192.168.0.5", "port": 11666, "transport": "tcp"},
                {"domain": "pi1", "port": 11666, "transport": "tcp"},
            ],
        },
    ]


def test_domain_bridge():
    (text,) = texts("domain_bridge", qos=BEST_EFFORT)
    found = from_yaml(text)
    assert list(found) == ["name", "topics"]
    qos = {"reliability": "best_effort", "durability": "transient_local", "history": "keep_all", "depth": 7}
    assert found["topics"] == {
        "binary_image": {"type": "sensor_msgs/msg/Image", "from_domain": 5, "to_domain": 10, "qos": qos},
        "string_data": {"type": "std_msgs/msg/String", "from_domain": 5, "to_domain": 10, "qos": qos},
        "imu_data": {"type": "sensor_msgs/msg/Imu", "from_domain": 5, "to_domain": 10, "qos": qos},
        "binary_image_relay": {"type": "sensor_msgs/msg/Image", "from_domain": 10, "to_domain": 5, "qos": qos},
        "string_data_relay": {"type": "std_msgs/msg/String", "from_domain": 10, "to_domain": 5, "qos": qos},
        "imu_data_relay": {"type": "sensor_msgs/msg/Imu", "from_domain": 10, "to_domain": 5, "qos": qos},
    }


def test_routing_service_routes():
    (text,) = texts("routing-service", qos=BEST_EFFORT)
    root = ET.fromstring(text)
    assert root.tag == "dds"
    service = root.find("routing_service")
    assert service.get("name") == "dds_trace"
    (route,) = service
    participants = route.findall("participant")
    assert [(p.get("name"), p.findtext("domain_id")) for p in participants] == [("domain_5", "5"), ("domain_10", "10")]
    for participant in participants:
        registered = [(t.get("name"), t.get("type_name")) for t in participant.findall("registered_type")]
        assert registered == [(name, name) for name in (IMAGE, IMU, STRING)]
    there, back = route.findall("session")
    assert (there.get("name"), back.get("name")) == ("ping_to_relay", "relay_to_ping")
    assert [r.get("name") for r in there] == ["binary_image", "string_data", "imu_data"]
    assert [r.get("name") for r in back] == ["binary_image_relay", "string_data_relay", "imu_data_relay"]
    for session, ends in ((there, ("domain_5", "domain_10")), (back, ("domain_10", "domain_5"))):
        for topic_route in session:
            source, target = topic_route
            assert (source.tag, target.tag) == ("input", "output")
            assert (source.get("participant"), target.get("participant")) == ends
            for stream in (source, target):
                assert stream.findtext("topic_name") == f"rt/{topic_route.get('name')}"
                assert stream.findtext("creation_mode") == "IMMEDIATE"
            assert [part.tag for part in source][-1] == "datareader_qos"
            assert [part.tag for part in target][-1] == "datawriter_qos"


def test_routing_service_quality_of_service():
    (text,) = texts("routing-service", qos=BEST_EFFORT, topics=ONE_TOPIC)
    route = ET.fromstring(text).find("routing_service/domain_route/session/topic_route")
    for qos in (route.find("input/datareader_qos"), route.find("output/datawriter_qos")):
        assert qos.findtext("reliability/kind") == "BEST_EFFORT_RELIABILITY_QOS"
        assert qos.findtext("durability/kind") == "TRANSIENT_LOCAL_DURABILITY_QOS"
        assert qos.findtext("history/kind") == "KEEP_ALL_HISTORY_QOS"
        assert qos.findtext("history/depth") == "7"
    assert route.findtext("output/datawriter_qos/publish_mode/kind") == "ASYNCHRONOUS_PUBLISH_MODE_QOS"
    assert route.findtext("input/registered_type_name") == STRING


DURATIONS = Qos(extra={"deadline_ns": 20_000_000, "lifespan_ns": 1_500_000_000})


@pytest.mark.parametrize("name", ["builtin", "builtin-zenoh"])
def test_our_own_bridges_take_over_deadline_and_lifespan(name, tmp_path):
    text, *_ = texts(name, qos=DURATIONS)
    (tmp_path / "options.json").write_text(text)
    assert options_from_json(tmp_path / "options.json").qos == DURATIONS


def test_deadline_and_lifespan_in_each_product_that_has_them():
    found = from_yaml(texts("domain_bridge", qos=DURATIONS)[0])["topics"]["imu_data"]["qos"]
    assert (found["deadline"], found["lifespan"]) == (20_000_000, 1_500_000_000)

    found = from_yaml(texts("integration-service", qos=DURATIONS)[0])["topics"]["imu_data"]["domain_5"]["qos"]
    assert found["deadline"] == {"sec": 0, "nanosec": 20_000_000}
    assert found["lifespan"] == {"sec": 1, "nanosec": 500_000_000}

    route = ET.fromstring(texts("routing-service", qos=DURATIONS)[0]).find(".//topic_route")
    for qos in (route.find("input/datareader_qos"), route.find("output/datawriter_qos")):
        assert [qos.findtext(f"deadline/period/{unit}") for unit in ("sec", "nanosec")] == ["0", "20000000"]
    duration = route.find("output/datawriter_qos/lifespan/duration")
    assert [duration.findtext(unit) for unit in ("sec", "nanosec")] == ["1", "500000000"]
    assert route.find("input/datareader_qos/lifespan") is None


@pytest.mark.parametrize("name", BRIDGE_MODULES)
def test_durations_that_were_not_asked_for_are_in_no_configuration(name):
    assert not re.search("deadline|lifespan", "".join(texts(name)))


def test_a_router_without_deadlines_refuses_one():
    with pytest.raises(OptionError, match="--deadline: ddsrouter"):
        texts("ddsrouter", qos=DURATIONS)


def test_further_topics_are_written_as_name_and_type():
    points = BridgedTopic("data_sensor_msgs_PointCloud2", "sensor_msgs/msg/PointCloud2")
    assert bridged_topic("data_sensor_msgs_PointCloud2:sensor_msgs/msg/PointCloud2") == points
    assert bridged_topic("/data_sensor_msgs_PointCloud2:sensor_msgs/msg/PointCloud2") == points
    for text in ("points", "points:PointCloud2", "a b:x/msg/Y", ":x/msg/Y", "points:x/srv/Y"):
        with pytest.raises(OptionError, match="write NAME:TYPE"):
            bridged_topic(text)


@pytest.mark.parametrize("name", ["imu_data", "imu_data_relay"])
def test_a_topic_that_would_cross_twice_is_refused(name):
    again = BridgedTopic(name, "sensor_msgs/msg/Imu")
    with pytest.raises(OptionError, match=f"the topic {name} would cross the bridge both ways, or twice"):
        BridgeOptions(topics=(*BRIDGED_TOPICS, again))


def test_routing_service_knows_the_types_in_an_order_that_can_be_read():
    (text,) = texts("routing-service")
    defined = set()
    for package in ET.fromstring(text).find("types"):
        for struct in package.iter("struct"):
            for member in struct:
                if member.get("type") == "nonBasic":
                    assert member.get("nonBasicTypeName") in defined
            defined.add(f"{package.get('name')}::msg::dds_::{struct.get('name')}")
    assert {IMAGE, STRING, IMU} <= defined


def test_routing_service_knows_the_types_of_every_native_backend():
    (text,) = texts("routing-service", topics=(BridgedTopic("points", "sensor_msgs/msg/PointCloud2"),))
    (points,) = ET.fromstring(text).findall(".//struct[@name='PointCloud2_']")
    members = {member.attrib.pop("name"): member.attrib for member in points}
    assert members["header"] == {"type": "nonBasic", "nonBasicTypeName": "std_msgs::msg::dds_::Header_"}
    assert members["fields"] == {
        "type": "nonBasic",
        "nonBasicTypeName": "sensor_msgs::msg::dds_::PointField_",
        "sequenceMaxLength": "-1",
    }
    assert members["data"] == {"type": "byte", "sequenceMaxLength": "-1"}
    assert members["is_dense"] == {"type": "boolean"}


def test_routing_service_leaves_types_that_it_does_not_know_to_discovery():
    (text,) = texts("routing-service", topics=(BridgedTopic("tf", "tf2_msgs/msg/TFMessage"),))
    root = ET.fromstring(text)
    assert root.find("types") is None
    assert root.findtext(".//registered_type_name") == "tf2_msgs::msg::dds_::TFMessage_"


@pytest.mark.parametrize("name", [n for n in BRIDGE_MODULES if load_bridge(n).halves is Halves.NEVER])
def test_a_bridge_of_one_program_refuses_halves(name):
    for wanted in ({"half": Half.PING}, {"listen": "0.0.0.0:7447"}, {"peers": ("pi1:7447",)}):
        with pytest.raises(OptionError, match="has no halves"):
            texts(name, **wanted)


def test_a_half_without_an_address_would_wait_for_ever():
    with pytest.raises(OptionError, match="would never meet the other one"):
        texts("zenoh-bridge-dds", half=Half.RELAY)


def test_an_address_alone_means_the_pings_half():
    (text,) = texts("zenoh-bridge-dds", peers=("pi2:7447",))
    assert json.loads(text)["plugins"]["dds"]["domain"] == 5


@pytest.mark.parametrize("address", ["pi1", "pi1:", ":7447", "pi1:http", "pi1:0", "pi1:70000"])
def test_a_wrong_address_is_refused(address):
    with pytest.raises(OptionError, match="write HOST:PORT"):
        BridgeOptions(peers=(address,))


@pytest.mark.parametrize(("ping", "relay"), [(5, 5), (-1, 10), (5, 233)])
def test_domains_that_cannot_be_joined_are_refused(ping, relay):
    with pytest.raises(OptionError):
        BridgeOptions(ping, relay)


def test_no_topic_leaves_a_domain_and_comes_back_under_the_same_name():
    for half in Half:
        for side in BridgeOptions(half=half, listen="a:1").sides():
            assert not set(side.takes) & set(side.puts)


@pytest.mark.parametrize(
    "value",
    [
        {"a": "plain", "b": "", "c": "yes", "d": "5", "e": "a: b", "f": 'quo"te', "g": "#no comment", "h": "Ünï"},
        {"n": 5, "t": True, "none": None, "list": ["x", 1, {"deep": [1, 2]}, ["y"]], "empty": {}, "nil": []},
    ],
)
def test_yaml_text_reads_back_as_the_value(value):
    assert from_yaml(yaml_text(value)) == value


def test_xml_text_is_escaped():
    text = xml_text(element("a", "<b>&", c='"'))
    assert text == '<?xml version="1.0" encoding="UTF-8"?>\n<a c="&quot;">&lt;b&gt;&amp;</a>\n'
