import hostile_values
import pytest
from hostile_values import COMMANDS, check_told, run
from hypothesis import HealthCheck, given, settings
from typer.main import get_command

from dds_trace.base.errors import MissingEventsError
from dds_trace.recorder.errors import NoEchoError
from dds_trace.recorder.roles.plan import count_messages

PLAN = "[run]\nmessages = 1\n[axes]\nbackend = 'socket'\n"
BASE = {
    "dds-record": ["--role", "ping", "--out", "x.mcap", "--backend", "socket", "--wait", "0"],
    "dds-analyze": ["runs"],
    "dds-trace choose": ["runs", "--size", "1KB", "--rate", "1", "--deadline", "1ms"],
    "dds-trace compare": ["runs", "runs"],
    "dds-trace watch": ["runs", "--port", "0"],
    "dds-trace studio": ["--port", "0"],
    "dds-trace bag": ["runs"],
    "dds-trace recover": ["runs/x.mcap"],
    "dds-trace doctor": [],
    "dds-trace bridge": ["builtin", "--config"],
    "dds-trace sweep": ["p.toml", "--dry-run"],
    "dds-trace capacity": ["p.toml", "--dry-run"],
    "dds-trace explain rates": ["p.toml", "--dry-run"],
    "dds-trace explain size": ["1KB", "p.toml", "--dry-run"],
    "dds-trace advise": ["p.toml", "--dry-run"],
    # Every answer is read before the folder is missed, so nothing is written.
    "dds-trace sweep new": ["gone/n.toml", "--send=imu @ 1", "--compare=nothing", "--relay=here"],
}
"""Arguments beside the one option that is tried."""

OF_RELAY = {"--type", "--relay-id"}


def options():
    """Every option with a value, of every command: a new one is tried without a word here."""
    return [
        (command, parameter.opts[0])
        for command, app in COMMANDS.items()
        for parameter in get_command(app).params
        if parameter.param_type_name == "option" and not parameter.is_flag
    ]


def arguments(command):
    named = [each for each in get_command(COMMANDS[command]).params if each.param_type_name == "argument"]
    return [(command, place) for place in range(len(named))]


OPTIONS = options()


@pytest.fixture
def nothing_recorded(monkeypatch, tmp_path):
    """A folder with a trace and a plan; commands check their options, and stop before any middleware or analysis."""
    for name in ("ROS_DOMAIN_ID", "RMW_IMPLEMENTATION"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").mkdir()
    (tmp_path / "p.toml").write_text(PLAN)

    def check_options(asked, *_, **__):
        asked.check()
        if asked.ping is not None:
            count_messages(asked.ping.messages, asked.duration_s, asked.ping.rate_hz or 10.0, asked.ping.warmup)
        raise NoEchoError("nothing is recorded here")

    def nothing_analyzed(*_, **__):
        raise MissingEventsError("nothing is analyzed here")

    monkeypatch.setattr("dds_trace.cli.record.run.record", check_options)
    monkeypatch.setattr("dds_trace.cli.doctor.all_checks", lambda _: [])
    monkeypatch.setattr("dds_trace.analyzer.pipeline.analyze", nothing_analyzed)
    monkeypatch.setattr("dds_trace.extensions.bags.analyze.analyze_topics", nothing_analyzed)
    monkeypatch.setattr("dds_trace.extensions.live.live.Watcher", nothing_analyzed)
    monkeypatch.setattr("dds_trace.extensions.campaigns.studio.desk.Desk", nothing_analyzed)
    # A rehearsal starts a real relay, which takes as long as a hundred other values.
    monkeypatch.setattr("dds_trace.extensions.campaigns.station.devices.rehearse_program", lambda *_: None)


def try_option(command, option, value):
    base = ["--role", "relay", "--out", "x.mcap"] if option in OF_RELAY else BASE[command]
    code, _, err = run(command, [*base, f"{option}={value}"])
    check_told(command, code, err)


each_option = pytest.mark.parametrize(
    ("command", "option"), OPTIONS, ids=["".join(each).replace(" ", "-") for each in OPTIONS]
)


@pytest.mark.keeps(16)
@pytest.mark.usefixtures("nothing_recorded")
@each_option
@settings(max_examples=6, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(value=hostile_values.texts())
def test_any_value_of_any_option_is_taken_or_refused_in_one_line(command, option, value):
    try_option(command, option, value)


@pytest.mark.slow
@pytest.mark.usefixtures("nothing_recorded")
@each_option
@settings(max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(value=hostile_values.texts())
def test_many_values_of_any_option_are_taken_or_refused_in_one_line(command, option, value):
    try_option(command, option, value)


@pytest.mark.usefixtures("nothing_recorded")
@pytest.mark.parametrize(("command", "place"), [each for command in COMMANDS for each in arguments(command)])
@settings(max_examples=6, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(value=hostile_values.texts())
def test_any_argument_is_taken_or_refused_in_one_line(command, place, value):
    given_ones = list(BASE[command])
    given_ones[place] = value
    code, _, err = run(command, given_ones)
    check_told(command, code, err)
