import polars as pl
from roundtrip_frames import PLAIN

from dds_trace.analyzer.model.names import (
    group_words,
    name_groups,
    tell_apart,
    varying_parameters,
    where_alike,
    where_it_helps,
    where_it_varies,
)

# colour, wheels, and a number that follows the colour
CARS = [("red", 4, 1), ("red", 3, 1), ("blue", 4, 2), ("green", 4, 3)]


def colour(car):
    return car[0]


def wheels(car):
    return f"{car[1]} wheels"


def number(car):
    return f"number {car[2]}"


def test_a_part_that_varies_is_named_everywhere_though_it_follows_another():
    assert tell_apart(CARS, colour, [(where_it_varies, number)]) == [
        "red, number 1",
        "red, number 1",
        "blue, number 2",
        "green, number 3",
    ]


def test_a_part_that_only_follows_another_does_not_help():
    assert tell_apart(CARS, colour, [(where_it_helps, number), (where_it_helps, wheels)]) == [
        "red, 4 wheels",
        "red, 3 wheels",
        "blue, 4 wheels",
        "green, 4 wheels",
    ]


def test_only_names_that_are_alike_get_the_word():
    parts = [(where_alike, number), (where_alike, wheels)]
    assert tell_apart(CARS, colour, parts) == ["red, 4 wheels", "red, 3 wheels", "blue", "green"]


def test_nothing_is_said_of_one_and_of_none():
    parts = [(where_it_varies, number), (where_it_helps, wheels), (where_alike, wheels)]
    assert tell_apart(CARS[:1], colour, parts) == ["red"]
    assert tell_apart([], colour, parts) == []


def test_a_group_is_named_by_its_message_and_the_settings_that_vary():
    different = {"bridge": "builtin", "relay_domain_id": 6, "domain_mode": "different"}
    groups = pl.DataFrame([PLAIN, PLAIN | different, PLAIN | {"payload_bytes": 100, "depth": 1}])
    assert [name.split(", ") for name in name_groups(groups)] == [
        ["binary 33000 B at 10 Hz", "no bridge", "depth 10"],
        ["binary 33000 B at 10 Hz", "bridge builtin", "depth 10"],
        ["binary 100 B at 10 Hz", "no bridge", "depth 1"],
    ]


def test_a_group_in_words_has_vendor_bridge_message_and_what_varies():
    groups = pl.DataFrame([PLAIN, PLAIN | {"reliability": "best_effort"}])
    columns = varying_parameters(groups, PLAIN)
    assert group_words(groups.row(1, named=True), columns) == (
        "vendor=fastdds bridge=none data_type=binary payload_bytes=33000 rate_hz=10 reliability=best_effort"
    )
