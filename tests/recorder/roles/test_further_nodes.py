"""Nodes that are only there are opened, met and measured, and end with the ping."""

import pytest
from middlewares import needs
from processes import ping, relay

from dds_trace.base.errors import OptionError
from dds_trace.recorder.backends import load_backend
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.choices import Discovery
from dds_trace.recorder.roles import further_nodes as further_nodes_module
from dds_trace.recorder.roles.further_nodes import further_nodes
from dds_trace.tracefile.reading.reader import read_trace


def test_nodes_that_do_not_discover_each_other_are_refused(domain_id):
    options = NodeOptions(domain_id, "alone", Discovery.LOCALHOST)
    with (
        load_backend("socket").open_node(options) as node,
        pytest.raises(OptionError, match="nodes of the backend socket"),
        further_nodes(node, 2),
    ):
        pass


@pytest.mark.parametrize("patience_s", [100.0, -1.0])
def test_nodes_are_at_rest_once_they_send_no_less_than_before(monkeypatch, patience_s):
    packets = [3400, 900, 300, 290, 280] if patience_s > 0 else [3400, 900]
    rates = iter([(number, 100 * number, 0.0) for number in packets])
    monkeypatch.setattr(further_nodes_module, "_rates", lambda _: next(rates))
    found = further_nodes_module._rates_until_rest([], further_nodes_module.time.monotonic() + patience_s)
    assert found[-1][:2] == ((290, 29_000) if patience_s > 0 else (900, 90_000))


@pytest.mark.middleware
@needs("cyclonedds")
def test_all_are_met_and_what_they_send_at_rest_is_recorded(tmp_path, domain_id):
    sides = ("--backend", "cyclonedds")
    with relay(domain_id, tmp_path / "relay.mcap", *sides) as command:
        done = ping(domain_id, tmp_path / "ping.mcap", *sides, "--messages", 5, "--size", "1KB", "-o", "nodes=12")
        command.stop()
    assert done.status == 0, done.stderr
    trace = read_trace(tmp_path / "ping.mcap")
    nodes = trace.sessions[-1].extra["nodes"]
    assert nodes["number"] == 12
    assert nodes["met_s"] >= 0
    assert nodes["packets_per_second"] >= 0
    assert nodes["memory_bytes"] > 2 * 20e6  # of two programs
    assert nodes["rest_s"] >= further_nodes_module.REST_S
    assert trace.runs[-1].extra["settings"]["nodes"] == 12
