from __future__ import annotations

import pytest

from dds_trace.base.errors import OptionError
from dds_trace.recorder.backends import BACKEND_MODULES, installed_middlewares, load_backend, load_backends
from dds_trace.recorder.backends.base import Meeting
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.choices import Discovery, ExecutorKind, Security, Transport

LOCAL = {"domain_id": 3, "discovery": Discovery.LOCALHOST}


@pytest.mark.parametrize("name", BACKEND_MODULES)
def test_the_facts_of_a_backend_fit_together(name):
    backend = load_backend(name)
    assert backend.name == name
    assert (backend.relay_port is not None) is (backend.meeting is Meeting.PEERS)
    assert ("{port}" in backend.meeting_needs) is (backend.relay_port is not None)
    assert ("{dds_backends}" in backend.meeting_needs) is backend.speaks_dds
    assert Transport.DEFAULT in backend.transports


def test_relays_of_two_backends_share_no_port():
    ports = [backend.relay_port for backend in load_backends() if backend.relay_port is not None]
    assert len(set(ports)) == len(ports)
    assert all(2 <= port < 10 for port in ports)  # DDS participants use 0, 1 and those from 10 on


@pytest.mark.parametrize("name", BACKEND_MODULES)
@pytest.mark.parametrize(
    ("more", "is_known", "line"),
    [
        ({"domain_id": 233}, lambda _: False, "--domain 233: a DDS domain id must be between 0 and 232"),
        ({"rmw": "rmw_x"}, lambda backend: backend.has_ros, "--rmw rmw_x: the backend {} has no ROS middleware"),
        ({"executor": ExecutorKind.SINGLE}, lambda backend: backend.has_ros, "--executor single: the backend {}"),
        (
            {"transport": Transport.SHM},
            lambda backend: Transport.SHM in backend.transports,
            "--transport shm: the backend {} only has default",
        ),
        (
            {"peers": ("pi4",)},
            lambda backend: backend.meeting is not Meeting.DISCOVERY,
            "--peer pi4: the backend {} discovers",
        ),
    ],
)
def test_an_option_without_a_meaning_is_refused_and_named(name, more, is_known, line):
    backend, options = load_backend(name), NodeOptions(**{**LOCAL, **more})
    if is_known(backend):
        backend.check(options)
    else:
        with pytest.raises(OptionError, match=line.format(name)):
            backend.check(options)


@pytest.mark.parametrize("name", ["ros2", "cyclonedds"])
def test_a_secured_domain_is_one_that_the_governance_covers(name):
    backend, secured = load_backend(name), {**LOCAL, "security": Security.SIGN}
    backend.check(NodeOptions(**{**secured, "domain_id": 230}))
    with pytest.raises(OptionError, match="at most 230"):
        backend.check(NodeOptions(**{**secured, "domain_id": 231}))


def test_the_relays_address_is_this_device_unless_given():
    backend = load_backend("socket")
    port = 7400 + 250 * 3 + 8
    assert backend.peer_addresses(NodeOptions(**LOCAL)) == (("127.0.0.1", port),)
    told = NodeOptions(domain_id=3, peers=("pi4", "10.0.0.2:99"))
    assert backend.peer_addresses(told) == (("pi4", port), ("10.0.0.2", 99))
    with pytest.raises(OptionError, match="the backend socket does not look for relays on the network"):
        backend.peer_addresses(NodeOptions(domain_id=3))


def test_each_rmw_of_an_installation_is_a_middleware_and_connext_needs_a_licence(tmp_path, monkeypatch):
    index = tmp_path / "share/ament_index/resource_index/rmw_typesupport"
    index.mkdir(parents=True)
    for name in ("rmw_fastrtps_cpp", "rmw_cyclonedds_cpp"):
        (index / name).touch()
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path}")
    monkeypatch.delenv("RTI_LICENSE_FILE", raising=False)
    monkeypatch.setattr("dds_trace.recorder.backends.ros2.installation.has_package", lambda name: name == "rclpy")
    found = installed_middlewares()
    assert [pair for pair in found if pair[0] == "ros2"] == [
        ("ros2", "rmw_cyclonedds_cpp"),
        ("ros2", "rmw_fastrtps_cpp"),
    ]
    assert ("socket", None) in found
    assert ("connext", None) not in found
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    assert ("ros2", None) in installed_middlewares()
    monkeypatch.setattr("dds_trace.recorder.backends.ros2.installation.has_package", lambda _: False)
    assert "ros2" not in dict(installed_middlewares())
