import importlib.util

import processes
import pytest

from dds_trace.analyzer.pipeline import analyze
from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.reading.reader import read_trace

pytestmark = pytest.mark.middleware

PLAN = """
[run]
seconds = 0.5
settle_seconds = 0
domain = {domain}
own_cost_passes = 1
[axes]
backend = "{backend}"
size = "1KB"
rate = "max"
ping_share = 0.05
"""


@pytest.mark.parametrize("backend", ["socket", "cyclonedds"])
def test_throughput_and_latency_come_from_one_run(tmp_path, domain_id, backend):
    if importlib.util.find_spec(backend) is None and backend != "socket":
        pytest.skip(f"{backend} is not installed")
    plan = tmp_path / "p.toml"
    plan.write_text(PLAN.format(backend=backend, domain=domain_id))
    done = processes.run("dds-trace", "sweep", plan, "--out", tmp_path / "runs")
    assert done.status == 0, done.stderr
    (path,) = (tmp_path / "runs/p").glob("*_max_*.ping.mcap")
    trace = read_trace(path)
    run, sent = trace.runs[-1], trace.events[Stage.T1]
    assert (run.rate_hz, run.ping_every) == (0, 20)
    assert run.planned_messages == run.published - run.warmup_messages > 100
    assert not sent.scheduled_ns.any()
    assert not (trace.events[Stage.T2].sequence % 20).any()
    relay = read_trace(str(path).replace(".ping.", ".relay."))
    assert not (relay.events[Stage.T4].sequence % 20).any()

    analysis = analyze(tmp_path / "runs/p")
    (row,) = analysis.summary.to_dicts()
    assert (row["rate_hz"], row["unsent"], row["response_p50_ns"]) == (0, 0, None)
    assert row["published"] <= row["sent"] / 20 + 1
    assert 0 < row["reached"] <= row["sent"]
    assert row["reached"] == len(relay.events[Stage.T3].take(relay.events[Stage.T3].sequence >= run.warmup_messages))
    assert row["transfer_rate_bytes_per_s"] == pytest.approx(1000 * row["reached_rate_hz"])
    assert row["latency_p50_ns"] > 0
    if backend == "socket":  # TCP loses nothing
        assert row["reached"] == row["sent"]
    sender, codes = run.extra["sender"], {finding.code for finding in analysis.findings}
    assert 0 < sender["cpu_ns"] <= sender["elapsed_ns"]
    if backend == "cyclonedds":  # its writer waits for nobody
        assert "client_bound" in codes
    assert not {"late_sends", "schedule_not_held", "no_schedule", "orphan_events", "missing_publications"} & codes
