"""What both sides see of themselves before they blame the other one or a firewall; the printed cures are tried."""

import re
import socket

import pytest
from middlewares import needs
from namespaces import needs_namespaces, network_with
from processes import RunningCommand
from two_devices import needs_devices

from dds_trace.extensions.campaigns.station.emulation import INTERFACE, ip
from dds_trace.extensions.campaigns.station.namespaces import NamespacePair
from dds_trace.recorder.backends.ros2 import installation

WHITELIST = """<dds><profiles><transport_descriptors><transport_descriptor><transport_id>u</transport_id><type>UDPv4</type>
<interfaceWhiteList><address>{}</address></interfaceWhiteList></transport_descriptor></transport_descriptors>
<participant profile_name="p" is_default_profile="true"><rtps><userTransports><transport_id>u</transport_id></userTransports>
<useBuiltinTransports>false</useBuiltinTransports></rtps></participant></profiles></dds>"""


def causes(variables, rmw="rmw_fastrtps_cpp"):
    return [*installation.own_causes(rmw, variables)]


def test_variables_that_keep_a_node_from_others_are_named(sentences):
    assert causes({}) == causes({"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}) == []
    given = {"ROS_DISCOVERY_SERVER": "192.0.2.1:11811;192.0.2.2", "ROS_SUPER_CLIENT": "TRUE"}
    (server,) = causes(given)
    assert "nothing on this machine" not in server  # it may be on another one
    assert causes(given, rmw="rmw_cyclonedds_cpp") == []
    (other,) = causes({"RMW_IMPLEMENTATION": "rmw_zenoh_cpp"}, rmw="rmw_zenoh_cpp")
    sentences(server, other)


def test_a_server_here_is_looked_for():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{server.getsockname()[1]}"
        assert "nothing on this machine" not in causes({"ROS_DISCOVERY_SERVER": address})[0]
    assert "nothing on this machine" in causes({"ROS_DISCOVERY_SERVER": address})[0]


def test_a_whitelist_without_an_address_of_this_machine_is_named(tmp_path):
    variable = installation.fast_dds().profile_variables[0]
    path = tmp_path / "mine.xml"
    path.write_text(WHITELIST.format("192.0.2.9"))
    assert "the profile mine.xml only has 192.0.2.9" in causes({variable: str(path)})[0]
    path.write_text(WHITELIST.format("127.0.0.1"))
    assert causes({variable: str(path)}) == []


def start(role, both, out, into, **variables):
    command = ("dds-record", "--role", role, *both, "--out", out, "--force")
    return RunningCommand(*command, environment=variables, prefix=into)


def relay_of(*arguments, **variables):
    relay = start("relay", *arguments, **variables)
    relay.wait_for_line("serves domain")
    return relay


def ping_of(both, *arguments, **variables):
    return start("ping", (*both, "--messages", 5, "--size", "33KB", "-o", "wait=6"), *arguments, **variables).finish()


def first_line(done):
    assert done.status == 8, done.stderr
    return re.search(r"^  try: (.*)$", done.stderr, re.MULTILINE)[1]


def assert_first_and_cured(folder, both, into, side, wrong, right, says):
    """One side has the variables of `wrong`, the other those of `right`; then both have the latter."""
    at = {"ping": right, "relay": right, side: wrong}
    relay = relay_of(both, folder / "relay.mcap", into["relay"], **at["relay"])
    if side == "relay":
        relay.wait_for_line(f"nothing reached this relay yet: {says}")
    said = first_line(ping_of(both, folder / "ping.mcap", into["ping"], **at["ping"]))
    if side == "relay":
        relay.stop()
        says = f"at the relay (process {relay.pid}, {both[1]}): {says}"
        relay = relay_of(both, folder / "again.mcap", into["relay"], **right)
    done = ping_of(both, folder / "ping.mcap", into["ping"], **right)
    relay.stop()
    assert said.startswith(says)
    assert done.status == 0, done.stderr
    return said


@pytest.mark.middleware
@needs("ros2")
@needs_namespaces("ip", "iproute2")
@pytest.mark.parametrize("side", ["ping", "relay"])
@pytest.mark.parametrize(
    ("variables", "says"),
    [
        ({"ROS_DISCOVERY_SERVER": "127.0.0.1:11999", "ROS_SUPER_CLIENT": "TRUE"}, "ROS_DISCOVERY_SERVER is 127.0.0.1:11999"),
        ({installation.fast_dds().profile_variables[0]: "gone.xml"}, "the whitelist of the profile gone.xml only has 192.0.2.9"),
    ],
)  # fmt: skip
def test_a_setting_that_keeps_a_side_from_the_other_is_the_first_line(
    tmp_path, domain_id, monkeypatch, variables, says, side
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "gone.xml").write_text(WHITELIST.format("192.0.2.9"))
    both = ("--backend", "ros2", "--domain", domain_id, "--discovery", "subnet")
    with network_with("a0") as into:
        assert_first_and_cured(tmp_path, both, dict.fromkeys(("ping", "relay"), into), side, variables, {}, says)


@pytest.mark.middleware
@needs("cyclonedds")
@needs_devices
@pytest.mark.parametrize("side", ["ping", "relay"])
def test_the_printed_interface_cures_a_side_on_the_wrong_one(tmp_path, domain_id, side):
    both = ("--backend", "cyclonedds", "--domain", domain_id, "--discovery", "subnet")
    named = '<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="{}"/></Interfaces></General></Domain></CycloneDDS>'
    wrong, right = ({"CYCLONEDDS_URI": uri} for uri in (named.format("b0"), named.format(INTERFACE)))
    says = f"this process sends through the interface b0 only, and has {INTERFACE}, too: "
    with NamespacePair(None) as pair:
        into = {"ping": pair.ping, "relay": pair.relay}
        for command in (
            ("link", "add", "b0", "type", "veth", "peer", "name", "b1"),
            ("addr", "add", "203.0.113.1/24", "dev", "b0"),
            *(("link", "set", name, "up") for name in ("b0", "b1")),
        ):
            ip("-n", into[side].namespace, *command)
        prefixes = {name: each.prefix for name, each in into.items()}
        said = assert_first_and_cured(tmp_path, both, prefixes, side, wrong, right, says)
    assert f"CYCLONEDDS_URI='{right['CYCLONEDDS_URI']}'" in said


@pytest.mark.middleware
@needs_devices
def test_a_path_that_drops_large_packets_is_the_first_line_and_a_smaller_mtu_cures_it(tmp_path, domain_id):
    both = ("--backend", "socket", "--domain", domain_id, "--discovery", "subnet")
    with NamespacePair(None, hosts=2) as pair:
        # A bridge drops frames that are too large for a port, and reports it to nobody.
        ip("-n", pair._switch, "link", "set", "port1", "mtu", "1000")
        ip("-n", pair.ping.namespace, "link", "set", INTERFACE, "gso_max_segs", "1")
        relay = relay_of(both, tmp_path / "relay.mcap", pair.relay.prefix)
        ping = (*both, "--peer", pair.relay.address), tmp_path / "ping.mcap", pair.ping.prefix
        said = first_line(ping_of(*ping))
        ip("-n", pair.ping.namespace, "link", "set", INTERFACE, "mtu", "1000")
        done = ping_of(*ping)
        relay.stop()
    assert f"the connection to {pair.relay.address}" in said
    assert "(1500 here)" in said
    assert done.status == 0, done.stderr
