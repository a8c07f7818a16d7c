import socket

from dds_trace.recorder.choices import Discovery
from dds_trace.recorder.wire.capture import run_interfaces


def test_localhost_discovery_keeps_to_loopback():
    assert run_interfaces(Discovery.LOCALHOST) == ("lo",)


def test_subnet_discovery_uses_all_that_are_up_and_no_port_of_a_bridge(tmp_path, monkeypatch):
    names = [name for _, name in socket.if_nameindex()]
    monkeypatch.setattr(socket, "if_nameindex", lambda: [(1, "lo"), (2, "nowhere0")])
    assert "lo" in names
    assert run_interfaces(Discovery.SUBNET, tmp_path) == ("lo",)
    (tmp_path / "lo" / "master").mkdir(parents=True)
    assert run_interfaces(Discovery.SUBNET, tmp_path) == ()
