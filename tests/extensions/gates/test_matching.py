import polars as pl
import pytest
from roundtrip_frames import MS, in_runs, steady

from dds_trace.analyzer.model.parameters import MATCH_COLUMNS
from dds_trace.analyzer.model.setting import without_relay
from dds_trace.extensions.gates.compare import CompareOptions, compare_roundtrips
from dds_trace.extensions.gates.matching import match_groups

P50_ONLY = CompareOptions(metrics=("latency",), statistics=("p50",))
NO_RELAY = {"relay_vendor": None, "relay_backend": None, "relay_device": None, "relay_domain_id": None}


def settings_of(frame):
    return frame["setting"].to_list()


@pytest.mark.parametrize(
    ("setting", "known"),
    [
        ("relay.depth=3,tuned=true", "tuned=true"),
        ("relays=2,tuned=true", "tuned=true"),
        ("relay.tuned=default", ""),
        ("link=wifi-54(delay_ms=1,rate_mbit_s=54)", "link=wifi-54(delay_ms=1,rate_mbit_s=54)"),
    ],
)
def test_without_the_relays_trace_nothing_is_known_of_what_it_was_asked_for(setting, known):
    assert without_relay(setting) == known


@pytest.mark.parametrize("silent", ["base", "new"])
def test_a_relay_without_a_trace_matches_one_that_was_asked_otherwise_than_the_ping(silent):
    known = in_runs([5 * MS] * 20, setting="relay.depth=3,relays=2,tuned=true")
    unknown = in_runs([5 * MS] * 20, run_id=2, setting="tuned=true", **NO_RELAY)
    sides = (unknown, known) if silent == "base" else (known, unknown)
    found = compare_roundtrips(*sides, P50_ONLY)
    assert settings_of(found.delivery) == ["relay.depth=3,relays=2,tuned=true"]
    assert found.delivery["relay_vendor"].to_list() == ["fastdds"]
    assert (found.only_base.height, found.only_new.height) == (0, 0)


@pytest.mark.parametrize(
    ("base", "new"),
    [
        pytest.param({"setting": "relay.depth=3"}, {"setting": "relay.depth=4"}, id="two relays that left traces"),
        pytest.param({"setting": "relay.depth=3,tuned=true"}, {"setting": "", **NO_RELAY}, id="the ping otherwise"),
    ],
)
def test_what_was_asked_otherwise_is_not_compared(base, new):
    sides = in_runs([5 * MS] * 20, **base), in_runs([5 * MS] * 20, run_id=2, **new)
    assert compare_roundtrips(*sides, P50_ONLY).delivery.is_empty()


def test_of_relays_asked_for_two_things_nobody_knows_which_one_is_silent():
    base = pl.concat(in_runs([5 * MS] * 20, run_id=run_id, setting=f"relay.depth={run_id}") for run_id in (1, 2))
    silent = in_runs([None] * 20, run_id=3, setting="", **NO_RELAY)
    found = compare_roundtrips(base, silent, P50_ONLY)
    assert found.delivery.is_empty()
    assert settings_of(found.only_base) == ["relay.depth=1", "relay.depth=2"]


def test_a_run_that_lost_everything_counts_in_the_group_of_its_siblings():
    """Four runs are fine, of the fifth no message reached the relay: its rows name none."""
    base = in_runs([5 * MS] * 20, runs=5, setting="relay.depth=3")
    new = pl.concat(
        [
            in_runs([5 * MS] * 20, runs=4, run_id=2, setting="relay.depth=3"),
            steady([None] * 20, run_id=999, setting="", **NO_RELAY),
        ]
    )
    found = compare_roundtrips(base, new, P50_ONLY)
    (row,) = found.delivery.iter_rows(named=True)
    assert (row["new_runs"], row["new_published"], row["new_received_ratio"]) == (5, 100, pytest.approx(0.8))
    assert (found.only_base.height, found.only_new.height) == (0, 0)


def test_runs_with_replies_and_without_the_relays_trace_stay_apart():
    """Their latency is not known: counted with the others they would make it worse than it is."""
    rows = pl.concat(
        [in_runs([5 * MS] * 20), steady([5 * MS] * 20, run_id=8, **NO_RELAY), steady([None] * 20, run_id=9, **NO_RELAY)]
    )
    groups = match_groups(rows, MATCH_COLUMNS)
    assert [sorted(run.run_id for run in group.runs) for group in groups.values()] == [[8], [9, 100, 101, 102]]
