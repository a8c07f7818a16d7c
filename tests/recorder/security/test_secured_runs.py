from importlib.util import find_spec

import pytest
from backend_pairs import ROOMY
from processes import ping, relay

from dds_trace.base.errors import OptionError
from dds_trace.recorder.backends import load_backend, load_backends
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.choices import Security
from dds_trace.recorder.security.keys import make_keys, public_hash
from dds_trace.tracefile.reading.reader import read_trace

pytest.importorskip("cryptography")
pytestmark = pytest.mark.middleware

TLS = ["socket", *(["zenoh"] if find_spec("zenoh") else [])]
FEW = ("--messages", 20, "--warmup", 2, "--rate", 50)


@pytest.fixture
def keys(tmp_path):
    make_keys(tmp_path / "keys", Security.ENCRYPT_RTPS)
    return ("--security", "encrypt-rtps", "--keys", tmp_path / "keys")


@pytest.mark.parametrize("backend", TLS)
def test_messages_cross_in_tls_and_both_traces_say_so(domain_id, tmp_path, keys, backend):
    with relay(domain_id, tmp_path / "relay.mcap", "--backend", backend, *ROOMY, *keys) as command:
        done = ping(domain_id, tmp_path / "ping.mcap", "--backend", backend, *ROOMY, *keys, *FEW)
        assert done.status == 0, done.stderr
        assert command.stop().status == 0
    for name in ("ping", "relay"):
        path = tmp_path / f"{name}.mcap"
        session = read_trace(path).sessions[-1]
        security = session.extra["security"]
        assert security["level"] == session.extra["settings"]["security"] == "encrypt-rtps"
        assert security["keys_sha256"] == public_hash(str(tmp_path / "keys"))
        assert security["applied"].lower().startswith("tls")
        assert session.extra["not_applied"] == []
        text = session.to_json()
        assert "PRIVATE" not in text
        assert str(tmp_path) not in text.replace(str(path), "")


@pytest.mark.parametrize("backend", TLS)
@pytest.mark.parametrize("secured", ["ping", "relay"])
def test_one_side_without_security_is_named(domain_id, tmp_path, keys, backend, secured):
    of_ping, of_relay = (keys, ()) if secured == "ping" else ((), keys)
    with relay(domain_id, tmp_path / "relay.mcap", "--backend", backend, *of_relay) as command:
        done = ping(domain_id, tmp_path / "ping.mcap", "--backend", backend, *of_ping, *FEW, "--wait", 5)
        command.stop()
    assert done.status == 8
    assert ("without TLS" if secured == "ping" else "with TLS") in done.stderr
    assert "-o security" in done.stderr.partition("try:")[2]


@pytest.mark.skipif(not (find_spec("rclpy") and find_spec("zenoh")), reason="no rclpy or zenoh here")
def test_the_link_of_a_bridge_is_tls_across_domains(domains, tmp_path, keys):
    near, far = domains.take(), domains.take()
    with relay(far, tmp_path / "relay.mcap", "--backend", "ros2", *ROOMY) as command:
        across = ("--bridge", "builtin-zenoh", "--relay-domain", far, *keys)
        done = ping(near, tmp_path / "ping.mcap", "--backend", "ros2", *ROOMY, *across, *FEW)
        assert done.status == 0, done.stderr
        command.stop()
    trace = read_trace(tmp_path / "ping.mcap")
    session = trace.sessions[-1]
    assert "TLS" in session.extra["security"]["applied"]
    for program in session.extra["bridge"]["programs"]:
        assert '"keys": "KEYS"' in program["configuration"]
    assert str(tmp_path) not in str(session.extra["bridge"])


@pytest.mark.parametrize("bridge", ["builtin", "builtin-zenoh"])
def test_what_a_bridge_cannot_secure_is_refused_in_one_line(domain_id, tmp_path, sentences, bridge):
    make_keys(tmp_path / "keys", Security.SIGN)
    done = ping(
        *(domain_id, tmp_path / "ping.mcap", "--backend", "ros2", "--bridge", bridge, "--relay-domain", domain_id + 1),
        *("--security", "sign", "--keys", tmp_path / "keys"),
    )
    assert done.status == 2
    sentences(done.stderr.strip().splitlines()[-1])


@pytest.mark.parametrize("backend", load_backends(), ids=lambda backend: backend.name)
def test_every_backend_has_its_levels_and_refuses_others(backend, domain_id):
    for level in set(Security) - {Security.OFF, *backend.security}:
        with pytest.raises(OptionError, match=level.value):
            load_backend(backend.name).check(NodeOptions(domain_id=domain_id, security=level))


@pytest.mark.skipif(not find_spec("rclpy"), reason="no rclpy here")
def test_ros_2_without_plugins_is_refused_in_one_line(domain_id, tmp_path, keys):
    done = ping(domain_id, tmp_path / "ping.mcap", "--backend", "ros2", *keys, "--check")
    if done.status == 0:
        pytest.skip("this ROS 2 has security plugins")
    assert done.status == 7
    assert len([line for line in done.stderr.splitlines() if "dds-record" in line]) == 1
    assert "no security" in done.stderr
