import os
import re
import signal
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from pathlib import Path

import psutil
import pytest
from campaigns import assert_same_results
from processes import executed
from waiting import PATIENCE_S, wait_until

import dds_trace.analyzer.engines.batches
from dds_trace.analyzer.engines import local, processes
from dds_trace.analyzer.engines.processes import can_start_processes
from dds_trace.analyzer.pipeline import analyze
from dds_trace.base.errors import TraceError, TraceFormatError

# Each batch, one a group, is a worker process that sleeps; it says which one it is.
COMMAND = """
import sys
from concurrent.futures import ProcessPoolExecutor
import dds_trace.analyzer.engines.batches
from dds_trace.analyzer.engines import local, processes

SLEEP = "import os, time; os.write(1, str(os.getpid()).encode() + bytes([10])); time.sleep(300)"

class Sleeping(ProcessPoolExecutor):
    def submit(self, job, *more):
        return super().submit(*((exec, SLEEP) if job is local.process else (job, *more)))

processes.ProcessPoolExecutor = Sleeping
local.FILES_FOR_PROCESSES = dds_trace.analyzer.engines.batches.BATCH_EVENTS = 1
local.is_large = lambda batch: False
from dds_trace.cli.dds_analyze import main
sys.argv = ["dds-analyze", *sys.argv[1:]]
main()
"""


@pytest.fixture
def started(monkeypatch):
    begun = []

    class Noting(ProcessPoolExecutor):
        def submit(self, *job):
            future = super().submit(*job)
            begun.extend(p for pid in self._processes if (p := psutil.Process(pid)) not in begun)
            return future

    monkeypatch.setattr(processes, "ProcessPoolExecutor", Noting)
    monkeypatch.setattr(local, "FILES_FOR_PROCESSES", 1)
    return begun


def is_alive(process):
    with suppress(psutil.NoSuchProcess):
        return process.status() != psutil.STATUS_ZOMBIE
    return False


@pytest.fixture
def runs(runs):
    (runs / "ping1a.mcap").write_bytes(b"no trace")
    return runs


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr("tempfile.tempdir", None)
    return folder


@pytest.mark.parametrize("batch_events", [1_000_000, 1])
def test_workers_say_the_same_as_threads(runs, monkeypatch, temporary, request, batch_events):
    monkeypatch.setattr(dds_trace.analyzer.engines.batches, "BATCH_EVENTS", batch_events)
    monkeypatch.setattr(local, "is_large", lambda _batch: False)
    expected = analyze(runs)
    started = request.getfixturevalue("started")
    found = analyze(runs)
    assert len(started) == 2
    assert not any(process.is_running() for process in started)
    assert list(temporary.iterdir()) == []
    assert_same_results(found, expected)
    assert [source.path for source in found.sources if source.status == "skipped"] == ["ping1a.mcap"]


def test_a_large_batch_stays_here(runs, monkeypatch, started):
    here = []
    threads, submit = local.ThreadPoolExecutor, local.ThreadPoolExecutor.submit
    monkeypatch.setattr(threads, "submit", lambda *j: (j[1] is local.process and here.append(j)) or submit(*j))
    analyze(runs)
    assert not here
    monkeypatch.setattr(dds_trace.analyzer.engines.batches, "BATCH_EVENTS", 10)
    analyze(runs)
    assert len(here) == 3
    assert len(started) == 4


@pytest.mark.parametrize(("users", "of_worker"), [(None, "1"), ("2", "2")])
def test_a_worker_multiplies_on_one_thread_and_the_caller_as_before(monkeypatch, users, of_worker):
    name = "OPENBLAS_NUM_THREADS"
    monkeypatch.delenv(name, raising=False)
    if users is not None:
        monkeypatch.setenv(name, users)
    with processes.processes(1) as workers:
        assert workers.submit(os.getenv, name).result(PATIENCE_S) == of_worker
    assert os.environ.get(name) == users


@pytest.mark.usefixtures("started")
def test_what_a_worker_cannot_read_is_told_as_here(tmp_path):
    (tmp_path / "x.mcap").write_bytes(b"no trace")
    with pytest.raises(TraceFormatError) as told:
        analyze(tmp_path / "x.mcap")
    assert str(told.value).startswith(f"{tmp_path}/x.mcap: ")


def test_a_killed_worker_is_one_line(runs, started, monkeypatch, temporary):
    real = local.Engine.process

    def process_batches(self, batches, index):
        started[0].kill()
        wait_until(lambda: not is_alive(started[0]))  # it is the pool's to wait for
        return real(self, batches, index)

    monkeypatch.setattr(local.Engine, "process", process_batches)
    monkeypatch.setattr(local, "is_large", lambda _batch: False)
    with pytest.raises(TraceError, match=r"^a worker process of the analysis was killed, perhaps because memory"):
        analyze(runs)
    assert not any(process.is_running() for process in started)
    assert list(temporary.iterdir()) == []


@pytest.mark.parametrize("sent", [signal.SIGKILL, signal.SIGINT], ids=lambda sent: sent.name)
def test_workers_end_with_their_analysis(runs, temporary, sent):
    command = [sys.executable, "-c", COMMAND, runs, "--out", temporary / "out"]
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
    script = tmp_path / "script.py"
    script.write_text(
        "import multiprocessing, sys\n"
        "from dds_trace import analyze\n"
        "from dds_trace.analyzer.engines import local, processes\n"
        "def height(folder):\n"
        "    local.FILES_FOR_PROCESSES = 1\n"
        "    return processes.can_start_processes(), analyze(folder).summary.height\n"
        "if __name__ == '__main__':\n"
        "    with multiprocessing.get_context('spawn').Pool(1) as pool:\n"
        "        print(pool.apply(height, sys.argv[1:]))\n"
    )
    done = executed([sys.executable, script, runs], timeout=PATIENCE_S)
    assert (done.stdout, done.stderr) == ("(False, 3)\n", "")
    assert can_start_processes()
