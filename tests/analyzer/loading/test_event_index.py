import random

import numpy as np
from trace_files import RELAY_ID, RUN_ID, Message, event, relay_events, relay_session, write_pair, write_trace

from dds_trace.analyzer.loading.event_index import (
    EventPart,
    index_events,
    merge_parts,
    split_events,
    split_trace,
    total_copies,
)
from dds_trace.tracefile.format.events import EVENT_DTYPE, EventColumns, Stage
from dds_trace.tracefile.reading.reader import read_trace

TIMELINE = [
    Message(s, t0=1000 * s, t1=1000 * s + 5, t3=1000 * s + 900, t4=1000 * s + 930, t2=1000 * s + 205) for s in range(12)
]


def test_events_of_runs_that_take_turns_are_told_apart():
    fields = [event(s, s, run_id=1 + s % 3, relay_id=s % 2) for s in range(30)]
    random.Random(1).shuffle(fields)
    split = split_events(EventColumns.from_records(np.array(fields, EVENT_DTYPE)), by_relay=True)
    assert {key: columns.sequence.tolist() for key, columns in split.items()} == {
        (run_id, relay_id): [f[1] for f in fields if (f[0], f[7]) == (run_id, relay_id)]
        for run_id in (1, 2, 3)
        for relay_id in (0, 1)
    }


def test_what_was_copied_is_counted_per_trace(tmp_path):
    write_pair(tmp_path, TIMELINE)
    write_trace(tmp_path / "part.mcap", relay_session(), (), relay_events(TIMELINE[:3]))
    traces = [read_trace(tmp_path / name) for name in ("ping.mcap", "relay.mcap", "part.mcap")]
    index = index_events(split_trace(trace.events, position) for position, trace in enumerate(traces))
    copies = total_copies(copy for parts in index.values() for copy in merge_parts(parts)[1])
    assert [(copy.trace, copy.events, copy.others) for copy in copies] == [(2, 6, (1,))]
    arrivals = index[Stage.T3, RUN_ID, RELAY_ID]
    assert len(merge_parts(arrivals)[0]) == 12
    assert [part.trace for part in arrivals] == [1, 2]
    assert (Stage.T3, RUN_ID, 1) not in index


def test_the_index_has_a_row_per_stage_run_relay_and_trace(tmp_path):
    write_pair(tmp_path, TIMELINE)
    traces = [read_trace(tmp_path / name) for name in ("ping.mcap", "relay.mcap")]
    index = index_events(split_trace(trace.events, position) for position, trace in enumerate(traces))
    rows = {key: [(part.trace, part.count, part.first_ns) for part in parts] for key, parts in index.items()}
    assert rows == {
        (Stage.T1, RUN_ID, 0): [(0, 12, 5)],  # a publication is for every relay
        (Stage.T2, RUN_ID, RELAY_ID): [(0, 12, 205)],
        (Stage.T3, RUN_ID, RELAY_ID): [(1, 12, 900)],
        (Stage.T4, RUN_ID, RELAY_ID): [(1, 12, 930)],
    }


def test_events_are_fetched_only_when_they_are_wanted():
    columns = EventColumns.from_records(np.array([event(3, 30), event(1, 10)], EVENT_DTYPE))

    class Shelved:
        fetched = 0

        def load(self):
            Shelved.fetched += 1
            return columns

    part = EventPart(0, 2, 10, 30, Shelved())
    assert Shelved.fetched == 0
    assert merge_parts([part]) == (columns, ())
    assert Shelved.fetched == 1
    assert EventPart(0, 2, 10, 30, columns).load() is columns
    assert len(merge_parts([])[0]) == 0
