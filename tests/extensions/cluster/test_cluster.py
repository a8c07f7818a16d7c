"""The same numbers from a cluster: a real scheduler, two worker processes, object storage, a worker killed."""

import os
import subprocess
import sys
import threading

import polars as pl
import pytest
from campaigns import assert_same_results, write_runs

import dds_trace.analyzer.engines.batches
import dds_trace.extensions.cluster.engine
from dds_trace.analyzer.model.metrics import METRICS
from dds_trace.analyzer.pipeline import analyze
from dds_trace.analyzer.statistics.percentiles import PERCENTILES
from dds_trace.base.errors import BackendUnavailableError

distributed = pytest.importorskip("distributed", reason="the extra `cluster` is not installed")

pytestmark = pytest.mark.filterwarnings("ignore")  # vendors' own, at their start and end


def start(module, *arguments, env=None):
    return subprocess.Popen(
        [sys.executable, "-m", module, *arguments], stderr=subprocess.PIPE, text=True, env={**os.environ, **(env or {})}
    )


def said(process, text):
    """The line of the process with `text` in it; all that comes later is read away."""
    for line in process.stderr:
        if text in line:
            threading.Thread(target=process.stderr.read, daemon=True).start()
            return line
    raise AssertionError(f"ended with {process.wait()} before it said {text!r}")


def end(process):
    """Ask, then kill: a worker of Dask may wait half a minute for a scheduler that no longer answers."""
    with process:  # closes its pipe too
        process.terminate()
        try:
            process.wait(5)
        except subprocess.TimeoutExpired:
            process.kill()


@pytest.fixture(scope="module")
def bucket():
    """Where an S3 server on loopback listens, with a bucket `bucket`, and what a client must be told."""
    server = pytest.importorskip("moto.server").ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    env = {
        "AWS_ENDPOINT_URL": f"http://{host}:{port}",
        "AWS_ACCESS_KEY_ID": "test",
        "AWS_SECRET_ACCESS_KEY": "test",
        "AWS_DEFAULT_REGION": "us-east-1",
    }
    before = dict(os.environ)
    os.environ.update(env)
    import s3fs

    s3fs.S3FileSystem().mkdir("bucket")
    yield env
    os.environ.clear()
    os.environ.update(before)
    server.stop()


@pytest.fixture(scope="module")
def cluster(bucket, tmp_path_factory):
    folder = tmp_path_factory.mktemp("dask")
    quiet = ("--no-dashboard", "--host", "127.0.0.1")
    scheduler = start("distributed.cli.dask_scheduler", *quiet, "--port", "0")
    processes = [scheduler]
    try:
        address = said(scheduler, "Scheduler at:").split()[-1]
        workers = [
            start(
                "distributed.cli.dask_worker",
                address,
                *quiet,
                "--no-nanny",
                "--nthreads",
                "1",
                "--local-directory",
                str(folder),
                env={**bucket, "TMPDIR": str(folder)},  # a worker that is killed leaves its events there
            )
            for _ in range(2)
        ]
        processes += workers
        for worker in workers:
            said(worker, "Registered to:")
        yield address, workers
    finally:
        for process in reversed(processes):
            end(process)


@pytest.fixture
def runs(tmp_path):
    write_runs(tmp_path / "runs", range(6), groups=2)
    (tmp_path / "runs" / "odd.mcap").write_bytes(b"no trace")
    return tmp_path / "runs"


def test_a_cluster_finds_what_one_machine_finds(cluster, runs, tmp_path):
    address, _ = cluster
    alone = analyze(runs, out=tmp_path / "alone")
    together = analyze(runs, out=tmp_path / "together", cluster=address)
    assert_same_results(together, alone)
    assert pl.read_parquet(together.outputs["roundtrips"]).equals(alone.load_roundtrips())
    for kind, path in alone.outputs.items():
        assert together.outputs[kind].read_bytes() == path.read_bytes()


