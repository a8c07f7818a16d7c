"""What a sink stands on gives way before any instruction: disk, folder, clock. It never raises, and no event is lost."""

import errno
import os
import shutil
import sys

import pytest
from instruction_kills import BEFORE, STAMPED_NS, acting_at, keep_earlier, open_sink
from trace_files import run

from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.reading.reader import read_trace

WRITER = "dds_trace.tracefile.writing.writer.os."
FAULTS = [errno.ENOSPC, errno.EIO, errno.EROFS]
ACTIONS = {"write_run": lambda sink: sink.write_run(run(state="started")), "close": lambda sink: sink.close()}
STRIDES = [101, pytest.param(1, marks=[pytest.mark.slow, pytest.mark.timeout(1800)])]
"""Every so many bytecodes of an action something gives way."""


def act_during(sink, action, number, act):
    """Run an action of the sink, with `act` before bytecode `number`; return whether it came that far."""
    came = []

    def note_and_act():
        came.append(number)
        act()

    before = sys.gettrace()
    sys.settrace(acting_at(number, note_and_act))
    try:
        ACTIONS[action](sink)
    finally:
        sys.settrace(before)
    return bool(came)


def sinks(folder, stride, **options):
    """Sinks that hold events, each with the number of the bytecode before which something gives way."""
    number = 0
    while True:
        path = folder / str(number) / "a.mcap"
        sink = open_sink(path, **options)
        keep_earlier(sink)
        yield number, path, sink
        number += stride


@pytest.mark.parametrize("stride", STRIDES)
@pytest.mark.parametrize("action", ACTIONS)
@pytest.mark.parametrize("fault", FAULTS, ids=errno.errorcode.get)
def test_the_disk_fails_from_any_instruction_on(tmp_path, monkeypatch, fault, action, stride):
    """All calls that change the file fail from then on, those that mend a failure too."""

    def fail(*_arguments):
        raise OSError(fault, os.strerror(fault))

    def break_disk():
        for name in ("pwritev", "pwrite", "fsync", "ftruncate"):
            monkeypatch.setattr(WRITER + name, fail)

    errors = 0
    for number, path, sink in sinks(tmp_path, stride):
        came = act_during(sink, action, number, break_disk)
        closed = sink.close()
        monkeypatch.undo()
        assert closed.events + closed.ring_events == BEFORE
        assert closed.dropped_events == 0
        assert read_trace(path).events[Stage.T1].sequence.tolist() == list(range(BEFORE))
        errors += closed.error is not None
        if not came:
            break
    assert errors > 0


@pytest.mark.parametrize("fits", [0, 1, 100])
def test_a_disk_that_fails_in_the_middle_of_a_write_and_of_its_mending(tmp_path, monkeypatch, fits):
    """Half a chunk is written, the rest fails, and so does cutting it off: the torn half is no chunk to a reader."""
    sink = open_sink(tmp_path / "a.mcap", ring_slots=8 * BEFORE)  # drained when it is told to
    keep_earlier(sink)
    size, write = (tmp_path / "a.mcap").stat().st_size, os.pwrite

    def write_some(descriptor, parts, offset):
        return write(descriptor, b"".join(parts)[:fits], offset)

    def fail(*_arguments):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with monkeypatch.context() as broken:
        broken.setattr(WRITER + "pwritev", write_some)
        broken.setattr(WRITER + "ftruncate", fail)
        broken.setattr(WRITER + "pwrite", fail)
        sink.write_run(run(state="started"))
    assert sink.error is not None
    assert (tmp_path / "a.mcap").stat().st_size == size + fits
    assert read_trace(tmp_path / "a.mcap").events[Stage.T1].sequence.tolist() == list(range(BEFORE))
    closed = sink.close()  # the disk is well again, and what was torn is written over
    assert (closed.events, closed.ring_events) == (BEFORE, 0)
    assert read_trace(tmp_path / "a.mcap").truncated is None


@pytest.mark.parametrize("stride", STRIDES)
@pytest.mark.parametrize("action", ACTIONS)
def test_the_folder_is_removed_before_any_instruction(tmp_path, action, stride):
    errors = set()
    for number, path, sink in sinks(tmp_path, stride):
        came = act_during(sink, action, number, lambda path=path: shutil.rmtree(path.parent))
        closed = sink.close()
        assert closed.events + closed.ring_events == BEFORE
        assert closed.dropped_events == 0
        errors.add("deleted or moved" in str(closed.error))
        if not came:
            break
    assert errors == {True, False}  # False: it went behind the last write


@pytest.mark.parametrize("stride", STRIDES)
@pytest.mark.parametrize("step_ns", [-STAMPED_NS, 10**15])
@pytest.mark.parametrize("action", ACTIONS)
def test_the_clock_jumps_before_any_instruction(tmp_path, action, step_ns, stride):
    """Times of events stay as they were stamped; the log times of the file never run backwards."""
    now_ns = [STAMPED_NS]
    for number, path, sink in sinks(tmp_path, stride, clock_ns=lambda: now_ns[0]):
        now_ns[0] = STAMPED_NS
        came = act_during(sink, action, number, lambda: now_ns.__setitem__(0, STAMPED_NS + step_ns))
        stamped = [sink.stamp(1, 1, BEFORE)] if action == "write_run" else []
        assert sink.close().error is None
        trace = read_trace(path)
        expected = [*range(1000, 1000 + BEFORE), *stamped]
        assert trace.events[Stage.T1].monotonic_ns.tolist() == expected
        assert trace.truncated is None
        if not came:
            break
