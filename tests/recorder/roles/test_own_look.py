"""What a ping sees of itself before it blames the other side or a firewall; the printed cures are tried."""

import re
import socket
from types import SimpleNamespace

import pytest
from middlewares import needs
from namespaces import needs_namespaces, network_with
from processes import RunningCommand

from dds_trace.recorder.backends.ros2 import installation
from dds_trace.recorder.choices import Discovery
from dds_trace.recorder.domains import domain_port_range
from dds_trace.recorder.kernel.sockets import Socket, TcpState, read_sockets
from dds_trace.recorder.roles import own_look

WHITELIST = """<dds><profiles><transport_descriptors><transport_descriptor><transport_id>u</transport_id><type>UDPv4</type>
<interfaceWhiteList><address>{}</address></interfaceWhiteList></transport_descriptor></transport_descriptors>
<participant profile_name="p" is_default_profile="true"><rtps><userTransports><transport_id>u</transport_id></userTransports>
</rtps></participant></profiles></dds>"""


def causes(variables, discovery=Discovery.SUBNET, rmw="rmw_fastrtps_cpp"):
    return [*installation.own_causes(rmw, discovery, variables)]


def test_variables_that_keep_a_node_from_others_are_named(sentences):
    assert causes({}) == causes({"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp", "ROS_STATIC_PEERS": "127.0.0.1"}) == []
    given = {"ROS_DISCOVERY_SERVER": "192.0.2.1:11811;192.0.2.2", "ROS_SUPER_CLIENT": "TRUE"}
    (server,) = causes(given)
    assert "nothing on this machine" not in server  # it may be on another one
    assert causes(given, rmw="rmw_cyclonedds_cpp") == []
    (peers,) = causes({"ROS_STATIC_PEERS": "192.0.2.1,192.0.2.2"})
    (local,) = causes({"ROS_STATIC_PEERS": "192.0.2.1"}, Discovery.LOCALHOST)
    (other,) = causes({"RMW_IMPLEMENTATION": "rmw_zenoh_cpp"}, rmw="rmw_zenoh_cpp")
    sentences(server, peers, local, other)


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


def test_a_port_of_this_process_that_another_has_too_is_named(domain_id):
    port = domain_port_range(domain_id)[-1]
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as two,
    ):
        for opened in (one, two):
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            opened.bind(("127.0.0.1", port))
        sockets = read_sockets()
        assert [*own_look._shared_ports(domain_id, sockets)] == []
        (said,) = own_look._shared_ports(domain_id, [read for read in sockets if read.inode != _inode(two)])
        assert f"UDP port {port}" in said


def _inode(opened):
    return int(re.search(r"\d+", str(own_look.os.readlink(f"/proc/self/fd/{opened.fileno()}")))[0])


@pytest.mark.parametrize(("retransmitted", "says"), [(0, False), (7, True)])
def test_a_connection_that_sends_again_and_again_is_named(retransmitted, says):
    tcp = TcpState(retransmitted=retransmitted, acked_bytes=1234)
    read = Socket("tcp", "ipv4", "127.0.0.1", 5000, "127.0.0.1", 5001, 1, 1, tcp=tcp)
    said = [*own_look._stuck_connections([read])]
    assert bool(said) is says
    assert not said or ("1,234 bytes were acknowledged" in said[0] and "(65535 here)" in said[0])


def test_one_of_several_interfaces_is_named_with_the_variable_that_names_another(monkeypatch):
    address = {"eth0": "192.0.2.1", "wlan0": "198.51.100.1", "lo": "127.0.0.1"}
    inet = socket.AF_INET
    monkeypatch.setattr(
        own_look.psutil,
        "net_if_addrs",
        lambda: {name: [SimpleNamespace(family=inet, address=text)] for name, text in address.items()},
    )
    monkeypatch.setattr(own_look.psutil, "net_if_stats", lambda: dict.fromkeys(address, SimpleNamespace(isup=True)))

    def said(*opened, vendor="cyclonedds"):
        sockets = [Socket("udp", "ipv4", text, 7410, "0.0.0.0", 0, 1, 1) for text in ("0.0.0.0", *opened)]
        return [*own_look._one_of_several_interfaces(vendor, sockets)]

    assert said() == said("192.0.2.1", "198.51.100.1") == []
    assert 'NetworkInterface name="wlan0"' in said("192.0.2.1")[0]
    assert "CYCLONEDDS" not in said("192.0.2.1", vendor="fastdds")[0]


@pytest.mark.middleware
@needs("cyclonedds")
@needs_namespaces("ip", "iproute2")
def test_the_printed_interface_cures_a_ping_on_the_wrong_one(tmp_path, domain_id):
    second = (
        ("link", "add", "b0", "type", "veth", "peer", "name", "b1"),
        ("addr", "add", "203.0.113.1/24", "dev", "b0"),
        *(("link", "set", name, "up") for name in ("b0", "b1")),
    )
    sides = ("--backend", "cyclonedds", "--domain", domain_id, "--discovery", "subnet")
    with network_with("a0", *second) as into:

        def ping(name, **variables):
            sent = ("--role", "ping", *sides, "--messages", 5, "--size", "1KB", "-o", "wait=6")
            command = RunningCommand(
                "dds-record", *sent, "--out", tmp_path / f"{name}.mcap", environment=variables, prefix=into
            )
            return command.finish()

        text = ping("alone", CYCLONEDDS_URI="").stderr
        found = re.search(r"try: .* through the interface a0 only, and has b0, too: .*CYCLONEDDS_URI='([^']+)'", text)
        relay = RunningCommand(
            "dds-record", "--role", "relay", *sides, "--out", tmp_path / "relay.mcap",
            environment={"CYCLONEDDS_URI": found[1]}, prefix=into,
        )  # fmt: skip
        relay.wait_for_line("serves domain")
        done = ping("named", CYCLONEDDS_URI=found[1])
        relay.stop()
    assert done.status == 0, done.stderr
