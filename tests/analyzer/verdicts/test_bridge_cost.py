import polars as pl
import pytest
from roundtrip_frames import MS, in_runs, steady

from dds_trace.analyzer.verdicts.bridge_cost import bridge_cost
from dds_trace.analyzer.verdicts.compare import CompareOptions

P50_ONLY = CompareOptions(metrics=("latency",), statistics=("p50",))


def test_cost_of_each_bridge():
    same = in_runs([5 * MS] * 20)
    apart = {"domain_mode": "different", "relay_domain_id": 10}
    frame = pl.concat(
        [
            same,
            in_runs([8 * MS] * 20, run_id=2, bridge="builtin", **apart),
            in_runs([20 * MS, 20 * MS, 20 * MS, None] * 5, run_id=3, bridge="zenoh-bridge-dds", **apart),
            steady([9 * MS] * 20, run_id=4, bridge="builtin", payload_bytes=502_000, **apart),  # no partner
        ]
    )
    cost = bridge_cost(frame, P50_ONLY)
    assert cost.select("bridge", "payload_bytes").rows() == [("builtin", 33_000), ("zenoh-bridge-dds", 33_000)]
    assert cost["base_ns"].to_list() == pytest.approx([5 * MS, 5 * MS])
    assert cost["new_ns"].to_list() == pytest.approx([8 * MS, 20 * MS])
    assert cost["difference_ns"].to_list() == pytest.approx([3 * MS, 15 * MS])
    assert cost["new_received_ratio"].to_list() == [1.0, 0.75]
    assert cost["verdict"].to_list() == ["worse", "worse"]
    without = bridge_cost(same, P50_ONLY)
    assert without.is_empty()
    assert without.columns == cost.columns
