import re
import sys
from dataclasses import fields
from importlib import import_module
from pathlib import Path

import jsonschema
import pytest

from dds_trace.extensions.campaigns.plan.cells import AXES, RELAY_AXES, Cell
from dds_trace.extensions.campaigns.plan.link import PRESETS, Link
from dds_trace.extensions.campaigns.plan.plan_file import parse_plan
from dds_trace.extensions.campaigns.plan.schema import POINTER, SCHEMA_FILE_NAME, TABLES, plan_schema, schema_text


def test_name_has_the_main_parameters_and_whatever_is_not_default():
    assert Cell(data="imu").name == "ros2_same_imu_10Hz"
    assert Cell(rmw="rmw_fastrtps_cpp", size=33_000).name == "ros2-fastrtps_same_binary-33KB_10Hz"
    assert (
        Cell(backend="cyclonedds", bridge="builtin", size=91, rate=0.5, depth=1, tuned=True, repeat=2).name
        == "cyclonedds_builtin_binary-91B_0.5Hz_depth-1_tuned_r2"
    )


def test_name_can_be_a_file_name_whatever_the_data():
    assert Cell(data="file:/home/x/a b.png").name == "ros2_same_file--home-x-a-b.png_10Hz"


CHANGES = {name: {bool: True, int: 3, float: 3.0}.get(axis.kind, "other") for name, axis in AXES.items()} | {
    "backend": "zenoh",
    "rmw": "rmw_x_cpp",
    "relay_backend": "cyclonedds",
    "relay_rmw": "rmw_y_cpp",
    "bridge": "builtin",
    "data": "imu",
    "size": 91,
    "rate": 11.0,
    "reliability": "best_effort",
    "durability": "transient_local",
    "history": "keep_all",
    "depth": 3,
    "serialization": "typed",
    "transport": "udp",
    "executor": "single",
    "tuned": True,
    "multicast": False,
    "environment": "/opt/kilted",
    "congestion_control": "reno",
    "load": "cpu",
    "call": "service",
    "security": "sign",
    "link": "air-30",
    "outage": 3.0,
    "outage_by": "loss",
    "priority": 3,
    "when_full": "drop",
    "repeat": 2,
    "flow": "imu",
    "with_flows": ("camera",),
}


def test_every_parameter_shows_in_the_name():
    assert set(CHANGES) == {field.name for field in fields(Cell)}
    names = {Cell(**{field: value}).name for field, value in CHANGES.items()}
    assert len(names | {Cell().name}) == len(CHANGES) + 1


def test_every_axis_is_a_field_and_a_relay_differs_only_in_those_that_concern_it():
    assert {*AXES, "repeat", "flow", "with_flows"} == {field.name for field in fields(Cell)}
    given = Cell(**{name: CHANGES[name] for name in AXES if name != "bridge"})
    changed = {name for name in AXES if getattr(given.relay, name) != getattr(Cell(), name)}
    assert changed == set(RELAY_AXES)


def test_across_a_bridge_the_link_is_secured_and_not_the_relay():
    assert Cell(security="sign").relay.security == "sign"
    assert Cell(security="encrypt-rtps", bridge="builtin-zenoh").relay == Cell().relay


def test_one_relay_serves_all_data_rates_and_bridges():
    need = Cell().relay
    assert Cell(data="imu", rate=500, bridge="builtin", size=91, repeat=3).relay == need
    assert Cell(reliability="best_effort").relay != need


def test_relay_of_another_vendor():
    cell = Cell(rmw="rmw_fastrtps_cpp", relay_backend="cyclonedds", depth=3)
    assert (cell.relay.backend, cell.relay.rmw, cell.relay.depth) == ("cyclonedds", None, 3)
    assert cell.name == "ros2-fastrtps_to-cyclonedds_same_binary_10Hz_depth-3"
    assert cell.relay_name == "cyclonedds depth-3"


def test_environment_has_the_name_of_its_folder_or_of_the_one_around_it():
    assert Cell(environment="/opt/kilted").name == "ros2_same_binary_10Hz_kilted"
    assert Cell(environment="/home/x/kilted/.venv/").name == "ros2_same_binary_10Hz_kilted"


