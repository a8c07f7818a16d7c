from __future__ import annotations

from dataclasses import fields

from dds_trace.recorder.sweep.plan.cells import AXES, RELAY_AXES, Cell


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
