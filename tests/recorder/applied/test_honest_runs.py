"""Runs whose settings are applied raise no difference, on any backend: one of each, and fifty-seven for `just test-slow`."""

from dataclasses import dataclass
from itertools import product

import pytest
from applied_pair import needs_large_buffers, run_pair
from middlewares import skip_without
from namespaces import needs_namespaces, network_with

pytestmark = pytest.mark.middleware

SIZES_BYTES = (33_000, 145_000, 502_000)


@dataclass(frozen=True)
class Honest:
    """Settings that are applied.

    Attributes:
        paths: what may have carried the payload; without `unknown`, the run has a network namespace of its own, as loopback
            counts what other programs send.
        max_bytes: payload above which this transport loses messages.
    """

    backend: str
    transport: str = "default"
    tuned: bool = False
    discovery: str = "localhost"
    paths: tuple[str, ...] = ("lo", "unknown")
    max_bytes: int = 1 << 30

    @property
    def is_apart(self):
        return self.discovery == "subnet" or "unknown" not in self.paths

    @property
    def name(self):
        return "-".join((self.backend, self.transport, self.discovery, *(["tuned"] * self.tuned)))


MEMORY = ("shm", "unknown")
HONEST = [
    Honest("ros2", paths=MEMORY),
    Honest("ros2", "udp"),
    Honest("ros2", "udp", tuned=True),
    Honest("ros2", tuned=True),
    Honest("ros2", "shm", paths=MEMORY),
    Honest("ros2", "large-data", paths=MEMORY),
    Honest("ros2", discovery="subnet", paths=MEMORY),
    Honest("ros2", "udp", discovery="subnet"),
    Honest("ros2", "udp", tuned=True, discovery="subnet"),
    Honest("ros2", "large-data", discovery="subnet", paths=MEMORY),
    Honest("cyclonedds"),
    Honest("cyclonedds", tuned=True),
    Honest("zenoh", paths=MEMORY),
    Honest("zenoh", tuned=True, paths=MEMORY),
    Honest("zenoh", "shm", paths=("shm",)),
    Honest("zenoh", "tcp", paths=("lo",)),
    Honest("socket"),
    Honest("socket", "udp", max_bytes=145_000),  # more datagrams than the system's buffer holds are lost
    Honest("socket", "udp", tuned=True),
]


@pytest.fixture(scope="module")
def subnet():
    with network_with("link0", ("route", "add", "224.0.0.0/4", "dev", "link0")) as inside:
        yield inside


@pytest.fixture
def run(domain_id, request):
    def honest(case, payload_bytes, **more):
        skip_without(case.backend)
        options = {
            "transport": case.transport,
            "tuned": case.tuned,
            "discovery": case.discovery,
            "payload_bytes": min(payload_bytes, case.max_bytes),
            **more,
        }
        if case.is_apart:
            return run_pair(case.backend, domain_id, **options, prefix=request.getfixturevalue("subnet"))
        return run_pair(case.backend, domain_id, **options)

    return honest


def assert_honest(case, sides):
    for side in sides:
        assert side.at_begin == [], case.name
        assert side.at_end == [], case.name
        assert side.traffic.received > 0
        assert side.applied.path in case.paths, case.name


def named(case):
    needs = [needs_namespaces("ip", "iproute2")] if case.is_apart else []
    needs += [needs_large_buffers] if case.tuned else []
    return pytest.param(case, id=case.name, marks=needs)


@pytest.mark.keeps(3)
@pytest.mark.parametrize("case", [named(case) for case in HONEST])
def test_what_is_applied_is_no_difference(run, case):
    assert_honest(case, run(case, SIZES_BYTES[-1]))


@needs_namespaces("ip", "iproute2")
def test_zenoh_sends_small_messages_through_shared_memory_too_if_asked(run):
    case = Honest("zenoh", "shm", paths=("shm",))
    assert_honest(case, run(case, 1000, messages=1500, period_s=0.0))


@pytest.mark.slow
@pytest.mark.timeout(1800)
@needs_namespaces("ip", "iproute2")
@needs_large_buffers
def test_fifty_honest_runs_raise_none(run):
    runs = list(product(SIZES_BYTES, HONEST))
    assert len(runs) == 57
    for payload_bytes, case in runs:
        assert_honest(case, run(case, payload_bytes, messages=60))  # 2 MB of payload in the smallest
