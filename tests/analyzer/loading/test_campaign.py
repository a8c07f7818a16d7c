import os
import random
import shutil

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import StoragePlugin, Writer
from trace_files import (
    RELAY_ID,
    RUN_ID,
    Message,
    event,
    ping_events,
    ping_session,
    relay_events,
    relay_session,
    run,
    write_pair,
    write_trace,
)

from dds_trace.analyzer.loading.event_index import (
    EventPart,
    index_events,
    merge_parts,
    split_events,
    split_trace,
    total_copies,
)
from dds_trace.analyzer.loading.place import default_output
from dds_trace.analyzer.pipeline import analyze
from dds_trace.base.errors import MissingEventsError, TraceFormatError
from dds_trace.tracefile.format.events import EVENT_DTYPE, EventColumns, Stage
from dds_trace.tracefile.reading.reader import read_trace

TIMELINE = [
    Message(s, t0=1000 * s, t1=1000 * s + 5, t3=1000 * s + 900, t4=1000 * s + 930, t2=1000 * s + 205) for s in range(12)
]
DESCRIBED = run(planned_messages=12, published=12)


def statuses(analysis):
    return {source.path: (source.status, source.events) for source in analysis.sources}


def codes(analysis):
    return [finding.code for finding in analysis.findings]


def test_a_pair_of_traces_gives_its_rows(tmp_path):
    write_pair(tmp_path, TIMELINE)
    analysis = analyze(tmp_path)
    assert statuses(analysis) == {"ping.mcap": ("read", 24), "relay.mcap": ("read", 24)}
    assert analysis.title == tmp_path.name
    assert analysis.load_roundtrips()["latency_ns"].to_list() == [85] * 12
    assert [session.role for session in analysis.sessions] == ["ping", "relay"]
    assert [described.run_id for described in analysis.runs] == [RUN_ID]
    assert analysis.outputs == {}


def test_the_same_file_twice_counts_once(tmp_path):
    ping, _ = write_pair(tmp_path, TIMELINE)
    once = analyze(tmp_path)
    shutil.copy(ping, tmp_path / "ping (copy).mcap")
    twice = analyze(tmp_path)
    assert twice.load_roundtrips().equals(once.load_roundtrips())
    assert twice.summary.equals(once.summary)
    assert statuses(twice) == {
        "ping (copy).mcap": ("read", 24),
        "ping.mcap": ("duplicate", 0),
        "relay.mcap": ("read", 24),
    }
    (finding,) = [f for f in twice.findings if f.code == "duplicate_file"]
    assert finding.where == "ping.mcap"
    assert "ping (copy).mcap" in finding.what


def test_another_form_of_the_same_session_counts_once(tmp_path):
    """As `ros2 bag convert` leaves it: other file, other storage options, the same events."""
    write_pair(tmp_path, TIMELINE)
    once = analyze(tmp_path)
    other_form = {"compression": "none", "chunked": False}
    write_trace(tmp_path / "converted" / "ping.mcap", ping_session(), [DESCRIBED], ping_events(TIMELINE), **other_form)
    both = analyze(tmp_path)
    assert both.load_roundtrips().equals(once.load_roundtrips())
    assert statuses(both)["ping.mcap"] == ("duplicate", 0)
    assert "duplicate_file" in codes(both)


def convert(source, folder, storage):
    """What `ros2 bag convert` makes of a file: the same messages in a rosbag2 folder."""
    with source.open("rb") as stream, Writer(folder, version=9, storage_plugin=storage) as bag:
        connections = {}
        for schema, channel, message in make_reader(stream).iter_messages():
            if channel.topic not in connections:
                connections[channel.topic] = bag.add_connection(
                    channel.topic, schema.name, msgdef=schema.data.decode(), rihs01="RIHS01_" + "0" * 64
                )
            bag.write(connections[channel.topic], message.log_time, message.data)


@pytest.mark.parametrize("storage", list(StoragePlugin), ids=lambda plugin: plugin.name.lower())
def test_bags_analyze_to_the_same_result_and_count_once_beside_their_files(tmp_path, storage):
    files = write_pair(tmp_path / "files", TIMELINE)
    for file in files:
        convert(file, tmp_path / "bags" / file.stem, storage)
    once = analyze(tmp_path / "files")
    of_bags = analyze(tmp_path / "bags")
    assert of_bags.load_roundtrips().equals(once.load_roundtrips())
    assert of_bags.summary.equals(once.summary)
    assert statuses(of_bags) == {"ping": ("read", 24), "relay": ("read", 24)}
    both = analyze(tmp_path)
    assert both.load_roundtrips().equals(once.load_roundtrips())
    assert statuses(both) == {
        "bags/ping": ("read", 24),
        "bags/relay": ("read", 24),
        "files/ping.mcap": ("duplicate", 0),
        "files/relay.mcap": ("duplicate", 0),
    }


def test_a_bag_given_by_name_keeps_results_beside_it(tmp_path):
    ping, _ = write_pair(tmp_path, TIMELINE)
    convert(ping, tmp_path / "bag", StoragePlugin.SQLITE3)
    assert statuses(analyze(tmp_path / "bag")) == {"bag": ("read", 24)}
    assert default_output(tmp_path / "bag") == tmp_path / "analysis"
    assert default_output(ping) == tmp_path / "analysis"
    assert default_output(tmp_path) == tmp_path / "analysis"


