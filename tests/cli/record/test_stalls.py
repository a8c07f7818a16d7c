import signal

import pytest
from middlewares import needs
from processes import relay, running
from waiting import wait_until

from dds_trace.analyzer.pipeline import analyze
from dds_trace.recorder.host.sampling import HostSampler
from dds_trace.tracefile.reading.reader import read_trace

pytestmark = pytest.mark.middleware
WARNING = "a stall of 10 ms can lose messages"


@pytest.mark.parametrize(
    ("backend", "depth", "warned"),
    [
        pytest.param("cyclonedds", 10, True, marks=needs("cyclonedds")),
        pytest.param("cyclonedds", 100, False, marks=needs("cyclonedds")),
        ("socket", 10, False),  # TCP keeps what does not fit, whatever the depth
    ],
)
def test_a_depth_below_rate_times_stall_is_warned_of_before_the_run(domain_id, tmp_path, backend, depth, warned):
    common = ("--backend", backend, "--depth", depth, "--discovery", "localhost")
    with relay(domain_id, tmp_path / "relay.mcap", *common):
        out = ("--out", tmp_path / "ping.mcap", "--domain", domain_id)
        run = ("--rate", 1000, "--messages", 20)
        with running("dds-record", "--role", "ping", *out, *common, *run) as pinging:
            done = pinging.finish()
    assert done.status == 0, done.stderr
    before = done.stderr.partition("waiting for an echo")[0]
    assert (WARNING in before) == warned
    assert done.stderr.count(WARNING) == warned


@pytest.mark.slow
def test_a_stopped_ping_is_a_finding_with_lateness_and_what_the_host_tells(domain_id, tmp_path):
    common = ("--backend", "socket", "--discovery", "localhost")
    with relay(domain_id, tmp_path / "relay.mcap", *common) as relaying:
        out = ("--out", tmp_path / "ping.mcap", "--domain", domain_id)
        run = ("--rate", 50, "--messages", 350, "--warmup", 0)
        with running("dds-record", "--role", "ping", *out, *common, *run) as pinging:
            _wait_for_samples(tmp_path / "ping.mcap", 2)
            pinging.send_signal(signal.SIGSTOP)
            _wait_for_samples(tmp_path / "relay.mcap", 4)
            pinging.send_signal(signal.SIGCONT)
            done = pinging.finish()
        stopped = relaying.stop()
    assert (done.status, stopped.status) == (0, 0), done.stderr + stopped.stderr
    host = HostSampler(lambda _sample: None).sample()["host"]
    for sample in read_trace(tmp_path / "ping.mcap").host_samples:
        assert sample["host"]["steal_ns"] >= 0
        assert sample["host"]["pressure_us"].keys() == host["pressure_us"].keys()
    (found,) = [each for each in analyze(tmp_path).findings if each.code == "stood_still"]
    assert found.what.startswith("The ping sent nothing for ")
    assert "99 % of all left" in found.what
    assert "other recordings on its machine" in found.what


def _wait_for_samples(path, more):
    """Wait until the recorder of a trace has taken so many more samples of its host, one a second."""
    enough = _samples(path) + more
    wait_until(lambda: _samples(path) >= enough, step_s=0.05)


def _samples(path):
    return len(read_trace(path).host_samples) if path.exists() else 0
