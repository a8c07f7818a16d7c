import hashlib
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest
from arm import needs_arm, unpack
from processes import ping

from dds_trace.analyzer.pipeline import analyze

pytestmark = [pytest.mark.slow, needs_arm, pytest.mark.timeout(1200)]

WRITER = Path(__file__).parents[1] / "support" / "arm_writer.py"
FILES = ("events.mcap", "events.mcap.ring")


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return unpack(tmp_path_factory.mktemp("arm"))


@contextmanager
def relay_on(arm, domain_id, path, *more):
    command = [*arm.words, "-m", "dds_trace.cli.record", "--role", "relay", "--domain", domain_id, "--out", path]
    command += ["--discovery", "localhost", "--no-own-cost", *more]
    with subprocess.Popen(list(map(str, command)), env=arm.environment, stderr=subprocess.PIPE, text=True) as process:
        try:
            said = ""
            while "serves" not in said:
                line = process.stderr.readline()
                assert line, said  # it ended
                said += line
            yield
        finally:
            process.terminate()
            process.communicate()


@pytest.mark.middleware
@pytest.mark.parametrize("backend", ["socket", "zenoh"])
def test_a_relay_on_arm64_and_a_ping_on_this_machine_are_analyzed_together(arm, domain_id, tmp_path, backend):
    with relay_on(arm, domain_id, tmp_path / "relay.mcap", "--backend", backend):
        done = ping(
            *(domain_id, tmp_path / "ping.mcap", "--backend", backend, "--discovery", "localhost", "--wait", 120),
            *("--size", 1000, "--messages", 100, "--warmup", 10, "--rate", 20),
        )
        assert done.status == 0, done.stderr
    analysis = analyze(tmp_path)
    assert analysis.summary["received"].to_list() == [100]
    assert analysis.summary["intermediate_p50_ns"][0] > 0
    machines = {session.role: session.host["machine"] for session in analysis.sessions}
    assert machines["relay"] == "aarch64"


def test_equal_events_are_equal_bytes(arm, tmp_path):
    digests = {}
    for name, run in (("here", None), ("arm", arm)):
        folder = tmp_path / name
        folder.mkdir()
        if run is None:
            subprocess.run([sys.executable, str(WRITER), str(folder)], check=True)
        else:
            run.run(WRITER, folder)
        digests[name] = {file: hashlib.sha256((folder / file).read_bytes()).hexdigest() for file in FILES}
    assert digests["here"] == digests["arm"]
