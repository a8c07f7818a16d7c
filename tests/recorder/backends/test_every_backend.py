import subprocess
import sys
from contextlib import contextmanager

import pytest
from middlewares import PACKAGES, skip_without
from processes import PATIENCE_S, ping, record_pair, relay, running
from waiting import wait_until

from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.recorder.backends import load_backend
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.choices import Discovery, ExecutorKind
from dds_trace.recorder.payloads.imu import IMU
from dds_trace.recorder.roles.lanes import message_objects_of

pytestmark = pytest.mark.middleware


@contextmanager
def open_pair(backend, domain_id):
    """A node that subscribes and one that publishes, which are one node where nodes receive their own messages."""
    skip_without(backend)
    executor = ExecutorKind.SINGLE if backend == "ros2" else ExecutorKind.AUTO
    options = NodeOptions(domain_id=domain_id, discovery=Discovery.LOCALHOST, executor=executor)
    receiver, sender = load_backend(backend).open_pair(options)
    with receiver, sender:
        yield receiver, sender


@pytest.mark.parametrize("backend", PACKAGES)
def test_an_error_in_a_callback_is_kept(backend, domain_id):
    def fail(*_):
        raise OSError("ours")  # which a connection that breaks raises, too

    with open_pair(backend, domain_id) as (receiver, sender):
        receiver.create_subscription(IMU.topic, IMU.type_name, fail)
        publisher = sender.create_publisher(IMU.topic, IMU.type_name)
        for node in {receiver, sender}:
            node.start()
        data = IMU.make(None, 1, None).messages[0].data
        wait_until(lambda: receiver.error is not None, step_s=0.05, meanwhile=lambda: publisher.publish(data))
        assert str(receiver.error) == "ours"


@pytest.mark.parametrize("backend", PACKAGES)
def test_endpoints_and_nodes_may_be_closed_twice(backend, domain_id):
    with open_pair(backend, domain_id) as (receiver, sender):
        publisher = sender.create_publisher(IMU.topic, IMU.type_name)
        subscription = receiver.create_subscription(IMU.topic, IMU.type_name, lambda *_: None)
        receiver.start()
        publisher.close()
        for _ in range(2):
            subscription.close()
        receiver.close()


@pytest.mark.parametrize("backend", [name for name in PACKAGES if name != "ros2"])
def test_message_objects_are_refused(backend, domain_id):
    line = f"the backend {backend} only carries serialized messages"
    with open_pair(backend, domain_id) as (node, _), pytest.raises(OptionError, match=line):
        message_objects_of(node)


@pytest.mark.parametrize(
    ("backend", "line"),
    [
        ("ros2", "rclpy is not installed; pip install 'dds-trace[ros2]'"),
        ("cyclonedds", "Cyclone DDS cannot be loaded"),
        ("zenoh", "Zenoh cannot be loaded"),
    ],
)
def test_without_its_package_it_says_how_to_get_it(backend, line):
    code = (
        f"import sys; sys.modules['{PACKAGES[backend]}'] = None\n"
        "from dds_trace.recorder.backends.node import NodeOptions\n"
        "from dds_trace.recorder.choices import Discovery\n"
        "from dds_trace.recorder.backends import open_node\n"
        "from dds_trace.base.errors import BackendUnavailableError\n"
        f"try: open_node('{backend}', NodeOptions(discovery=Discovery.LOCALHOST))\n"
        "except BackendUnavailableError as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=PATIENCE_S)
    assert line in done.stdout
    assert f"pip install 'dds-trace[{backend}]'" in done.stdout
    assert ("setup.bash" in done.stdout) is (backend == "ros2")


@pytest.mark.parametrize("backend", ["ros2", "cyclonedds"])
def test_a_ping_and_a_relay_meet_in_the_last_domain(backend, domains, tmp_path):
    skip_without(backend)
    last = domains.wait_for(limits.LAST_DOMAIN)
    options = ("--backend", backend, "--depth", 1000)
    done = record_pair(last, tmp_path, options, ("--messages", 20, "--warmup", 2, "--rate", 50))
    assert done.status == 0, done.stderr
    assert "ports for 63 participants" in done.stderr
    assert "received 20, lost 0" in done.stdout + done.stderr


@pytest.mark.parametrize("backend", ["zenoh", "socket"])
def test_a_second_relay_of_the_domain_is_one_line(backend, domain_id, tmp_path):
    skip_without(backend)
    command = ("dds-record", "--role", "relay", "--domain", domain_id, "--backend", backend)
    with (
        relay(domain_id, tmp_path / "one.mcap", "--backend", backend),
        running(*command, "--out", tmp_path / "two.mcap") as second,
    ):
        done = second.finish()
    assert done.status == 2
    assert "one relay for each domain" in done.stderr


@pytest.mark.parametrize("backend", ["zenoh", "socket"])
def test_a_ping_without_a_relay_names_what_it_looked_for(backend, domain_id, tmp_path):
    skip_without(backend)
    done = ping(domain_id, tmp_path / "ping.mcap", "--backend", backend, "--wait", 1)
    assert done.status == 8
    assert "saw: 0 other nodes" in done.stderr
    assert not (tmp_path / "ping.mcap").exists()
