"""Chaos in small: what a seed draws, what the checks see, and rounds over plain sockets (`just chaos` plays them by the hour)."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from chaos import line_of, play_round
from chaos_checks import Call, forgotten_cells, untrue_cell, untrue_exit
from chaos_draw import COMBINATIONS, NETWORKS, Fault, draw_round
from chaos_faults import FAULTS
from namespaces import needs_namespaces
from trace_files import Message, event, ping_session, relay_session, run, write_pair, write_trace

from dds_trace.extensions.campaigns.plan.plan_file import read_plan
from dds_trace.extensions.campaigns.plan.schedule import schedule
from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.reading.reader import read_trace

TIMELINE = [Message(n, t0=n * 100, t1=n * 100 + 1, t3=n, t4=n + 1, t2=n * 100 + 50) for n in range(6)]
SEEDS = range(200)


def test_every_seed_draws_a_plan_and_faults_that_there_are(tmp_path):
    drawn = [draw_round(seed, list(COMBINATIONS)) for seed in SEEDS]
    for one in drawn[:20]:
        (tmp_path / "plan.toml").write_text(one.plan)
        plan = read_plan(tmp_path / "plan.toml")
        assert sum(len(group.cells) for group in schedule(plan)) == one.cells
    assert {one.combination for one in drawn} == set(COMBINATIONS)
    assert {one.network for one in drawn} == set(NETWORKS)
    faults = [fault for one in drawn for call in one.calls for fault in call]
    assert {fault.kind for fault in faults} == set(FAULTS)
    assert drawn == [draw_round(seed, list(COMBINATIONS)) for seed in SEEDS]


@pytest.fixture
def sweep(tmp_path):
    def make(**statuses):
        cells = {name: {"status": status, "run_id": f"{n:x}"} for n, (name, status) in enumerate(statuses.items())}
        (tmp_path / "state.json").write_text(json.dumps({"cells": cells}))
        return tmp_path

    return make


KILL_SWEEP, FULL = Fault("kill", "sweep", 0.0, 0.0), Fault("full-disk", "", 0.0, 1.0)


@pytest.mark.parametrize(
    ("call", "states", "is_true"),
    [
        (Call(0, "", ()), {"a": "complete", "b": "complete"}, True),
        (Call(0, "", ()), {"a": "complete", "b": "recorded"}, False),
        (Call(0, "", ()), {"a": "complete"}, False),
        (Call(0, "Traceback (most recent call last)", ()), {"a": "complete", "b": "complete"}, False),
        (Call(10, "b: no echo", ()), {"a": "complete", "b": "failed"}, True),
        (Call(10, "", ()), {"a": "complete", "b": "failed"}, False),
        (Call(10, "", ()), {"a": "complete", "b": "complete"}, False),
        (Call(6, "the disk is full; free space", (FULL,)), {"a": "running"}, True),
        (Call(6, "the disk is full; free space", ()), {"a": "running"}, False),
        (Call(-9, "", (KILL_SWEEP,)), {"a": "running"}, True),
        (Call(-9, "", ()), {"a": "running"}, False),
        (Call(1, "", (KILL_SWEEP, FULL)), {"a": "running"}, False),
        (Call(130, "the same command continues", (Fault("interrupt", "", 0.0, 0.0),)), {"a": "failed"}, True),
        (Call(130, "the same command continues", ()), {"a": "failed"}, False),
    ],
)
def test_exit_codes_are_held_against_the_state(sweep, call, states, is_true):
    assert (list(untrue_exit(call, sweep(**states), 2)) == []) is is_true


def test_a_whole_cell_that_is_recorded_again_is_seen(sweep):
    folder = sweep(a="complete", b="recorded", c="failed")
    assert list(forgotten_cells({"a": "0", "b": "1"}, folder)) == []
    assert len(list(forgotten_cells({"a": "0", "b": "7", "c": "2", "d": "3"}, folder))) == 3


def cell_faults(tmp_path, messages=TIMELINE, **more):
    described = run(published=len(TIMELINE), labels={"cell": "a"})
    ping, relay = write_pair(tmp_path, messages, runs=[described], **more)
    return list(untrue_cell("a", read_trace(ping), read_trace(relay)))


def test_a_whole_cell_has_no_fault(tmp_path):
    assert cell_faults(tmp_path) == []
    lost = [replace(TIMELINE[0], t2=None), replace(TIMELINE[1], t2=None, t4=None, t3=None), *TIMELINE[2:]]
    assert cell_faults(tmp_path / "lost", lost) == []


@pytest.mark.parametrize(
    ("messages", "fault"),
    [
        ([replace(TIMELINE[0], t1=None), *TIMELINE[1:]], "T3 without T1"),
        ([replace(TIMELINE[0], t3=None), *TIMELINE[1:]], "a reply without T3"),
        ([replace(TIMELINE[0], t4=None), *TIMELINE[1:]], "a reply without T4"),
        (TIMELINE[1:], "published 6 and stamped 5"),
        ([TIMELINE[0], *TIMELINE], "T1 is there twice"),
    ],
)
def test_an_event_that_is_missing_or_doubled_is_seen(tmp_path, messages, fault):
    assert fault in cell_faults(tmp_path, messages)


def test_dropped_events_and_other_runs_are_seen(tmp_path):
    assert cell_faults(tmp_path / "a", relay=relay_session(dropped_events=1)) == ["the relay dropped events"]
    ping, _ = write_pair(tmp_path / "b", TIMELINE, runs=[run(published=6, labels={"cell": "a"})])
    events = {stage: [event(0, 5, run_id=77, relay_id=1)] for stage in (Stage.T3, Stage.T4)}
    other = write_trace(tmp_path / "b" / "other.mcap", relay_session(), (), events)
    assert "the relay has another run" in list(untrue_cell("a", read_trace(ping), read_trace(other)))
    twice = write_trace(tmp_path / "c.mcap", ping_session(), [run(), run(run_id=2)])
    assert len(list(untrue_cell("a", read_trace(twice), read_trace(other)))) == 1


@pytest.mark.middleware
@needs_namespaces("unshare", "util-linux")
@pytest.mark.parametrize(
    "seed",
    [
        pytest.param(4547, id="kill, outage, full disk"),
        pytest.param(1940, id="kill, stop", marks=pytest.mark.slow),
        pytest.param(4244, id="kill the sweep", marks=pytest.mark.slow),
    ],
)
def test_a_round_over_sockets(tmp_path, seed):
    folder = Path(tmp_path)
    line = play_round(seed, folder, ["socket:none"])
    assert line["wrong"] == [], line_of(line)
    assert line["faults"]
