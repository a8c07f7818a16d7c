"""Worker processes: the same numbers, and none of them left, whatever ends the analysis or one of them."""

import functools
import os
import re
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import psutil
import pytest
from campaigns import assert_same_results, write_runs
from waiting import wait_until

import dds_trace.analyzer.engines.batches
from dds_trace.analyzer.cache import traces
from dds_trace.analyzer.engines import local, processes
from dds_trace.analyzer.engines.processes import can_start_workers
from dds_trace.analyzer.pipeline import analyze
from dds_trace.base.errors import TraceError, TraceFormatError
from dds_trace.tracefile.format.events import EventColumns

PATIENCE_S = 60

# Each batch, one a group, is a worker process that sleeps; it says which one it is.
COMMAND = """
import sys
import dds_trace.analyzer.engines.batches
from dds_trace.analyzer.engines import local, processes

def start(*arguments, **options):
    workers = started(*arguments, **options)
    submit = workers.submit
    sleep = "import os, time; os.write(1, str(os.getpid()).encode() + bytes([10])); time.sleep(300)"
    workers.submit = lambda do, job, *more: submit(*((exec, sleep) if job is processes.Worker.process else (do, job, *more)))
    return workers

def assign_worker(workers):
    workers._thread_local.do = workers._do_elsewhere

started, processes.start_workers = processes.start_workers, start
processes.Workers._assign_worker = assign_worker
dds_trace.analyzer.engines.batches.BATCH_EVENTS = local.FILES_FOR_PROCESSES = 1
local.is_large = lambda batch: False
local.LocalEngine._processes = 3
from dds_trace.cli.analyze import main
sys.argv = ["dds-analyze", *sys.argv[1:]]
main()
"""


@pytest.fixture
def started(monkeypatch):
    """From here on, each analysis is made by this process and two others; the ones that were started."""
    begun = []
    real = processes.start_workers

    def start(*arguments, **options):
        workers = real(*arguments, **options)
        begun.extend(psutil.Process(pid) for pid in workers._processes)
        return workers

    monkeypatch.setattr(local, "FILES_FOR_PROCESSES", 1)
    monkeypatch.setattr(local.LocalEngine, "_processes", 3)
    monkeypatch.setattr(processes, "start_workers", start)
    return begun


@pytest.fixture
def nothing_here(monkeypatch):
    """The other processes do all jobs."""

    def assign_worker(workers):
        workers._thread_local.do = workers._do_elsewhere

    monkeypatch.setattr(processes.Workers, "_assign_worker", assign_worker)


def is_alive(process):
    with suppress(psutil.NoSuchProcess):
        return process.status() != psutil.STATUS_ZOMBIE
    return False


