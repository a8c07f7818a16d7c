import random
import shutil
import signal
import subprocess
import sys
import time

import full_rate_recorder
import numpy as np
import pytest
from full_rate_recorder import PROGRESS_BYTES, RUN_ID, STATE_CLOSED, STATE_CLOSING, fields_of, read_progress
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader

from dds_trace.extensions.bags.recover_trace import recover
from dds_trace.tracefile.format.events import EVENT_DTYPE, Stage
from dds_trace.tracefile.format.ring import ring_path
from dds_trace.tracefile.reading.reader import read_trace

LONGEST_S = 0.25
CLOSING_EVENTS = 20_000


def start(folder, threads, *events):
    trace, progress = folder / "killed.mcap", folder / "progress"
    progress.write_bytes(bytes(threads * PROGRESS_BYTES))
    command = [sys.executable, full_rate_recorder.__file__, trace, progress, threads, *events]
    return subprocess.Popen([str(part) for part in command]), trace, progress


def wait_for(process, is_so):
    while not is_so():
        assert process.poll() in (None, 0), "the recorder ended by itself"
        time.sleep(0.0005)


def kill(process):
    process.send_signal(signal.SIGKILL)
    process.wait()


def events_by_public_reader(path):
    """The events of each stage, every CRC checked; the summary has to agree with the content."""
    with path.open("rb") as stream:
        summary = make_reader(stream, validate_crcs=True).get_summary()
    topics = {channel.id: channel.topic for channel in summary.channels.values()}
    found: dict[str, list[bytes]] = {topic: [] for topic in topics.values()}
    latest = 0
    with path.open("rb") as stream:
        for record in StreamReader(stream, validate_crcs=True).records:
            if isinstance(record, Message):
                topic = topics[record.channel_id]
                assert record.log_time >= latest
                assert record.sequence == len(found[topic])
                latest = record.log_time
                found[topic].append(record.data)
    counts = summary.statistics.channel_message_counts
    assert {topics[channel]: count for channel, count in counts.items()} == {t: len(f) for t, f in found.items()}
    return {
        stage: np.frombuffer(b"".join(data[4:] for data in found.get(stage.topic, ())), EVENT_DTYPE) for stage in Stage
    }


def check_whole(trace, progress, threads):
    """Recover beside and in place; nothing that returned from `record` is missing, nothing is there twice."""
    told = read_progress(progress, threads)
    as_it_is = read_trace(trace)
    shutil.copy(trace, trace.with_name("before.mcap"))
    beside = trace.with_name("beside.mcap")
    report = recover(trace, beside)
    assert trace.read_bytes() == trace.with_name("before.mcap").read_bytes()
    in_place = recover(trace)
    assert (in_place.file_events, in_place.ring_events) == (report.file_events, report.ring_events)
    assert not ring_path(trace).exists()
    events = events_by_public_reader(trace)
    assert as_it_is.ring_events == report.ring_events
    for stage, columns in as_it_is.events.items():
        assert (columns.monotonic_ns == events[stage]["monotonic_ns"]).all()
        assert (columns.sequence == events[stage]["sequence"]).all()
    if report.recovered:
        assert report.missing_events == 0
        assert report.damaged_chunks == 0
        assert beside.read_bytes() == trace.read_bytes()
    kept = sum(map(len, events.values()))
    assert kept == report.file_events + report.ring_events
    assert sum(t.stamped for t in told) <= kept + report.dropped_events <= sum(t.begun for t in told)
    for thread in range(threads):
        of_thread = next(
            part[part["relay_id"] == thread + 1]
            for stage, part in events.items()
            if stage.value == f"t{thread % 4 + 1}"
        )
        sequences = of_thread["sequence"].astype(np.int64)
        assert (np.diff(sequences) > 0).all()  # in order, none twice
        source, received, scheduled, payload, _, _ = fields_of(thread, sequences)
        assert (of_thread["run_id"] == RUN_ID).all()
        assert (of_thread["source_ns"] == source).all()
        assert (of_thread["received_ns"] == received).all()
        assert (of_thread["scheduled_ns"] == scheduled).all()
        assert (of_thread["payload_bytes"] == payload).all()
        if report.dropped_events == 0 and len(sequences):
            assert sequences[-1] == len(sequences) - 1  # no gap


def kill_while_recording(folder, moment, threads):
    process, trace, progress = start(folder, threads)
    wait_for(process, lambda: read_progress(progress, 1)[0].begun > 0)
    time.sleep(moment.random() * LONGEST_S)
    kill(process)
    check_whole(trace, progress, threads)


@pytest.mark.keeps(4)
@pytest.mark.parametrize("attempt", range(10))
def test_killed_while_recording_at_full_rate(tmp_path, attempt):
    kill_while_recording(tmp_path, random.Random(attempt), threads=1 + attempt % 3)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_killed_at_sixty_random_moments(tmp_path):
    moment = random.Random()
    for attempt in range(60):
        folder = tmp_path / str(attempt)
        folder.mkdir()
        kill_while_recording(folder, moment, threads=1 + attempt % 3)
        shutil.rmtree(folder)


@pytest.mark.keeps(2)
@pytest.mark.parametrize("attempt", range(8))
def test_killed_while_closing(tmp_path, attempt):
    process, trace, progress = start(tmp_path, 1, CLOSING_EVENTS)
    wait_for(process, lambda: read_progress(progress, 1)[0].state >= STATE_CLOSING)
    time.sleep(attempt * 0.001)
    kill(process)
    assert read_progress(progress, 1)[0].state in (STATE_CLOSING, STATE_CLOSED)
    check_whole(trace, progress, 1)


@pytest.mark.keeps(2)
@pytest.mark.parametrize("attempt", range(6))
def test_killed_while_starting(tmp_path, attempt):
    process, trace, progress = start(tmp_path, 1)
    wait_for(process, trace.exists)
    time.sleep(attempt * 0.0004)
    kill(process)
    if trace.stat().st_size > 1000 or ring_path(trace).exists():  # the session is in one of them
        check_whole(trace, progress, 1)