def test_link_in_words(sentences):
    sentences(str(PRESETS["wifi-poor"]), str(Link()))


TEXT = (Path(__file__).parents[4] / "plans" / "tsc.toml").read_text()
BOARDS = '[devices.ping]\nname = "robot"\n[devices.relay]\nname = "base"\nssh = "user@base"\nsetup = ". /opt/ros/jazzy/setup.sh"\n'


def test_each_group_of_results_is_below_its_question():
    groups = TEXT.split("[[matrix]]")[:-1]
    assert all(re.search(r"\n# (Performance|WiFi): [^\n]+\n$", group) for group in groups)


def test_two_boards_have_the_same_results_without_namespaces():
    own = TEXT[: TEXT.rindex("[[matrix]]")]  # without outages
    text = own.replace("[network]\nnamespaces = true\n", "").replace("hosts = [2, 5]\n", "")
    plan = parse_plan(text + BOARDS, "tsc", "tsc.toml")
    assert plan.has_two_devices
    assert not plan.namespaces
    assert {cell.backend for cell in plan.cells} == {"ros2", "cyclonedds", "zenoh"}


if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

TOP = Path(__file__).parents[4]
PLANS = sorted((TOP / "plans").glob("*.toml"))
SCHEMA = jsonschema.Draft202012Validator(plan_schema())


def test_the_stored_schema_is_that_of_the_code():
    stored = (TOP / "plans" / SCHEMA_FILE_NAME).read_text(encoding="utf-8")
    assert stored == schema_text(), "run `just plan-schema`"


def test_the_schema_is_one_and_every_plan_of_ours_keeps_it():
    jsonschema.Draft202012Validator.check_schema(plan_schema())
    for path in PLANS:
        text = path.read_text(encoding="utf-8")
        assert text.startswith(POINTER + "\n")
        assert [error.message for error in SCHEMA.iter_errors(tomllib.loads(text))] == []


def test_every_key_is_in_the_reference_with_its_meaning_and_in_the_schema(monkeypatch):
    pytest.importorskip("sphinx", reason="the extra [docs] is not installed")
    monkeypatch.syspath_prepend(TOP / "docs")
    page, schema = import_module("generated.plan_keys").plan_keys(), plan_schema()
    for name, table in TABLES.items():
        place = schema
        for part in name.split(".") if name else ():
            place = place["properties"][part]
        if name != "thresholds":  # whose keys are names of metrics
            assert place["additionalProperties"] is False
        assert set(place["properties"]) == set(table.words)
        assert table.meaning in page
        for word, key in table.keys.items():
            assert f"| `{word}` |" in page
            assert key.meaning in page


@pytest.mark.parametrize(
    ("text", "is_refused"),
    [
        ("[axes]\nrate = [10, 20]\nsize = ['33KB', 91, '1.5 kib', '']\ntuned = [true, false]", False),
        ("[[axes]]\nrmw = ''\n[[axes]]\ndata = 'bag:x#/y'", False),
        ("[axes]\nrate = [10, '20']", True),
        ("[axes]\nsize = '33 apples'", True),
        ("[axes]\nbackend = 'installed'", False),
        ("[axes]\nrelay_backend = 'installed'", True),
        ("[axes]\nreason = 'x'", True),
        ("[[exclude]]\nreason = 'x'\nrate = 1", False),
        ("[run]\nmessages = 1\nseconds = 0", False),
        ("[run]\nmessages = 1\nseconds = 1", True),
        ("[run]\nmessages = 0", True),
        ("[run]\ndiscovery = 'lan'", True),
        ("[devices.ping]\nssh = 'me@there'", True),
        ("[devices.relay]\nssh = 'me@there'\nssh_options = '-4'", False),
        ("[search]\npercentile = 98", True),
        ("[search]\nresolution = 1", True),
        ("axes = 1", True),
        ("axes = [1]", True),
        ("axis = {}", True),
    ],
)
def test_the_schema_refuses_what_the_parser_refuses(text, is_refused):
    assert (not SCHEMA.is_valid(tomllib.loads(text))) == is_refused
