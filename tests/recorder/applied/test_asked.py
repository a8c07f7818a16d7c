import pytest

from dds_trace.recorder.applied.asked import (
    Asked,
    ProfileRequest,
    asked_settings,
    interface_named,
    read_profile_request,
)
from dds_trace.recorder.applied.vendors import BUFFER_BYTES
from dds_trace.recorder.backends.ros2 import fastdds_profile
from dds_trace.recorder.choices import Transport

PROFILE = """\
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"><profiles>
  <transport_descriptors>
    <transport_descriptor><transport_id>a</transport_id><type>UDPv4</type>{buffers}</transport_descriptor>
    <transport_descriptor><transport_id>b</transport_id><type>SHM</type></transport_descriptor>
  </transport_descriptors>
  <participant profile_name="p" is_default_profile="{default}"><rtps>
    <userTransports>{transports}</userTransports>
    <useBuiltinTransports>false</useBuiltinTransports>
  </rtps></participant>
</profiles></dds>
"""
BUFFERS = "<receiveBufferSize>4000000</receiveBufferSize><sendBufferSize>2000000</sendBufferSize>"


def profile(*names, buffers="", default="true"):
    transports = "".join(f"<transport_id>{name}</transport_id>" for name in names)
    return PROFILE.format(buffers=buffers, default=default, transports=transports)


@pytest.mark.parametrize(
    ("text", "expected", "transport"),
    [
        (profile("a"), ProfileRequest(("udp",)), "udp"),
        (profile("b"), ProfileRequest(("shm",)), "shm"),
        (profile("a", "b"), ProfileRequest(("shm", "udp")), "default"),
        (profile("a", buffers=BUFFERS), ProfileRequest(("udp",), 4_000_000, 2_000_000), "udp"),
        (profile("a", default="false"), ProfileRequest(), "default"),
        (profile(), ProfileRequest(), "default"),
        ("<dds>", ProfileRequest(), "default"),
        ("", ProfileRequest(), "default"),
    ],
)
def test_what_a_profile_asks_for(text, expected, transport):
    assert read_profile_request(text) == expected
    assert expected.transport == transport


def test_a_profile_of_our_own_is_read_as_what_it_was_written_from():
    text = fastdds_profile.localhost_profile(Transport.UDP, 4_000_000)
    assert read_profile_request(text) == ProfileRequest(("udp",), 4_000_000, interfaces=("127.0.0.1",))
    assert read_profile_request(
        fastdds_profile.requested_profile(Transport.DEFAULT, tuned=True, is_local=False)
    ) == ProfileRequest(("udp",), 4_000_000)


SIZED = {"receive_buffer_bytes": 5000, "buffer_is_exact": True}
OVER_TCP = ("socket", "zenoh")


@pytest.mark.parametrize(
    ("vendor", "options", "expected"),
    [
        ("fastdds", {}, Asked("fastdds", 5)),
        ("fastdds", {"transport": "shm"}, Asked("fastdds", 5, "shm")),
        ("fastdds", {"tuned": True}, Asked("fastdds", 5, "udp", True, "subnet", 4_000_000)),
        ("cyclonedds", {"tuned": True}, Asked("cyclonedds", 5, "default", True, "subnet", 4_000_000)),
        ("zenoh", {"tuned": True}, Asked("zenoh", 5, tuned=True)),
        ("connext", {"tuned": True}, Asked("connext", 5, tuned=True)),
        (
            "socket",
            {"transport": "udp", "tuned": True, "discovery": "localhost"},
            Asked("socket", 5, "udp", True, "localhost", 4_000_000),
        ),
        ("socket", {"transport": "udp", "buffer_bytes": 5000}, Asked("socket", 5, "udp", **SIZED)),
        *((vendor, {"buffer_bytes": 5000}, Asked(vendor, 5, **SIZED, send_buffer_bytes=5000)) for vendor in OVER_TCP),
    ],
)
def test_options_by_vendor(vendor, options, expected):
    assert asked_settings(vendor, domain_id=5, **options) == expected


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ("", Asked("fastdds", 5)),
        ("DEFAULT", Asked("fastdds", 5)),
        ("UDPv4", Asked("fastdds", 5, "udp")),
        ("SHM?sockets_size=4MB", Asked("fastdds", 5, "shm")),
        (
            "UDPv4?sockets_size=4MB",
            Asked("fastdds", 5, "udp", receive_buffer_bytes=4_000_000, send_buffer_bytes=4_000_000),
        ),
        (
            "UDPv4?max_msg_size=1KB&sockets_size=2MiB",
            Asked("fastdds", 5, "udp", receive_buffer_bytes=2 << 20, send_buffer_bytes=2 << 20),
        ),
        ("LARGE_DATA", Asked("fastdds", 5, "large-data")),
    ],
)
def test_the_users_own_variable(value, expected):
    assert asked_settings("fastdds", domain_id=5, environment={"FASTDDS_BUILTIN_TRANSPORTS": value}) == expected


