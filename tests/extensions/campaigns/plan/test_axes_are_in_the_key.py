"""Every axis of a sweep makes two groups: the axes are walked from their table, so that a new one is walked too.

The options that a plan gives to `dds-record` are read by `dds-record` itself, described as a recording describes them, and
made into a key by the analyzer.
"""

import sys
from dataclasses import replace
from unittest import mock

import pytest
from trace_files import ping_session, relay_session, run

from dds_trace.analyzer.model.parameters import parameters_of
from dds_trace.cli.dds_record import main
from dds_trace.extensions.campaigns.plan.cells import AXES, DEFAULTS, Cell
from dds_trace.extensions.campaigns.plan.commands import ping_arguments, relay_arguments
from dds_trace.extensions.campaigns.plan.link import PRESETS
from dds_trace.extensions.campaigns.plan.plan import Plan
from dds_trace.recorder.choices import Discovery
from dds_trace.recorder.options import run_settings, side_settings

OTHER = {
    "data": "string",
    "rmw": "rmw_cyclonedds_cpp",
    "relay_rmw": "rmw_cyclonedds_cpp",
    "size": 1000,
    "outage_by": "loss",
    "link": "air-30",
}
"""Values of axes without a table of choices, where a plain other value of the kind would not do."""


def options_of(arguments):
    with (
        mock.patch("dds_trace.cli.record.run.record_until_stopped") as record,
        mock.patch.object(sys, "argv", ["dds-record", *arguments, "--out", "x.mcap"]),
        pytest.raises(SystemExit) as ended,
    ):
        main()
    assert not ended.value.code
    return record.call_args.args[0]


def session_of(make, options):
    return make(
        domain_id=options.node.domain_id,
        backend=options.backend,
        rmw=options.node.rmw,
        connectivity=options.connectivity or "loopback",
        extra={"settings": side_settings(options, options.connectivity or "loopback")},
    )


def key_of(cell, **of_plan):
    plan = Plan("plan", (cell,), **of_plan)
    ping = options_of(ping_arguments(plan, cell, 5.0, None))
    relay = options_of(relay_arguments(plan, cell.relay))
    asked = ping.ping
    described = run(
        data_type=asked.data,
        payload_bytes=asked.size_bytes or 33_000,
        rate_hz=asked.rate_hz or 10.0,
        bridge=asked.bridge,
        relay_domain_id=asked.relay_domain_id,
        serialization=ping.serialization.value,
        qos=ping.node.qos,
        labels=dict(asked.labels),
        extra={"settings": run_settings(asked)},
    )
    return parameters_of(described, session_of(ping_session, ping), session_of(relay_session, relay))


def other_value(name):
    axis, default = AXES[name], DEFAULTS[name]
    if name in OTHER:
        return OTHER[name]
    if axis.choices:
        return next(value for value in axis.choices if value not in (default, Cell().backend))
    return not default if axis.kind is bool else axis.kind((default or 0) + 1)


@pytest.mark.keeps(8)
@pytest.mark.parametrize("name", AXES)
def test_an_axis_makes_two_groups(name):
    cell = Cell(relay_backend="ros2") if name == "relay_rmw" else Cell()
    assert key_of(cell) != key_of(replace(cell, **{name: other_value(name)}))


def test_a_pass_makes_no_other_group():
    assert key_of(Cell()) == key_of(replace(Cell(), repeat=2))


def test_values_of_an_emulated_link_make_two_groups():
    wifi = PRESETS["wifi-54"]
    keys = [
        key_of(Cell(), link=link, namespaces=True, connectivity=link.connectivity)
        for link in (wifi, replace(wifi, queue_ms=20))
    ]
    assert keys[0] != keys[1]
    assert keys[0].setting == f"link={wifi.setting}"


def test_what_a_device_is_given_makes_two_groups():
    plain = Plan("plan", (Cell(),))
    given = replace(plain, ping=replace(plain.ping, options=("--cpu-affinity", "0")))
    keys = {key_of(Cell(), ping=plan.ping).setting for plan in (plain, given)}
    assert keys == {"", "cpu_affinity=0,relay.cpu_affinity=default"}


def test_discovery_that_is_not_usual_for_the_link_is_in_the_key():
    plan = Plan("plan", (Cell(),))
    beyond = replace(plan.run, discovery=Discovery.SUBNET.value)
    assert key_of(Cell(), run=beyond).setting == "discovery=subnet"


@pytest.mark.parametrize(
    ("option", "setting"),
    [
        (("--deadline", "20ms"), "deadline_ns=20000000"),
        (("--lifespan", "1s"), "lifespan_ns=1000000000"),
        (("--realtime", "50"), "realtime_priority=50,relay.realtime_priority=default"),
        (("--setting", "cpu_load=50%"), "cpu_load=50%25"),
    ],
)
def test_options_that_are_no_axis_make_two_groups(option, setting):
    """A device's own options reach `dds-record` as they are; QoS durations are those of the ping's run."""
    plain = Plan("plan", (Cell(),))
    given = replace(plain, ping=replace(plain.ping, options=option))
    assert key_of(Cell(), ping=given.ping).setting.split(",")[0] == setting.split(",")[0]
    assert key_of(Cell(), ping=given.ping) != key_of(Cell())


def test_no_axis_is_told_by_a_label_alone():
    """Labels name a run and part no groups: what an axis changes has to be a parameter or a setting."""
    plain = ping_arguments(Plan("plan", (Cell(),)), Cell(), 5.0, None)
    for name in AXES:
        cell = replace(Cell(), **{name: other_value(name)})
        given = [
            *ping_arguments(Plan("plan", (cell,)), cell, 5.0, None),
            *relay_arguments(Plan("plan", (cell,)), cell.relay),
        ]
        unlike = [word for word in given if (word not in plain and "=" not in word) or word.startswith("environment=")]
        assert unlike, name
