"""The commands that measure a setup again, as `dds-record` reads them."""

from __future__ import annotations

import shlex
import sys
from unittest import mock

import pytest

from dds_trace.cli.record import command
from dds_trace.reports.book.groups import Series
from dds_trace.reports.book.job import commands_of

SERIES = Series(
    vendor="fastdds",
    relay_vendor="cyclonedds",
    backend="ros2",
    relay_backend="cyclonedds",
    rmw="rmw_fastrtps_cpp",
    domain_mode="different",
    bridge="builtin",
    ping_domain_id=5,
    relay_domain_id=10,
    reliability="best_effort",
    durability="volatile",
    history="keep_last",
    depth=3,
    serialization="raw",
    ping_device="a",
    relay_device="b",
    connectivity="wired",
    setting="link=x(delay_ms=1),load=cpu,transport=udp,tuned=true",
)


def options_of(role, words):
    with (
        mock.patch("dds_trace.cli.record.run.record_until_stopped") as record,
        mock.patch("dds_trace.cli.record.run.print_result"),
        mock.patch.object(sys, "argv", ["dds-record", "--role", role, *shlex.split(words), "--out", "x.mcap"]),
        pytest.raises(SystemExit) as ended,
    ):
        command.main()
    assert not ended.value.code
    return record.call_args.args[0]


def test_both_commands_have_what_the_setup_was():
    commands = commands_of(SERIES)
    ping, relay = (options_of(role, commands[role]) for role in ("ping", "relay"))
    assert (ping.backend, relay.backend) == ("ros2", "cyclonedds")
    assert (ping.node.rmw, relay.node.rmw) == ("rmw_fastrtps_cpp", None)
    assert (ping.node.domain_id, relay.node.domain_id, ping.ping.relay_domain_id) == (5, 10, 10)
    assert ping.ping.bridge == "builtin"
    for options in (ping, relay):
        assert (options.node.qos.reliability, options.node.qos.depth) == ("best_effort", 3)
        assert (options.node.transport.value, options.node.tuned, options.load.value) == ("udp", True, "cpu")
