from dataclasses import fields

import numpy as np
import polars as pl
import pytest
from roundtrip_frames import PLAIN
from trace_files import ping_session, relay_session, run

from dds_trace.analyzer.model import parameters
from dds_trace.analyzer.model.columns import ROUNDTRIP_COLUMNS, SUMMARY_COLUMNS
from dds_trace.analyzer.model.metrics import with_metrics
from dds_trace.analyzer.model.names import (
    group_words,
    name_groups,
    tell_apart,
    varying_parameters,
    where_alike,
    where_it_helps,
    where_it_varies,
)
from dds_trace.analyzer.model.parameters import (
    BRIDGE_MATCH_COLUMNS,
    CASE_COLUMNS,
    CELL_COLUMNS,
    CONTENDER_COLUMNS,
    MATCH_COLUMNS,
    PARAMETER_COLUMNS,
    PARAMETER_NAMES,
    SETTING_COLUMNS,
    KeyPart,
    Parameters,
    names_of,
    parameters_of,
    relay_domain_of,
)
from dds_trace.reports.book.groups import LATENCY_MEANING

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


def test_every_parameter_belongs_to_one_part():
    names = [name for part in KeyPart for name in names_of(part)]
    assert sorted(names) == sorted(PARAMETER_NAMES)
    assert tuple(field.name for field in fields(Parameters)) == PARAMETER_NAMES
    assert tuple(column.name for column in PARAMETER_COLUMNS) == PARAMETER_NAMES


def test_the_columns_of_the_first_contract_keep_their_places():
    first = (*PARAMETER_NAMES[:20],)
    assert tuple(column.name for column in SUMMARY_COLUMNS)[:20] == first
    assert tuple(column.name for column in ROUNDTRIP_COLUMNS)[3:23] == first


def test_slices_leave_out_what_they_say():
    devices = {"ping_device", "relay_device"}
    assert set(PARAMETER_NAMES) - set(MATCH_COLUMNS) == {"ping_domain_id", "relay_domain_id"}
    assert set(MATCH_COLUMNS) - set(BRIDGE_MATCH_COLUMNS) == {"bridge", "domain_mode"}
    assert CELL_COLUMNS == ("data_type", "payload_bytes", "rate_hz")
    assert set(MATCH_COLUMNS) - set(SETTING_COLUMNS) == set(CELL_COLUMNS)
    assert ("connectivity", "domain_mode", *CELL_COLUMNS, "ping_device", "relay_device") == CASE_COLUMNS
    assert all(devices <= set(columns) for columns in (BRIDGE_MATCH_COLUMNS, SETTING_COLUMNS))
    assert set(CONTENDER_COLUMNS) | set(CASE_COLUMNS) == set(MATCH_COLUMNS)
    assert not set(CONTENDER_COLUMNS) & set(CASE_COLUMNS)


@pytest.mark.parametrize("name", [name for name in dir(parameters) if name.endswith("_COLUMNS")])
def test_no_slice_names_a_parameter_twice(name):
    columns = getattr(parameters, name)
    assert len(set(columns)) == len(columns)


def test_a_relay_says_its_domain_itself():
    ping, relay = ping_session(domain_id=1), relay_session(domain_id=3)
    assert relay_domain_of(run(relay_domain_id=2), ping, relay) == 3
    assert relay_domain_of(run(relay_domain_id=2), ping, None) == 2
    assert relay_domain_of(run(relay_domain_id=None, bridge="none"), ping, None) == 1
    assert relay_domain_of(run(relay_domain_id=None, bridge="builtin"), ping, None) is None


def test_a_bridge_whose_far_side_nobody_names_stands_between_two_domains():
    key = parameters_of(run(relay_domain_id=None, bridge="builtin"), ping_session(), None)
    assert (key.relay_domain_id, key.domain_mode, key.relay_vendor) == (None, "different", None)


def test_keys_are_equal_by_their_values_and_sorted_with_null_last():
    ping = ping_session()
    with_relay, without = (parameters_of(run(), ping, relay) for relay in (relay_session(), None))
    assert with_relay == parameters_of(run(run_id=99), ping, relay_session(relay_id=5))
    assert sorted([without, with_relay], key=Parameters.order) == [with_relay, without]
    assert len({with_relay, without, parameters_of(run(), ping, None)}) == 2


STAMPS = ("scheduled_ns", "publish_ns", "receive_ns", "relay_in_ns", "relay_out_ns")


def metrics(t0=0, t1=0, t2=None, t3=None, t4=None):
    stamps = pl.DataFrame(
        dict(zip(STAMPS, ([t] for t in (t0, t1, t2, t3, t4)), strict=True)), schema=dict.fromkeys(STAMPS, pl.Int64)
    )
    row = with_metrics(stamps).row(0, named=True)
    return row["rtt_ns"], row["intermediate_ns"], row["latency_ns"], row["response_ns"]


def test_metrics_follow_their_formulas():
    # T0=100 planned, T1=107 sent, relay 5000..5040 on its own clock, T2=467 back.
    assert metrics(100, 107, 467, 5000, 5040) == (360, 40, 160, 367)


def test_half_a_nanosecond_is_rounded_down():
    assert metrics(0, 0, 101, 50, 60) == (101, 10, 45, 101)
    assert metrics(0, 0, 10, 50, 61) == (10, 11, -1, 10)  # -1 // 2, not 0


def test_a_missing_stamp_makes_null_never_0():
    assert metrics(1, 2) == (None, None, None, None)
    assert metrics(1, 2, t2=9) == (7, None, None, 8)
    assert metrics(1, 2, t2=9, t3=4) == (7, None, None, 8)
    assert metrics(1, 2, t3=4, t4=6) == (None, 2, None, None)
    assert metrics(None, 2, 9, 4, 6) == (7, 2, 2, None)


def test_times_since_boot_do_not_lose_nanoseconds():
    day = 86_400 * 10**9
    assert metrics(900 * day, 900 * day + 1, 900 * day + 4, 5, 6) == (3, 1, 1, 4)


RANDOM = np.random.default_rng(1)
WAYS = {
    "exponential": lambda count: RANDOM.exponential(1e6, count),
    "lognormal": lambda count: RANDOM.lognormal(0, 1, count) * 1e6,
    "Pareto": lambda count: (1 + RANDOM.pareto(2.5, count)) * 1e6,
    "2 % ten times as slow": lambda count: np.where(RANDOM.random(count) < 0.02, 1e7, 1e6),
}


def p99s(there, back):
    """p99 of the way out, and p99 of the latency, of messages with these two ways."""
    zero = np.zeros(len(there), np.int64)
    stamps = {"scheduled_ns": zero, "publish_ns": zero, "receive_ns": (there + back).astype(np.int64)}
    frame = with_metrics(pl.DataFrame({**stamps, "relay_in_ns": zero, "relay_out_ns": zero}))
    return np.quantile(there, 0.99), np.quantile(frame["latency_ns"].to_numpy(), 0.99)


@pytest.mark.parametrize("kind", WAYS)
def test_the_tail_of_the_latency_lies_below_that_of_one_way_as_reports_say(kind):
    there, back = WAYS[kind](200_000), WAYS[kind](200_000)
    one_way, latency = p99s(there, back)
    assert "20 to 50 % below" in LATENCY_MEANING
    assert 0.20 <= 1 - latency / one_way <= 0.50
    one_way, latency = p99s(there, there)  # slow both ways at once: nothing is hidden
    assert latency == pytest.approx(one_way, rel=0.01)
