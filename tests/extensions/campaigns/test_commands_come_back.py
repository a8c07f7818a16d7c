"""Every printed command, taken as it is printed, records the settings of its result."""

import shlex
from dataclasses import fields, replace

import pytest
import typer
from trace_files import ping_session, relay_session, run

from dds_trace.analyzer.model.parameters import parameters_of
from dds_trace.analyzer.verdicts.job import Job
from dds_trace.cli.record.command import role_app
from dds_trace.cli.table_options import settings_as_options
from dds_trace.extensions.campaigns.plan.commands import ping_arguments, relay_arguments
from dds_trace.extensions.campaigns.plan.plan_file import parse_plan
from dds_trace.extensions.campaigns.recommendation import recording_commands
from dds_trace.recorder.choices import Role
from dds_trace.recorder.option_table import OPTIONS
from dds_trace.recorder.options import run_settings, side_settings

HERE = "[run]\ndomain = 9\nseconds = 5\n"
LINKS = {
    "preset": '[link]\npreset = "ethernet-100m"\n',
    "air": '[link]\npreset = "air-30"\ndelay_ms = 0.5\nloss_percent = 1.25\nloss_burst = 3\n',
    "own": '[link]\nname = "mine"\noutage_every_s = 10\noutage_ms = 300\nrate_mbit_s = 54\n',
    "namespaces": "[network]\nnamespaces = true\n",
}
AXES = {
    "plain": "",
    "qos": 'reliability = "best_effort"\ndepth = 3\nhistory = "keep_last"\ndurability = "transient_local"\n',
    "tuned": 'tuned = true\ntransport = "udp"\nserialization = "typed"\nexecutor = "single"\n',
    "relay": 'relay_rmw = "rmw_cyclonedds_cpp"\nrmw = "rmw_fastrtps_cpp"\n',
    "mixed": 'backend = "cyclonedds"\nrelay_backend = "ros2"\nbuffer = "4MB"\nmulticast = false\n',
    "bridge": 'bridge = "builtin"\nrealtime = 50\nwake = 5\n',
    "many": "relays = 2\n",
    "outage": 'outage = 5\noutage_by = "loss"\n',
    "request": 'call = "service"\nresponse_size = "33KB"\nclients = 2\n',
}
SENT = {
    "binary": 'size = "145KB"\nrate = 1\n',
    "fast": 'size = "33KB"\nrate = 12.5\n',
    "imu": 'data = "imu"\nrate = "max"\n',
}


def options_of(arguments):
    role, found = Role(arguments[1]), []
    app = typer.main.get_command(role_app(role, set(OPTIONS)))
    app.main(settings_as_options(arguments[2:], role), standalone_mode=False, obj=found.append)
    return found[0]


def result_of(plan):
    (cell,) = plan.cells
    ping, relay = (
        options_of([*arguments, *further])
        for arguments, further in (
            (ping_arguments(plan, cell, 5.0, None), ("--out", "p.mcap")),
            (relay_arguments(plan, cell.relay), ("--out", "r.mcap")),
        )
    )
    return described_by(ping, relay, cell.rate), cell


def described_by(ping, relay, rate_hz):
    sessions = [
        make(
            backend=side.backend,
            vendor=side.backend,
            rmw=side.node.rmw,
            domain_id=5,
            device="vm",
            connectivity=side.connectivity or "loopback",
            extra={"settings": side_settings(side, side.connectivity or "loopback")},
        )
        for make, side in ((ping_session, ping), (relay_session, relay))
    ]
    sent = ping.ping
    described = run(
        data_type=sent.data,
        payload_bytes=sent.size_bytes or 296,
        rate_hz=0.0 if rate_hz == float("inf") else sent.rate_hz,
        bridge=sent.bridge,
        serialization=ping.serialization.value,
        qos=replace(
            run().qos,
            **{name: getattr(ping.node.qos, name) for name in ("reliability", "durability", "history", "depth")},
        ),
        extra={**run().extra, "settings": run_settings(sent)},
    )
    return parameters_of(described, *sessions)


def printed(parameters, **changes):
    setting = {field.name: getattr(parameters, field.name) for field in fields(parameters)} | changes
    job = Job(parameters.data_type, parameters.payload_bytes, parameters.rate_hz, 50_000_000, 0.99)
    return recording_commands(setting, job, 123, 4)


@pytest.mark.parametrize(
    ("link", "axes", "sent"),
    [
        (link, axes, sent)
        for row, link in enumerate(LINKS)
        for column, axes in enumerate(AXES)
        if (axes, sent := [*SENT][(row + column) % len(SENT)]) != ("outage", "imu")  # an outage has a rate
    ],
)
def test_a_plan_that_is_printed_has_the_settings_of_its_result(link, axes, sent):
    text = f"{HERE}{LINKS[link]}[axes]\n{AXES[axes]}[[matrix]]\n{SENT[sent]}"
    plan = parse_plan(text, "one", "one.toml")
    parameters, cell = result_of(plan)
    ((_, command),) = printed(parameters)
    words = shlex.split(command)
    lines, after = words[2 : words.index(">")], words[words.index(">") :]
    assert after == [">", "decide.toml", "&&", "dds-trace", "sweep", "decide.toml"]
    again = parse_plan("\n".join(lines) + "\nrun.domain=9\n", "one", "one.toml")
    assert again.run.repeats == 4
    assert (again.run.seconds == 10) if sent == "imu" else (again.run.messages == 123)
    same, same_cell = result_of(again)
    assert same_cell == cell
    assert again.link == plan.link or again.link.setting == plan.link.setting
    assert again.connectivity == plan.connectivity
    assert same == parameters


@pytest.mark.parametrize("axes", [name for name in AXES if name not in ("many", "outage")])
@pytest.mark.parametrize("sent", SENT)
def test_commands_of_both_sides_have_the_settings_of_their_result(axes, sent):
    parameters, cell = result_of(parse_plan(f"{HERE}[axes]\n{AXES[axes]}[[matrix]]\n{SENT[sent]}", "one", "one.toml"))
    relay, ping = (command for _, command in printed(parameters))
    assert (
        described_by(*(options_of(["--role", *shlex.split(one)[2:]]) for one in (ping, relay)), cell.rate) == parameters
    )


LINK = "link=ethernet-100m(queue_ms=100,rate_mbit_s=100)"


@pytest.mark.parametrize(
    ("changes", "commands"),
    [
        ({"setting": "environment=old", "connectivity": "loopback"}, 0),
        ({"setting": "configuration=mine"}, 0),
        ({"setting": f"flow=camera,flows=2,{LINK},with=imu"}, 0),
        ({"connectivity": "emulated-ethernet-100m"}, 0),  # of an old trace, which names its link only
        ({"setting": LINK, "relay_device": "other"}, 0),
        ({"setting": "relays=3", "connectivity": "loopback"}, 1),
        ({"setting": "queue=50ms", "relay_device": "other"}, 0),
        ({"connectivity": "wired", "relay_device": "other"}, 2),
        ({"setting": "cpu_load=50%25", "connectivity": "loopback"}, 2),
    ],
)
def test_what_record_would_only_name_is_swept_or_has_no_command(changes, commands):
    parameters, _ = result_of(parse_plan(f"{HERE}[[matrix]]\nsize = '33KB'\n", "one", "one.toml"))
    said = printed(parameters, **changes)
    assert len(said) == commands
    assert not any("emulated-" in command or "setting=link" in command for _, command in said)
