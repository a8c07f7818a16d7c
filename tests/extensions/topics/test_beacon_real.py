import re
import threading

import pytest
from middlewares import needs, skip_without
from waiting import PATIENCE_S, wait_until

from dds_trace.analyzer.pipeline import analyze
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.choices import Discovery
from dds_trace.recorder.errors import NothingHeardError
from dds_trace.recorder.options import RecordOptions
from dds_trace.recorder.recording import record
from dds_trace.tracefile.reading.reader import read_trace
from dds_trace.tracefile.writing.destination import TraceDestination

pytestmark = pytest.mark.middleware
ENOUGH = 10


class Beacon:
    def __init__(self, path, backend, domain_id):
        node = NodeOptions(domain_id=domain_id, discovery=Discovery.LOCALHOST)
        self.options = RecordOptions(
            TraceDestination(path), node, beacon_rate_hz=5.0, backend=backend, own_cost=False, device=path.stem
        )
        self.stop, self.notes, self.last, self.result = threading.Event(), [], None, None
        self._thread = threading.Thread(target=self._record)
        self._thread.start()

    def _record(self):
        self.result = record(self.options, self.stop, self)

    def note(self, text):
        self.notes.append(text)

    def progress(self, progress):
        self.last = progress

    @property
    def has_enough(self):
        return self.last is not None and self.last.received >= ENOUGH and bool(self.last.clocks)

    def end(self):
        self.stop.set()
        self._thread.join(PATIENCE_S)
        return self.result


@pytest.mark.parametrize("backends", [("ros2", "ros2"), ("ros2", "cyclonedds")])
def test_two_beacons_compare_their_clocks(tmp_path, domain_id, backends):
    skip_without(*backends)
    beacons = [
        Beacon(tmp_path / f"{name}.mcap", backend, domain_id)
        for name, backend in zip(("alpha", "beta"), backends, strict=True)
    ]
    try:
        wait_until(lambda: all(beacon.has_enough for beacon in beacons))
    finally:
        for beacon in beacons:
            beacon.stop.set()
        results = [beacon.end() for beacon in beacons]
    for result, other in zip(results, ("beta", "alpha"), strict=True):
        assert result.error is None
        (line,) = result.progress.clocks
        assert line.startswith(f"{other}: your clocks differ by")
        difference_ms, bound_ms = (float(number) for number in re.findall(r"\d+\.\d+", line)[:2])
        assert difference_ms <= bound_ms + 0.1  # one machine has one clock
        assert {session.role for session in read_trace(result.trace.path).sessions} == {"ping", "relay"}
    groups = analyze(tmp_path).summary.to_dicts()
    pairs = {(group["ping_device"], group["relay_device"]) for group in groups}
    assert pairs == {("alpha", "beta"), ("beta", "alpha")}


@needs("cyclonedds")
def test_a_beacon_alone_says_so(tmp_path, domain_id, sentences):
    beacon = Beacon(tmp_path / "alone.mcap", "cyclonedds", domain_id)
    wait_until(lambda: beacon.last is not None)
    result = beacon.end()
    assert isinstance(result.error, NothingHeardError)
    sentences(str(result.error).replace(str(domain_id), "DOMAIN"))
    assert not list(tmp_path.iterdir())  # the next try may have the name
