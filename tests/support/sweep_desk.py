"""A folder for sweeps whose `dds-record` is a stand-in, with the invented traces that it copies."""

import json
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

from trace_files import Message, ping_events, ping_session, relay_events, relay_session, run, write_trace

from dds_trace.extensions.campaigns.plan.plan_file import parse_plan
from dds_trace.extensions.campaigns.run.state import SweepState
from dds_trace.extensions.campaigns.sweep import run_sweep
from dds_trace.tracefile.format.events import Stage

STAND_IN = Path(__file__).with_name("stand_in_recorder.py")
COMMAND = [sys.executable, "-I", "-S", str(STAND_IN)]

PLAN = """
[run]
messages = 4
warmup = 1
settle_seconds = 0
cutoff_seconds = 0
[axes]
rate = [100, 200]
"""
TWO_RELAYS = PLAN + 'reliability = ["reliable", "best_effort"]\n'
FIRST, SECOND = "ros2_same_binary_100Hz", "ros2_same_binary_200Hz"
THIRD, FOURTH = FIRST + "_best_effort", SECOND + "_best_effort"


class Heard:
    def __init__(self):
        self.begun, self.ended_cells, self.notes, self.relays = None, [], [], []

    def begin(self, cells, done):
        self.begun = (cells, done)

    def relay(self, name):
        self.relays.append(name)

    def cell(self, name, remaining):
        pass

    def ended(self, name, outcome, *, complete):
        self.ended_cells.append((name, outcome, complete))

    def note(self, text):
        self.notes.append(text)

    def end(self):
        pass


RUNS, MESSAGES, WARMUP = 6, 4, 1

# One message a millisecond, each reply 0.1 ms later than the one before.
TIMELINE = [
    Message(
        number,
        t0=number * 1_000_000,
        t1=number * 1_000_000,
        t3=number * 1_000_000 + 40_000,
        t4=number * 1_000_000 + 50_000,
        t2=number * 1_000_000 + 100_000 * (number + 1),
    )
    for number in range(WARMUP + MESSAGES)
]
LAST_LOST = [*TIMELINE[:-1], replace(TIMELINE[-1], t2=None)]


def write_ping(path, run_id, published=MESSAGES, state="finished", timeline=TIMELINE, others=()):
    described = run(
        run_id=run_id, planned_messages=MESSAGES, warmup_messages=WARMUP, published=published + WARMUP, state=state
    )
    events = ping_events(timeline[: published + WARMUP], run_id=run_id)
    for relay_id in others:
        events[Stage.T2] += ping_events(timeline, run_id=run_id, relay_id=relay_id)[Stage.T2]
    write_trace(path, ping_session(), [described], events)


def write_invented_traces(folder):
    for number in range(RUNS):
        write_ping(folder / f"ok-{number}.mcap", 1 + number)
    write_ping(folder / "half.mcap", 0x88, state="started")
    write_ping(folder / "slow.mcap", 0x99, published=MESSAGES // 2)
    write_ping(folder / "loses.mcap", 0xAA, timeline=LAST_LOST)
    write_ping(folder / "both.mcap", 0xBB, others=[0xDEAD])
    served = [relay_events(TIMELINE, run_id=run_id) for run_id in (*range(1, RUNS + 1), 0x99, 0xAA, 0xBB)]
    events = {stage: [row for rows in served for row in rows[stage]] for stage in (Stage.T3, Stage.T4)}
    write_trace(folder / "relay.mcap", relay_session(), (), events)
    write_trace(folder / "lossy.mcap", relay_session())


class Desk:
    def __init__(self, folder, invented_traces):
        self.folder = folder
        self.stand_in = folder / "stand-in"
        self.stand_in.mkdir()
        (self.stand_in / "traces").symlink_to(invented_traces)
        self.script()

    def script(self, **behaviours):
        (self.stand_in / "script.json").write_text(json.dumps(behaviours))

    def sweep(self, plan=PLAN, until=None):
        self.heard = Heard()
        return run_sweep(
            parse_plan(plan, "plan", "plan.toml"), self.folder / "runs", self.heard, command=COMMAND, until=until
        )

    @property
    def starts(self):
        path = self.stand_in / "starts.jsonl"
        return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []

    @property
    def started(self):
        return Counter(start["cell"] for start in self.starts)

    @property
    def traces(self):
        return sorted(path.name for path in (self.folder / "runs" / "plan").rglob("*.mcap"))

    def state(self, name, plan=PLAN):
        digest = parse_plan(plan, "plan", "plan.toml").digest
        return SweepState(self.folder / "runs" / "plan" / "state.json", "plan", digest)[name]


def files_of(*cells):
    return sorted(f"{cell}.{role}.mcap" for cell in cells for role in ("ping", "relay"))
