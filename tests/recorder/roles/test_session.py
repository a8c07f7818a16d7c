from __future__ import annotations

import pytest

from dds_trace.recorder.choices import Discovery
from dds_trace.recorder.roles.session import default_connectivity

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
