import pytest
from middlewares import skip_without
from two_devices import needs_devices, two_devices

from dds_trace.tracefile.reading.reader import read_trace

pytestmark = [pytest.mark.middleware, needs_devices]

PING, RELAY = "192.168.0.10", "192.168.0.20"
MESSAGES, WARMUP = 20, 3


@pytest.fixture(scope="module")
def network(tmp_path_factory):
    with two_devices(tmp_path_factory.mktemp("devices"), PING, RELAY) as (pair, devices):
        yield pair, devices


@pytest.fixture
def meet(network, request):
    """Runs a relay on one device and a ping on the other; each is given by its backend and further options."""
    _, devices = network

    def run(ping, relay):
        skip_without(ping[0], relay[0])
        name = f"{request.node.name}.mcap"
        common = ("--depth", 1000, "--out", name, "--backend")
        relaying = devices["relay"].start("dds-record", "--role", "relay", *common, *relay)
        try:
            relaying.wait_for_line("serves domain")
            pinging = devices["ping"].start(
                *("dds-record", "--role", "ping", *common, *ping, "--data", "imu", "--wait", 60),
                *("--messages", MESSAGES, "--warmup", WARMUP, "--rate", 50),
            )
            request.addfinalizer(pinging.clean_up)
            done = pinging.finish()
            assert done.status == 0, done.stderr
            assert relaying.stop().status == 0
        finally:
            relaying.clean_up()
        trace = read_trace(devices["ping"].folder / name)
        assert trace.runs[0].published == MESSAGES + WARMUP
        assert f"received {MESSAGES}, lost 0" in done.stdout

    return run


@pytest.mark.keeps(1)
@pytest.mark.parametrize(("ping", "relay"), [("ros2", "cyclonedds"), ("cyclonedds", "ros2")])
def test_dds_looks_on_the_network(meet, ping, relay):
    meet((ping,), (relay,))


@pytest.mark.parametrize(("backend", "reliability"), [("zenoh", "reliable"), ("socket", "best_effort")])
def test_zenoh_and_sockets_connect_to_the_address_given(meet, backend, reliability):
    same = ("--reliability", reliability, *(("--transport", "udp") if reliability == "best_effort" else ()))
    meet((backend, "--peer", RELAY, *same), (backend, "--discovery", "subnet", *same))


def test_zenoh_looks_on_the_network_if_both_say_so(meet):
    meet(("zenoh", "--peer", "multicast"), ("zenoh", "--peer", "multicast"))
