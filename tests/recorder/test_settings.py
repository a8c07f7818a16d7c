from dataclasses import dataclass, fields, make_dataclass, replace
from pathlib import Path

import pytest

from dds_trace.extensions.campaigns.plan.link import PRESETS
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.choices import Discovery, ExecutorKind, Serialization, Transport
from dds_trace.recorder.options import PingOptions, RecordOptions, changed_settings, run_settings, side_settings
from dds_trace.tracefile.format.descriptions import Qos
from dds_trace.tracefile.writing.destination import TraceDestination

PLAIN = RecordOptions(TraceDestination(Path("x.mcap")), NodeOptions(discovery=Discovery.LOCALHOST))


def test_defaults_are_left_out():
    assert side_settings(PLAIN, "loopback") == {}
    assert run_settings(PingOptions()) == {}


def test_settings_of_a_side():
    node = NodeOptions(
        discovery=Discovery.LOCALHOST,
        transport=Transport.UDP,
        executor=ExecutorKind.SINGLE,
        tuned=True,
        qos=Qos("best_effort", depth=3, extra={"deadline_ns": 5_000_000}),
    )
    asked = replace(PLAIN, node=node, serialization=Serialization.TYPED, cpu_affinity="2,3")
    assert side_settings(asked, "loopback") == {
        "transport": "udp",
        "executor": "single",
        "tuned": True,
        "reliability": "best_effort",
        "depth": 3,
        "deadline_ns": 5_000_000,
        "serialization": "typed",
        "cpu_affinity": "2,3",
    }


@pytest.mark.parametrize(
    ("discovery", "connectivity", "told"),
    [
        (Discovery.LOCALHOST, "loopback", None),
        (Discovery.SUBNET, "wired", None),
        (Discovery.SUBNET, "loopback", "subnet"),
        (Discovery.LOCALHOST, "wired", "localhost"),
    ],
)
def test_discovery_is_told_where_it_is_not_the_usual_one_of_the_link(discovery, connectivity, told):
    asked = replace(PLAIN, node=NodeOptions(discovery=discovery))
    assert side_settings(asked, connectivity).get("discovery") == told


def test_settings_of_a_run_tell_surroundings_and_halves_of_a_bridge_without_an_address():
    asked = PingOptions(bridge="builtin", bridge_listen="10.0.0.1:7447", settings={"link": "wifi"}, labels={"a": "b"})
    assert run_settings(asked) == {"link": "wifi", "bridge_listen": True}


def test_an_option_that_is_added_becomes_a_setting_by_itself():
    @dataclass(frozen=True)
    class Later(RecordOptions):
        busy_poll_us: int = 0

    values = {field.name: getattr(PLAIN, field.name) for field in fields(PLAIN)}
    assert side_settings(Later(**values), "loopback") == {}
    assert side_settings(Later(**values, busy_poll_us=50), "loopback") == {"busy_poll_us": 50}


def test_no_two_fields_of_options_share_a_name():
    names: list[str] = []
    for record in (PLAIN, PLAIN.node, PLAIN.node.qos, PingOptions()):
        names += [field.name for field in fields(record)]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize(
    ("value", "expected"), [((1, 2), [1, 2]), (Path("a"), "a"), (1.5, 1.5), (Transport.SHM, "shm")]
)
def test_values_are_json(value, expected):
    record = make_dataclass("Record", [("option", object)], frozen=True)(value)
    assert dict(changed_settings(record)) == {"option": expected}


def test_a_link_tells_every_value_that_it_applies():
    assert PRESETS["wifi-54"].setting == (
        "wifi-54(delay_ms=1,jitter_ms=0.5,loss_percent=0.1,queue_ms=100,rate_mbit_s=54)"
    )