def test_a_copy_taken_before_the_end_adds_what_it_has(tmp_path):
    write_pair(tmp_path, TIMELINE)
    once = analyze(tmp_path)
    cut = run(state="started", planned_messages=12, published=0)
    write_trace(tmp_path / "early.mcap", ping_session(state="open"), [cut], ping_events(TIMELINE[:5]))
    both = analyze(tmp_path)
    assert both.load_roundtrips().equals(once.load_roundtrips())
    assert statuses(both)["early.mcap"] == ("read", 10)
    assert statuses(both)["ping.mcap"] == ("read", 14)
    assert "overlapping_files" in codes(both)
    assert "unclosed_session" not in codes(both)  # the later description counts
    assert "unfinished_run" not in codes(both)


def test_a_relay_trace_split_over_files_is_put_together(tmp_path):
    write_pair(tmp_path, TIMELINE)
    whole = analyze(tmp_path)
    (tmp_path / "relay.mcap").unlink()
    for part, messages in enumerate((TIMELINE[:4], TIMELINE[4:9], TIMELINE[9:])):
        write_trace(tmp_path / f"relay_{part}.mcap", relay_session(), (), relay_events(messages))
    split = analyze(tmp_path)
    assert split.load_roundtrips().equals(whole.load_roundtrips())
    assert split.summary.equals(whole.summary)
    assert codes(split) == codes(whole)
    assert len(split.sessions) == 2


def test_ping_and_relay_merged_into_one_file_are_told_apart(tmp_path):
    write_pair(tmp_path / "two", TIMELINE)
    events = ping_events(TIMELINE) | relay_events(TIMELINE)
    write_trace(tmp_path / "one" / "all.mcap", [ping_session(), relay_session()], [DESCRIBED], events)
    assert analyze(tmp_path / "one").load_roundtrips().equals(analyze(tmp_path / "two").load_roundtrips())


def test_a_mixed_folder_names_what_is_no_trace(tmp_path):
    write_pair(tmp_path / "monday", TIMELINE)
    (tmp_path / "notes.txt").write_text("windy")
    (tmp_path / "broken.mcap").write_bytes(b"not at all")
    (tmp_path / ".hidden").write_text("")
    analysis = analyze(tmp_path, out=tmp_path / "analysis")
    assert statuses(analysis) == {
        "broken.mcap": ("skipped", 0),
        "monday/ping.mcap": ("read", 24),
        "monday/relay.mcap": ("read", 24),
        "notes.txt": ("skipped", 0),
    }
    assert all(source.detail for source in analysis.sources if source.status == "skipped")
    assert [f.where for f in analysis.findings if f.code == "skipped_file"] == ["broken.mcap", "notes.txt"]


def test_what_a_sweep_writes_beside_its_traces_is_passed_over(tmp_path):
    write_pair(tmp_path / "runs", TIMELINE)
    for name in ("state.json", "max_rate.json", "max_rate.csv", "max_rate.svg"):
        (tmp_path / "runs" / name).write_text("{}")
    analysis = analyze(tmp_path)
    assert {source.status for source in analysis.sources} == {"read"}
    assert "skipped_file" not in codes(analysis)


def test_own_output_is_no_input(tmp_path):
    write_pair(tmp_path, TIMELINE)
    first = analyze(tmp_path, out=tmp_path / "analysis")
    write_pair(tmp_path / "analysis", TIMELINE)  # even traces in there
    again = analyze(tmp_path, out=tmp_path / "analysis")
    assert statuses(again) == statuses(first)
    assert statuses(analyze(tmp_path)) == statuses(first)


def test_an_empty_folder_is_an_error(tmp_path):
    with pytest.raises(MissingEventsError, match="the folder is empty"):
        analyze(tmp_path)


def test_a_folder_without_any_trace_names_what_is_there(tmp_path):
    (tmp_path / "a.mcap").write_bytes(b"")
    (tmp_path / "b.txt").write_text("b")
    with pytest.raises(MissingEventsError, match=r"a\.mcap.*b\.txt"):
        analyze(tmp_path)


def test_a_folder_that_is_not_there_is_an_error(tmp_path):
    with pytest.raises(MissingEventsError, match="no such"):
        analyze(tmp_path / "nowhere")


def test_one_file_given_by_name_is_analyzed_alone(tmp_path):
    ping, _ = write_pair(tmp_path, TIMELINE)
    analysis = analyze(ping)
    assert statuses(analysis) == {"ping.mcap": ("read", 24)}
    assert set(analysis.load_roundtrips()["outcome"]) == {"completed"}
    ping.write_bytes(b"no trace")
    with pytest.raises(TraceFormatError, match=r"ping\.mcap"):
        analyze(ping)


def test_relays_alone_are_an_error(tmp_path):
    _, relay = write_pair(tmp_path, TIMELINE)
    (tmp_path / "ping.mcap").unlink()
    with pytest.raises(MissingEventsError, match="add the trace of the ping"):
        analyze(relay)


def test_a_truncated_trace_is_used_to_its_end(tmp_path):
    write_pair(tmp_path, TIMELINE)
    plain = {"chunk_bytes": 300, "indexed": False, "statistics": False}
    relay = write_trace(tmp_path / "relay.mcap", relay_session(), (), relay_events(TIMELINE), **plain)
    os.truncate(relay, relay.stat().st_size * 2 // 3)
    analysis = analyze(tmp_path)
    status, events = statuses(analysis)["relay.mcap"]
    assert status == "truncated"
    assert 0 < events < 24
    found = codes(analysis)
    assert "truncated_file" in found
    assert "relay_trace_gaps" in found  # messages came back that the relay's trace does not know
    latencies = analysis.load_roundtrips()["latency_ns"]
    assert latencies.null_count() > 0
    assert set(latencies.drop_nulls()) == {85}


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