@pytest.mark.thorough
def test_parts_of_a_group_from_several_workers_are_exact(cluster, runs, monkeypatch):
    alone = analyze(runs)
    monkeypatch.setattr(dds_trace.analyzer.engines.batches, "BATCH_EVENTS", 150)
    monkeypatch.setattr(dds_trace.analyzer.engines.batches, "WHOLE_GROUP_EVENTS", 200)
    together = analyze(runs, cluster=cluster[0])
    assert together.summary.equals(alone.summary)
    assert together.load_roundtrips().equals(alone.load_roundtrips())


@pytest.mark.thorough
@pytest.mark.parametrize("in_parts", [False, True])
def test_a_sketch_is_near_and_says_so(cluster, runs, tmp_path, monkeypatch, in_parts):
    alone = analyze(runs, out=tmp_path / "out")
    rows = alone.outputs["roundtrips"].read_bytes()
    if in_parts:
        monkeypatch.setattr(dds_trace.analyzer.engines.batches, "BATCH_EVENTS", 150)
        monkeypatch.setattr(dds_trace.analyzer.engines.batches, "WHOLE_GROUP_EVENTS", 200)
    sketch = analyze(runs, out=tmp_path / "out", cluster=cluster[0], sketch=True)
    assert sketch.load_roundtrips().is_empty()
    assert sorted(sketch.outputs) == ["summary"]
    assert alone.outputs["roundtrips"].read_bytes() == rows  # a sketch replaces what it writes and no more
    assert [f.where for f in sketch.findings if f.code == "earlier_rows"] == ["roundtrips.parquet"]
    (finding,) = (f for f in sketch.findings if f.code == "sketched")
    assert "0.05%" in finding.what
    for near, exact in zip(sketch.summary.to_dicts(), alone.summary.to_dicts(), strict=True):
        assert near["published"] == exact["published"]
        for metric in METRICS:
            for name in ("mean", "std", "min", "max"):
                assert near[f"{metric}_{name}_ns"] == pytest.approx(exact[f"{metric}_{name}_ns"], rel=1e-9)
            for percentile in PERCENTILES:
                name = f"{metric}_{percentile.name}_ns"
                assert (near[name] is None) == (exact[name] is None)
                assert near[name] is None or near[name] == pytest.approx(exact[name], rel=1e-3)
    assert sketch.distributions.equals(alone.distributions)


@pytest.mark.thorough
def test_traces_in_object_storage_are_analyzed_as_on_disk(cluster, runs, tmp_path):
    import s3fs

    s3fs.S3FileSystem().put(str(runs), "bucket/campaign", recursive=True)
    alone = analyze(runs)
    for where in ({"cluster": cluster[0]}, {"out": tmp_path / "out"}):
        remote = analyze("s3://bucket/campaign", **where)
        assert remote.load_roundtrips().equals(alone.load_roundtrips())
        assert remote.summary.equals(alone.summary)
        assert remote.sources == alone.sources


@pytest.mark.thorough
def test_a_killed_worker_costs_no_data(cluster, runs, monkeypatch):
    """The last test: one of the workers is gone after it."""
    address, workers = cluster
    alone = analyze(runs)
    from dds_trace.extensions.cluster.engine import ClusterEngine

    real = ClusterEngine.process

    def process_after_a_kill(self, batches, events):
        workers[0].kill()  # the traces that it has read are gone with it
        workers[0].wait()
        return real(self, batches, events)

    monkeypatch.setattr(ClusterEngine, "process", process_after_a_kill)
    assert_same_results(analyze(runs, cluster=address), alone)


def test_without_a_scheduler_the_error_is_one_line(runs, monkeypatch):
    monkeypatch.setattr(dds_trace.extensions.cluster.engine, "_TIMEOUT_S", 1)
    with pytest.raises(BackendUnavailableError, match="no Dask scheduler answers at tcp://"):
        analyze(runs, cluster="tcp://127.0.0.1:1")