def test_the_users_profile_wins_over_the_variable_and_an_option_over_both(tmp_path):
    path = tmp_path / "mine.xml"
    path.write_text(profile("a"))
    given = {"environment": {"FASTDDS_BUILTIN_TRANSPORTS": "SHM"}, "profile": str(path)}
    assert asked_settings("fastdds", domain_id=5, **given) == Asked("fastdds", 5, "udp", profile="mine.xml")
    assert asked_settings("fastdds", domain_id=5, transport="shm", **given) == Asked("fastdds", 5, "shm")


@pytest.mark.parametrize(
    ("whitelist", "interface"),
    [
        ("<address>127.0.0.1</address>", "lo"),
        ("<interface>lo</interface>", "lo"),
        (
            '</interfaceWhiteList><interfaces><allowlist><interface name="lo"/></allowlist></interfaces><interfaceWhiteList>',
            "lo",
        ),
        ("<address>127.0.0.1</address><address>198.51.100.7</address>", ""),  # either may carry the payload
        ("<address>198.51.100.7</address>", ""),  # of no interface here
    ],
)
def test_the_interface_that_a_profile_names(tmp_path, whitelist, interface):
    path = tmp_path / "mine.xml"
    path.write_text(profile("a", buffers=f"<interfaceWhiteList>{whitelist}</interfaceWhiteList>"))
    assert asked_settings("fastdds", domain_id=5, profile=str(path)).interface == interface


def test_a_profile_that_cannot_be_read_asks_for_nothing(tmp_path):
    missing = str(tmp_path / "none.xml")
    assert asked_settings("fastdds", domain_id=5, profile=missing) == Asked("fastdds", 5, profile="none.xml")


def test_the_segment_of_a_profile_is_read_back(tmp_path):
    path = tmp_path / "mine.xml"
    path.write_text(profile("b").replace("SHM</type>", "SHM</type><segment_size>2097152</segment_size>"))
    asked = asked_settings("fastdds", domain_id=5, profile=str(path))
    assert (asked.transport, asked.segment_bytes) == ("shm", 2_097_152)


def test_the_interface_that_cyclone_is_told(tmp_path):
    def settings(*names):
        interfaces = "".join(f'<NetworkInterface name="{name}"/>' for name in names)
        return f"<CycloneDDS><Domain><General><Interfaces>{interfaces}</Interfaces></General></Domain></CycloneDDS>"

    path = tmp_path / "cyclone.xml"
    path.write_text(settings("eth1"))
    assert interface_named(settings("lo")) == "lo"
    assert interface_named(f"<CycloneDDS/>,{settings('lo')}") == "lo"
    assert interface_named(str(path)) == interface_named(path.as_uri()) == "eth1"
    assert interface_named(f"{path.as_uri()},{settings('lo')}") == ""  # two: either may carry the payload
    assert interface_named(settings("eth0", "eth1")) == interface_named("") == interface_named("<CycloneDDS/>") == ""
    asked = asked_settings("cyclonedds", domain_id=5, settings={"CYCLONEDDS_URI": settings("eth1")})
    assert asked.interface == "eth1"
    own = {"CYCLONEDDS_URI": settings("eth2")}  # rmw_cyclonedds, to whose settings the recorder adds nothing
    assert asked_settings("cyclonedds", domain_id=5, environment=own, settings={}).interface == "eth2"


def test_the_buffers_of_tuned_are_those_that_the_backends_set():
    assert BUFFER_BYTES == 4_000_000
