from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from trace_files import ping_session, relay_session, run

from dds_trace.analyzer.model.environment import environment_differences, environment_of
from dds_trace.analyzer.model.parameters import parameters_of
from dds_trace.analyzer.model.setting import choice_of, condition_of, parse_setting, setting_of, write_setting
from dds_trace.tracefile.format.descriptions import Qos

LINK = "wifi-54(delay_ms=1,rate_mbit_s=54)"


def ping(**settings):
    return ping_session(extra={"settings": settings})


def relay(**settings):
    return relay_session(extra={"settings": settings})


def test_what_was_asked_for_is_sorted_and_what_has_a_column_is_left_out():
    asked = ping(tuned=True, transport="udp", reliability="best_effort", depth=3, cpu_affinity="2,3")
    same = relay(tuned=True, transport="udp", reliability="best_effort", depth=3, cpu_affinity="2,3")
    text = setting_of(run(), asked, same)
    assert text == "cpu_affinity=2%2C3,transport=udp,tuned=true"
    assert parse_setting(text) == {"cpu_affinity": "2,3", "transport": "udp", "tuned": "true"}


def test_the_relay_tells_where_it_was_asked_otherwise():
    assert setting_of(run(), ping(tuned=True), relay(depth=3)) == "relay.depth=3,relay.tuned=default,tuned=true"
    assert setting_of(run(), ping(), relay_session(rmw="rmw_fastrtps_dynamic_cpp")) == (
        "relay.rmw=rmw_fastrtps_dynamic_cpp"
    )


def test_the_run_tells_its_data_bridge_link_and_duration():
    one = run(
        qos=Qos(extra={"deadline_ns": 5_000_000}),
        extra={"settings": {"link": LINK}, "data_source": "bag:x", "bridge_running": True},
    )
    assert setting_of(one, ping(), None, relays=2, flows=3) == (
        f"bridge_running=true,data=bag:x,deadline_ns=5000000,flows=3,link={LINK},relays=2"
    )


def test_conditions_surround_a_run_and_the_rest_is_a_choice():
    text = f"flows=3,link={LINK},tuned=true"
    assert condition_of(text) == f"flows=3,link={LINK}"
    assert choice_of(text) == "tuned=true"


@pytest.mark.parametrize(
    ("middleware", "expected"),
    [
        ({"executor": "events", "transport": "default", "tuned": "false"}, ""),
        ({"executor": "single", "transport": "udp", "tuned": "true"}, "executor=single,transport=udp,tuned=true"),
        ({"tuned": "nothing to tune: the kernel does"}, "tuned=true"),
    ],
)
def test_an_older_recorder_tells_it_by_what_was_in_effect(middleware, expected):
    sides = (make(host={"middleware": middleware}, extra={}) for make in (ping_session, relay_session))
    assert setting_of(run(), *sides) == expected


def test_a_configuration_file_is_asked_for():
    host = {"configuration": {"CYCLONEDDS_URI": [{"name": "a.xml", "sha256": "0123456789"}]}}
    assert setting_of(run(), ping_session(host=host), relay_session(host=host)) == "CYCLONEDDS_URI=a.xml#01234567"


@given(st.dictionaries(st.text(min_size=1), st.text(), max_size=4))
def test_a_setting_is_read_as_it_was_written(values):
    assert parse_setting(write_setting(values)) == values


def test_tuned_and_untuned_are_two_groups():
    keys = {parameters_of(run(), ping(**asked), relay(**asked)) for asked in ({}, {"tuned": True})}
    assert len(keys) == 2


def test_the_environment_is_a_digest_of_what_lasts_on_both_sides():
    host = {"kernel": "6.1", "wifi": {"wlan0": 1}, "mtu": {"lo": 65536, "veth1": 1500}}
    one, other = ping_session(host=host), relay_session(host=host)
    again = replace(one, host={**host, "wifi": {}, "mtu": {"eth0": 1500, "lo": 65536}})
    newer = replace(other, host={**host, "kernel": "6.2"})
    digest = environment_of(one, other)
    assert len(digest) == 8
    assert int(digest, 16) >= 0
    assert environment_of(again, other) == digest
    assert environment_of(one, newer) != digest
    assert environment_differences([(one, other), (again, newer), (one, None)]) == {"relay kernel": ['"6.1"', '"6.2"']}
