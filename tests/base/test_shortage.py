"""A process with little room ends with one line and a code, whatever library meets the limit first."""

import resource
import sys
from contextlib import suppress
from pathlib import Path
from uuid import uuid4

import pytest
from processes import executed

from dds_trace.base.shortage import MEMORY, Room, shortage

SAMPLES = Path(__file__).parents[2] / "sample_traces"


def chained(error, cause):
    try:
        raise error from cause
    except type(error) as raised:
        return raised


@pytest.mark.parametrize(
    ("error", "word"),
    [
        (MemoryError(), MEMORY),
        (OSError(24, "Too many open files"), "ulimit -n"),
        (OSError(12, "Cannot allocate memory"), MEMORY),
        (RuntimeError("can't start new thread"), "ulimit -u"),
        (ImportError("libx.so: failed to map segment from shared object"), MEMORY),
        (
            chained(RuntimeError("cannot join thread before it is started"), RuntimeError("can't start new thread")),
            "thread",
        ),
        (type("PanicException", (BaseException,), {})("Os { code: 11, Resource temporarily unavailable }"), "thread"),
        (OSError(2, "No such file"), ""),
        (ValueError("can't start new thread"), ""),
    ],
)
def test_what_a_process_was_short_of_is_named(error, word):
    assert word in shortage(error)
    assert bool(word) == bool(shortage(error))


COMMANDS = {
    "analyze": ("analyze", SAMPLES / "same_domain", "--out", "out"),
    "bag": ("bag", SAMPLES / "same_domain", "--out", "out"),
    "compare": ("compare", SAMPLES / "same_domain", SAMPLES / "losses"),
    "recover": ("recover", SAMPLES / "same_domain", "--out", "out"),
    "relay": ("record", "relay", "--backend", "socket", "--duration", "1", "--out", "relay.mcap"),
    "sweep": ("sweep", "plan.toml", "--dry-run"),
    "doctor": ("doctor",),
}


def ran(folder, words, before):
    return executed([sys.executable, "-m", "dds_trace", *words], cwd=folder, preexec_fn=before)


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(("kind", "value"), [("RLIMIT_AS", 300 << 20), ("RLIMIT_AS", 700 << 20), ("RLIMIT_NOFILE", 12)])
def test_a_command_without_room_ends_with_one_line_and_leaves_nothing(tmp_path, command, kind, value):
    run = ran(tmp_path, COMMANDS[command], lambda: resource.setrlimit(getattr(resource, kind), (value, value)))
    assert (run.returncode, run.stdout, len(run.stderr.splitlines())) == (1, "", 1), run.stderr
    assert "ulimit" in run.stderr
    assert not list(tmp_path.iterdir())


PIDS = (Path("/sys/fs/cgroup/pids"), Path("/sys/fs/cgroup"))


@pytest.fixture
def few_threads():
    """The list of processes of a control group in which as many threads can be started as its limit says."""
    group = None
    for folder in PIDS:
        with suppress(OSError):
            group = folder / f"dds-trace-{uuid4().hex}"
            group.mkdir()
            (group / "pids.max").write_text("6")
            break
        with suppress(OSError):
            group.rmdir()
        group = None
    if group is None:
        pytest.skip("no control group of processes can be made here (a writable /sys/fs/cgroup)")
    yield group / "cgroup.procs"
    group.rmdir()


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_that_can_start_no_thread_ends_with_one_line_and_leaves_nothing(tmp_path, command, few_threads):
    run = ran(tmp_path, COMMANDS[command], lambda: few_threads.write_text("0"))
    assert (run.returncode, run.stdout, len(run.stderr.splitlines())) == (1, "", 1), run.stderr
    assert "ulimit -u" in run.stderr
    assert not list(tmp_path.iterdir())


def test_descriptors_are_raised_where_they_may_be(tmp_path):
    run = ran(tmp_path, COMMANDS["recover"], lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (12, 100)))
    assert run.returncode == 0, run.stderr
    assert "ulimit" not in run.stderr  # an old numpy may warn


def test_a_room_without_limits_is_there():
    Room(address_bytes=1 << 20, threads=1).check()
