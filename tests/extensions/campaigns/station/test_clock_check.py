import sys
from types import SimpleNamespace

import pytest

from dds_trace.base.errors import BackendUnavailableError
from dds_trace.extensions.campaigns.sweep import MARK, OWN_TRACE, SEGMENT, compare_clocks

LINE = "jetson: your clocks differ by 1.234 ms +- 0.021 (that one shows the later time; chrony: follows ntp1)"
BEACON = (
    f"import sys; open(sys.argv[sys.argv.index('--out') + 1], 'w'); print({LINE!r}, file=sys.stderr); print('Wrote')"
)


class Device:
    def __init__(self, error=None):
        self.error, self.started, self.stopped, self.discarded = error, [], 0, []

    def prepare(self):
        if self.error:
            raise self.error

    def start(self, arguments, segment):
        self.started.append((arguments, segment))
        return self

    def stop(self):
        self.stopped += 1

    def discard(self, segment):
        self.discarded.append(segment)


def compare(tmp_path, device, backend="cyclonedds", program=BEACON):
    notes = []
    plan = SimpleNamespace(
        cells=[SimpleNamespace(backend=backend, environment="")],
        run=SimpleNamespace(domain=12),
        discovery="subnet",
        hosts=(),
    )
    station = SimpleNamespace(device=device, ping_command=[sys.executable, "-c", program])
    compare_clocks(plan, station, tmp_path, notes.append)
    return notes


def test_the_user_reads_how_the_clocks_differ(tmp_path):
    device = Device()
    assert compare(tmp_path, device) == [LINE]
    ((arguments, segment),) = device.started
    assert arguments[:2] == ["--role", "beacon"]
    assert arguments[arguments.index("--domain") + 1] == "12"
    assert (segment, device.stopped, device.discarded) == (SEGMENT, 1, [SEGMENT])
    assert not list(tmp_path.rglob(OWN_TRACE))


@pytest.mark.parametrize("program", ["raise SystemExit('no other beacon answered')", "pass"])
def test_a_beacon_without_an_answer_stops_no_sweep(tmp_path, program):
    device = Device()
    (note,) = compare(tmp_path, device, program=program)
    assert "not compared" in note
    assert device.stopped == 1


def test_a_device_that_cannot_be_reached_is_left_to_the_sweep(tmp_path):
    (note,) = compare(tmp_path, Device(BackendUnavailableError("jetson: no route")))
    assert "no route" in note


def test_backends_that_need_an_address_have_no_check(tmp_path):
    device = Device()
    assert compare(tmp_path, device, backend="socket") == []
    assert not device.started


def test_all_pairs_of_several_devices_are_compared(tmp_path):
    class Hosts(Device):
        def start(self, arguments, segment):
            name = arguments[arguments.index("--device") + 1]
            other = {"left": "right", "right": "left"}[name]
            (tmp_path / ".parts" / f"{segment}.log").write_text(f"{other}: {MARK} by 2 ms\n")
            return super().start(arguments, segment)

    notes = []
    hosts = [SimpleNamespace(name=name, ssh=f"pi@{name}") for name in ("left", "right")]
    plan = SimpleNamespace(
        cells=[SimpleNamespace(backend="cyclonedds", environment="")],
        run=SimpleNamespace(domain=12),
        discovery="subnet",
        hosts=hosts,
    )
    program = BEACON.replace("jetson", "left")
    station = SimpleNamespace(device=(device := Hosts()), ping_command=[sys.executable, "-c", program])
    compare_clocks(plan, station, tmp_path, notes.append)
    assert notes[:2] == [LINE.replace("jetson", "left"), f"seen from left: right: {MARK} by 2 ms"]
    assert notes[2].startswith("right: ")  # did not answer
    assert [segment for _, segment in device.started] == [SEGMENT, "0-0-0.2-1.mcap"]
    assert device.stopped == 2
