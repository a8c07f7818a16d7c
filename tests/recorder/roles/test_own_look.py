"""What both sides see of themselves before they blame the other one or a firewall; the printed cures are tried."""

import re
import socket

import psutil
import pytest
from middlewares import needs
from processes import RunningCommand
from two_devices import needs_devices

from dds_trace.extensions.campaigns.station.emulation import INTERFACE, ip
from dds_trace.extensions.campaigns.station.namespaces import NamespacePair
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.backends.ros2 import installation
from dds_trace.recorder.backends.ros2.fastdds_profile import profile_xml
from dds_trace.recorder.choices import Discovery
from dds_trace.recorder.kernel import sockets

WHITELIST = profile_xml("a whitelist", {"udp": {"type": "UDPv4", "interfaceWhiteList": {"address": "{}"}}}, {})


def causes(variables, rmw="rmw_fastrtps_cpp", **options):
    node = NodeOptions(5, "own", **{"discovery": Discovery.SUBNET, **options})
    return [*installation.own_causes(node, rmw, variables)]


def test_variables_that_keep_a_node_from_others_are_named(sentences, monkeypatch):
    monkeypatch.setattr(sockets, "ASK_S", 0.2)
    assert causes({}) == causes({"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}) == []
    given = {"ROS_DISCOVERY_SERVER": "TCPv4:[127.0.0.1]:9;", "ROS_SUPER_CLIENT": "TRUE"}
    (server,) = causes(given)
    assert causes(given, rmw="rmw_cyclonedds_cpp") == []
    (other,) = causes({"RMW_IMPLEMENTATION": "rmw_zenoh_cpp"}, rmw="rmw_zenoh_cpp")
    *_, ignored = causes({"ROS_STATIC_PEERS": "127.0.0.1"}, discovery=Discovery.LOCALHOST, tuned=True)
    sentences(server, other, ignored)


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_whether_anything_has_the_port_of_a_server_or_peer_is_asked(monkeypatch, host):
    monkeypatch.setattr(sockets, "ASK_S", 0.3)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as there:
        there.bind(("127.0.0.1", 0))
        port = there.getsockname()[1]
        monkeypatch.setattr(installation, "domain_port_range", lambda _: range(port - 10, port + 1))
        given = [{"ROS_DISCOVERY_SERVER": f"{host}:{port}"}, {"ROS_STATIC_PEERS": f"{host};"}]
        assert not any("reached" in said for variables in given for said in causes(variables))
    refused = f"UDP port {port} of {host} cannot be reached (Connection refused)"
    assert all(refused in causes(variables)[0] for variables in given)
    assert "of no-such-host.invalid cannot be reached" in causes({"ROS_STATIC_PEERS": "no-such-host.invalid"})[0]


def test_a_whitelist_is_named_if_it_cannot_reach_the_other(tmp_path, monkeypatch):
    variable = installation.fast_dds().profile_variables[0]
    path = tmp_path / "mine.xml"
    path.write_text(WHITELIST.format("192.0.2.9"))
    assert "the profile mine.xml only has 192.0.2.9" in causes({variable: str(path)})[0]
    path.write_text(WHITELIST.format("127.0.0.1"))
    assert causes({variable: str(path)}) == []
    path.write_text(WHITELIST.format(next(name for name in psutil.net_if_addrs() if name != "lo")))
    monkeypatch.setattr(installation, "fast_dds", lambda: installation.FAST_DDS_3)
    monkeypatch.setattr(installation, "_MACHINE_ID", str(tmp_path / "machine-id"))
    assert causes({variable: str(path)}) == []
    (tmp_path / "machine-id").write_text("0123456789abcdef0123456789abcdef\n")
    assert "machine-id (here 01234567...)" in causes({variable: str(path)})[0]


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


SERVER = {"ROS_DISCOVERY_SERVER": "127.0.0.1:11999", "ROS_SUPER_CLIENT": "TRUE"}
GONE, HERE = ({installation.fast_dds().profile_variables[0]: name} for name in ("gone.xml", "here.xml"))


@pytest.mark.keeps(1)
@pytest.mark.middleware
@needs("ros2")
@needs_devices
@pytest.mark.parametrize(
    ("side", "variables", "says"),
    [
        *((side, SERVER, "ROS_DISCOVERY_SERVER is 127.0.0.1:11999 here, and UDP port") for side in ("ping", "relay")),
        *((side, GONE, "the whitelist of the profile gone.xml only has 192.0.2.9") for side in ("ping", "relay")),
        *(("ping", {"ROS_STATIC_PEERS": host}, f"ROS_STATIC_PEERS is {host} here, and UDP port")
          for host in ("10.213.0.99", "10.213.0.2")),
        *((side, HERE, "the profile here.xml has a whitelist, with which Fast DDS 3 meets no other") for side in ("ping", "relay")
          if installation.fast_dds() is installation.FAST_DDS_3),
    ],
)  # fmt: skip
def test_a_setting_that_keeps_a_side_from_the_other_is_the_first_line(
    tmp_path, domain_id, monkeypatch, side, variables, says
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "gone.xml").write_text(WHITELIST.format("192.0.2.9"))
    both = ("--backend", "ros2", "--domain", domain_id, "--discovery", "subnet")
    with NamespacePair(None, hosts=2) as pair:
        sides, peers = {"ping": pair.ping, "relay": pair.relays[1]}, {}  # none is in pair.relay
        into = {name: own.prefix for name, own in sides.items()}
        if variables is HERE:
            (tmp_path / "here.xml").write_text(WHITELIST.format(sides[side].address))
            (tmp_path / "id").write_text("11111111111111111111111111111111\n")
            one_id = ("sh", "-c", 'mount --bind "$0" /etc/machine-id && exec "$@"', tmp_path / "id")
            into = {name: [*prefix, *one_id] for name, prefix in into.items()}
        if "ROS_STATIC_PEERS" in variables:
            peers = {"ROS_STATIC_PEERS": sides["relay"].address}
            for port in ("port0", "port1", "port2"):
                ip("-n", pair._switch, "link", "set", port, "type", "bridge_slave", "mcast_flood", "off")
        assert_first_and_cured(tmp_path, both, into, side, {**peers, **variables}, peers, says)


@pytest.mark.middleware
@needs("ros2")
def test_a_static_peer_that_is_no_host_is_named(tmp_path, domain_id):
    both = ("--backend", "ros2", "--domain", domain_id)
    done = ping_of(both, tmp_path / "ping.mcap", (), ROS_STATIC_PEERS="no-such-host.invalid")
    assert (done.status, "ROS_STATIC_PEERS is no-such-host.invalid" in done.stderr) == (7, True), done.stderr


@pytest.mark.keeps(1)
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
        into = {"ping": pair.ping.prefix, "relay": pair.relay.prefix}
        commands = "link add b0 type veth peer name b1; addr add 203.0.113.1/24 dev b0; link set b0 up; link set b1 up"
        for command in commands.split(";"):
            ip("-n", getattr(pair, side).namespace, *command.split())
        said = assert_first_and_cured(tmp_path, both, into, side, wrong, right, says)
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
