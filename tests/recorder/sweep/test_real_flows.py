import pytest
from namespaces import needs_namespaces
from processes import sweep

from dds_trace.analyzer.pipeline import analyze
from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.reading.reader import read_trace

pytestmark = pytest.mark.middleware

FLOWS = """
[run]
seconds = 2
warmup = 2
settle_seconds = 0
domain = {domain}
own_cost_passes = 1
[axes]
backend = "socket"
[[flows]]
name = "images"
size = "200KB"
rate = 20
[[flows]]
name = "odom"
data = "binary"
size = "100"
rate = 100
"""

OUTAGE = """
[run]
warmup = 2
settle_seconds = 0
outage_after_seconds = 0.5
outage_limit_seconds = {limit}
domain = {domain}
{network}
[axes]
backend = "socket"
size = "1KB"
rate = 50
outage = {seconds}
outage_by = "{by}"
"""


def test_two_flows_of_one_kind_of_data_share_a_relay_and_run_together(tmp_path, domain_id):
    assert sweep(tmp_path, FLOWS.format(domain=domain_id))["cells"] == 4
    spans, relays = {}, set()
    for path in (tmp_path / "runs/p").glob("*.ping.mcap"):
        trace = read_trace(path)
        sent = trace.events[Stage.T1].monotonic_ns
        spans[trace.runs[0].labels["cell"]] = int(sent[0]), int(sent[-1])
        relays |= {session.session_id for session in read_trace(str(path).replace(".ping.", ".relay.")).sessions}
    together = [span for name, span in spans.items() if "_with-" in name]
    assert max(start for start, _ in together) < min(end for _, end in together)
    analysis = analyze(tmp_path / "runs/p")
    assert analysis.summary.height == 4
    assert set(analysis.details.interference["flow"]) == {"images", "odom"}
    assert set(analysis.details.head_of_line["other"]) == {"images", "odom"}
    codes = {finding.code for finding in analysis.findings}
    assert not {"overlapping_pings", "forged_or_foreign", "nothing_received"} & codes


def test_a_killed_relay_is_started_anew_and_the_first_reply_after_that_is_timed(tmp_path, domain_id):
    sweep(tmp_path, OUTAGE.format(limit=15, domain=domain_id, network="", seconds=0.5, by="relay"))
    (row,) = analyze(tmp_path / "runs/p").details.recoveries.to_dicts()
    assert (row["by"], row["never"]) == ("relay", False)
    assert row["outage_ns"] >= 500_000_000
    assert row["back_ns"] >= row["out_ns"] > 0
    assert row["lost_within"] > 0


@needs_namespaces("tc", "iproute2")
@pytest.mark.parametrize("by", ["link", "loss", "address"])
def test_a_link_that_is_cut_comes_back(tmp_path, domain_id, by):
    network = "[network]\nnamespaces = true\n"
    sweep(tmp_path, OUTAGE.format(limit=4, domain=domain_id, network=network, seconds=0.4, by=by))
    (row,) = analyze(tmp_path / "runs/p").details.recoveries.to_dicts()
    assert (row["by"], row["never"]) == (by, False)
    assert row["outage_ns"] >= 400_000_000
    # TCP sends again what was lost, but not from another address: there the ping connects again.
    assert (row["lost_within"] > 0) == (by == "address")


STALL = """
import time
from dds_trace.recorder.payloads.stamp import RawStampPlace
reply = RawStampPlace.reply

def stalled(self, message, relay_id_text):
    time.sleep(0.1 if len(message) > 100_000 else 0)
    return reply(self, message, relay_id_text)

RawStampPlace.reply = stalled
"""


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["socket", "cyclonedds"])
def test_a_stall_of_the_large_flow_is_found_in_the_small_one(tmp_path, domain_id, monkeypatch, backend):
    """A real relay that stands still for 100 ms at each image; the queues hold the odometry of a second."""
    if backend != "socket":
        pytest.importorskip(backend)
    text = FLOWS.replace("seconds = 2\n", "seconds = 6\nrepeats = 3\n").replace("rate = 20", "rate = 2")
    text = text.replace('"socket"', f'"{backend}"\ndepth = 100').format(domain=domain_id)
    added_ns = []
    for name in ("sound", "stalled"):
        folder = tmp_path / name
        folder.mkdir()
        if name == "stalled":
            (folder / "sitecustomize.py").write_text(STALL)
            monkeypatch.setenv("PYTHONPATH", str(folder))
        sweep(folder, text)
        interference = analyze(folder / "runs/p").details.interference
        (row,) = interference.filter(flow="odom", metric="latency", statistic="p99").to_dicts()
        added_ns.append(row["difference_ns"])
    # A latency is half of the round trip less the relay: between 50 and 100 ms where the way out waited, the way back, or both.
    assert 40e6 < added_ns[1] < 200e6
    assert added_ns[0] < added_ns[1] / 2