@pytest.fixture
def runs(runs):
    """Beside the runs a file that is no trace."""
    (runs / "ping1a.mcap").write_bytes(b"no trace")
    return runs


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """Where temporary files go."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr("tempfile.tempdir", None)
    return folder


@pytest.mark.parametrize(("cache", "batch_events"), [(False, 1_000_000), (True, 1)])
def test_workers_say_the_same_as_threads(runs, monkeypatch, temporary, request, cache, batch_events):
    monkeypatch.setattr(dds_trace.analyzer.engines.batches, "BATCH_EVENTS", batch_events)
    monkeypatch.setattr(local, "is_large", lambda _batch: False)
    expected = analyze(runs)
    started = request.getfixturevalue("started")
    first = analyze(runs, cache=cache)
    write_runs(runs, [7], groups=3)
    again = analyze(runs, cache=cache)
    assert len(started) == 4
    assert not any(process.is_running() for process in started)
    assert list(temporary.iterdir()) == []
    assert_same_results(first, expected)
    assert [source.path for source in first.sources if source.status == "skipped"] == ["ping1a.mcap"]
    monkeypatch.setattr(local, "FILES_FOR_PROCESSES", 1_000)
    assert_same_results(again, analyze(runs))


@pytest.mark.parametrize("cache", [False, True])
@pytest.mark.parametrize("largest_in_memory", [0, 1_000])
def test_few_traces_that_take_long_are_read_here_and_processed_by_workers(
    runs, monkeypatch, temporary, request, cache, largest_in_memory
):
    expected = analyze(runs)
    started = request.getfixturevalue("started")
    monkeypatch.setattr(local, "FILES_FOR_PROCESSES", 1_000)
    assert_same_results(analyze(runs), expected)
    assert not started
    monkeypatch.setattr(local, "COST_FOR_PROCESSES", 1)
    monkeypatch.setattr(traces, "LARGEST_TRACE_IN_MEMORY", largest_in_memory)
    found = analyze(runs, cache=cache)
    assert len(started) == 2
    assert list(temporary.iterdir()) == []
    assert_same_results(found, expected)


def test_this_process_works_while_others_do(runs, monkeypatch, started):
    """The first one that is free takes a job: here there is nothing to start before."""
    done = []
    for job in (processes.Worker.store, processes.Worker.process):

        @functools.wraps(job)  # by its name, others find their own
        def noted(*arguments, job=job):
            done.append(job.__name__)
            return job(*arguments)

        monkeypatch.setattr(processes.Worker, job.__name__, noted)
    analyze(runs)
    assert started
    assert {"store", "process"} <= set(done)


def test_events_of_a_large_campaign_wait_in_files(runs, monkeypatch):
    held = []
    real = local.LocalEngine.process

    def process_batches(engine, batches, index):
        held.extend(isinstance(part.events, EventColumns) for parts in index.values() for part in parts)
        return real(engine, batches, index)

    monkeypatch.setattr(local.LocalEngine, "process", process_batches)
    expected = analyze(runs)
    assert all(held)
    held.clear()
    size = sum(file.stat().st_size for file in runs.iterdir())
    monkeypatch.setattr(local, "BYTES_FOR_FILES", size)
    assert_same_results(analyze(runs), expected)
    assert not any(held)


@pytest.mark.parametrize(("users", "of_worker"), [(None, "1"), ("2", "2")])
def test_a_worker_multiplies_on_one_thread_and_the_caller_as_before(tmp_path, monkeypatch, users, of_worker):
    name = "OPENBLAS_NUM_THREADS"
    monkeypatch.delenv(name, raising=False)
    if users is not None:
        monkeypatch.setenv(name, users)
    with processes.start_workers(1, tmp_path, cache=False) as workers:
        assert workers.submit(os.getenv, name).result(PATIENCE_S) == of_worker
    assert os.environ.get(name) == users


@pytest.mark.usefixtures("started")
def test_what_a_worker_cannot_read_is_told_as_here(tmp_path):
    (tmp_path / "x.mcap").write_bytes(b"no trace")
    with pytest.raises(TraceFormatError) as told:
        analyze(tmp_path / "x.mcap")
    assert str(told.value).startswith(f"{tmp_path}/x.mcap: ")


@pytest.mark.usefixtures("nothing_here")
def test_a_killed_worker_is_one_line(runs, started, monkeypatch, temporary):
    real = local.LocalEngine.process

    def process_batches(self, batches, index):
        started[0].kill()
        wait_until(lambda: not is_alive(started[0]))  # it is the pool's to wait for
        return real(self, batches, index)

    monkeypatch.setattr(local.LocalEngine, "process", process_batches)
    monkeypatch.setattr(local, "is_large", lambda _batch: False)
    with pytest.raises(TraceError, match=r"^a worker process of the analysis was killed, perhaps because memory"):
        analyze(runs)
    assert not any(process.is_running() for process in started)
    assert list(temporary.iterdir()) == []


@pytest.mark.parametrize("sent", [signal.SIGKILL, signal.SIGINT], ids=lambda sent: sent.name)
def test_workers_end_with_their_analysis(runs, temporary, sent):
    command = [sys.executable, "-c", COMMAND, runs, "--out", temporary / "out", "--no-cache"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as analysis:
        try:
            workers = [psutil.Process(int(analysis.stdout.readline())) for _ in range(2)]
            others = psutil.Process(analysis.pid).children(recursive=True)
            analysis.send_signal(sent)
            if sent == signal.SIGINT:  # Ctrl-C comes to workers too, and the analysis waits for what they have begun
                blocked = [Path(f"/proc/{worker.pid}/status").read_text() for worker in workers]
                assert [int(re.search(r"SigBlk:\s*(\w+)", text)[1], 16) & 2 for text in blocked] == [2, 2]
                for worker in workers:
                    worker.kill()
            _, stderr = analysis.communicate(timeout=PATIENCE_S)
        finally:
            analysis.kill()  # with it the workers
    psutil.wait_procs(others, PATIENCE_S)
    assert not [process for process in others if process.is_running()]
    assert "Traceback" not in stderr


def test_a_script_that_analyzes_is_not_run_again_by_workers(runs, tmp_path):
    """Without `if __name__ == "__main__"`, as scripts and notebooks are written."""
    script = tmp_path / "script.py"
    script.write_text(
        "from pathlib import Path\n"
        "from dds_trace.analyzer.engines import local\n"
        "local.FILES_FOR_PROCESSES = 1\n"
        "from dds_trace import analyze\n"
        "print('begun')\n"
        f"print(analyze({str(runs)!r}).summary.height, Path(__file__).name)\n"
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False, timeout=PATIENCE_S)
    assert (done.stdout, done.stderr) == ("begun\n3 script.py\n", "")


def test_a_process_that_may_have_none_analyzes_alone(runs, tmp_path):
    """A worker of `multiprocessing.Pool`, which calls itself a daemon."""
    script = tmp_path / "script.py"
    script.write_text(
        "import multiprocessing, sys\n"
        "from dds_trace import analyze\n"
        "from dds_trace.analyzer.engines import local, processes\n"
        "def height(folder):\n"
        "    local.FILES_FOR_PROCESSES = 1\n"
        "    return processes.can_start_workers(), analyze(folder).summary.height\n"
        "if __name__ == '__main__':\n"
        "    with multiprocessing.get_context('spawn').Pool(1) as pool:\n"
        "        print(pool.apply(height, sys.argv[1:]))\n"
    )
    done = subprocess.run(
        [sys.executable, script, runs], capture_output=True, text=True, check=False, timeout=PATIENCE_S
    )
    assert (done.stdout, done.stderr) == ("(False, 3)\n", "")
    assert can_start_workers()


@pytest.mark.usefixtures("nothing_here")
def test_workers_answer_the_kinds_of_messages_where_their_rows_are_in_a_file(runs, tmp_path, request, answer_elsewhere):
    expected = analyze(runs).details.answers
    assert len(expected) == 3
    answer_elsewhere()
    with pytest.raises(AssertionError, match="answered here"):
        analyze(runs)
    request.getfixturevalue("started")
    assert analyze(runs, out=tmp_path / "out").details.answers == expected
    with pytest.raises(AssertionError, match="answered here"):
        analyze(runs)
