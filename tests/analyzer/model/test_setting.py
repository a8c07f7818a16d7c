import math
from dataclasses import replace

import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from roundtrip_frames import MS, in_runs, steady
from trace_files import ping_session, relay_session, run

from dds_trace.analyzer.model.environment import environment_differences, environment_of
from dds_trace.analyzer.model.parameters import parameters_of
from dds_trace.analyzer.model.runs import delivered_runs, pass_numbers, split_runs, with_unsent
from dds_trace.analyzer.model.setting import choice_of, condition_of, parse_setting, setting_of, write_setting
from dds_trace.analyzer.verdicts.setup_runs import SetupRuns
from dds_trace.extensions.gates.compare import CompareOptions, compare_roundtrips
from dds_trace.extensions.gates.matching import passes_of
from dds_trace.tracefile.format.descriptions import Qos, Run

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


def values_of(frame, metric="latency"):
    return [run.values.tolist() for run in delivered_runs(split_runs(frame), metric)]


def test_lost_messages_are_infinitely_late_and_replies_without_stamps_take_half_their_round_trip():
    late = steady([5 * MS, None, 7 * MS])
    bare = late.with_columns(latency_ns=pl.when(pl.col("sequence") == 2).then(None).otherwise(pl.col("latency_ns")))
    assert bare["rtt_ns"][2] == 14 * MS + 1000
    assert values_of(bare) == [[5 * MS, math.inf, 7 * MS + 500]]


def test_a_group_without_any_latency_has_no_values_unless_everything_was_lost():
    bare = steady([MS, None]).with_columns(latency_ns=pl.lit(None, pl.Int64))
    assert values_of(bare) == [[]]
    assert values_of(steady([None, None])) == [[math.inf, math.inf]]


def test_relays_of_one_run_are_one_run_in_the_order_of_time():
    frame = pl.concat([steady([MS, 2 * MS], relay_id=1), steady([3 * MS, 4 * MS], relay_id=2)])
    assert values_of(frame) == [[MS, 3 * MS, 2 * MS, 4 * MS]]
    assert [run.run_id for run in split_runs(pl.concat([frame, steady([MS], run_id=7)]))] == [1, 7]


def described(run_id, **labels):
    return Run(run_id, "binary", 1, 1.0, 1, 0, labels=labels)


def test_passes_pair_runs_only_where_every_run_has_one():
    passes = pass_numbers([described(1, **{"pass": "1"}), described(2, **{"pass": "2"}), described(3, other="x")])
    assert passes == {1: 1, 2: 2}
    one, two, three = (split_runs(steady([MS], run_id=number)) for number in (1, 2, 3))
    assert passes_of(one, two, passes) == ([1], [2])
    assert passes_of(one, three, passes) is None
    assert passes_of((*one, *one), two, passes) is None


def test_they_are_lost_and_not_published():
    group = SetupRuns.of(with_unsent(steady([MS] * 20), {1: 5, 9: 3}))
    (run,) = group.delivered("latency")
    assert (group.published, len(run), int((run.values == float("inf")).sum())) == (20, 25, 5)
    assert group.received_share == pytest.approx(0.8)
    assert len(group.runs[0].sent_ns) == 20
    assert len(group.survivors("latency")) == 20


def test_a_side_that_does_not_send_its_messages_is_not_better():
    base, new = in_runs([5 * MS] * 40), in_runs([MS] * 10, run_id=2)
    unsent = dict.fromkeys(new["run_id"].unique().to_list(), 30)
    options = CompareOptions(metrics=("latency",), statistics=("p50",))
    (row,) = compare_roundtrips(base, with_unsent(new, unsent), options).rows.iter_rows(named=True)
    assert row["verdict"] == "worse"
    assert (row["new_ns"], row["new_survivors_ns"]) == (float("inf"), pytest.approx(MS, rel=0.05))
    assert row["new_received_ratio"] == pytest.approx(0.25)


def test_frames_without_unsent_messages_stay_as_they_are():
    frame = steady([MS] * 3)
    assert with_unsent(frame, {}).equals(frame)
    assert with_unsent(frame, {7: 2}).equals(frame)
    assert isinstance(delivered_runs(split_runs(frame), "latency")[0].values[0], float)
    assert with_unsent(frame, {1: 2}).schema == pl.Schema(frame.schema)
