"""A ping and a relay as real processes on any two backends, and their traces checked against each other."""

import numpy as np
from processes import ping, relay

from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.choices import Discovery
from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.reading.reader import read_trace

SIZES = {"binary": 33_000, "string": 1405, "imu": 296}
MESSAGES, WARMUP = 20, 3
ROOMY = ("--depth", 1000)
"""On a machine that is busy with other tests a node may sleep for longer than ten messages; keep_last 10 forgets then."""


def options(domain_id, **more):
    return NodeOptions(domain_id=domain_id, **{"name": "one", "discovery": Discovery.LOCALHOST, **more})


def events(trace, stage, run_id):
    columns = trace.events[stage]
    rows = np.flatnonzero(columns.run_id == run_id)
    return {int(columns.sequence[row]): row for row in rows}, columns


def assert_whole(ping_trace, relay_trace, *, has_source=False, may_miss=frozenset()):
    """Every message went there and back once, and its four time stamps are in order: one machine, one clock.

    `has_source` None: the middleware may leave its source time stamp out, as Fast DDS and Cyclone DDS do with a
    message of which a fragment was lost and sent again. `may_miss` are messages that the middleware is known to lose.
    """
    (run,) = ping_trace.runs
    relay_id = relay_trace.sessions[-1].relay_id
    tables = {
        stage: events(ping_trace if stage in (Stage.T1, Stage.T2) else relay_trace, stage, run.run_id)
        for stage in (Stage.T1, Stage.T3, Stage.T4, Stage.T2)
    }
    for stage, (rows, columns) in tables.items():
        whole = set(range(MESSAGES + WARMUP))
        assert whole - may_miss <= rows.keys() <= whole, stage
        assert {int(columns.payload_bytes[row]) for row in rows.values()} == {run.payload_bytes}
        ids = {int(columns.relay_id[row]) for row in rows.values()}
        assert ids == {0 if stage is Stage.T1 else relay_id}
        if stage in (Stage.T2, Stage.T3) and has_source is not None:
            assert all(bool(columns.source_ns[row]) is has_source for row in rows.values())
    for sequence in set(range(MESSAGES + WARMUP)) - may_miss:
        times = [int(columns.monotonic_ns[rows[sequence]]) for rows, columns in tables.values()]
        assert times == sorted(times)


def all_data_types(domain_id, folder, ping_backend, relay_backend, *more, relay_more=(), has_source=False):
    """Each data type there and back once; the sessions of the last ping and of the relay."""
    with relay(domain_id, folder / "relay.mcap", "--backend", relay_backend, *ROOMY, *more, *relay_more) as command:
        for data, size in SIZES.items():
            done = ping(
                *(domain_id, folder / f"{data}.mcap", "--backend", ping_backend, *ROOMY, *more),
                *("--data", data, "--size", size, "--messages", MESSAGES, "--warmup", WARMUP, "--rate", 50),
            )
            assert done.status == 0, done.stderr
        done = command.stop()
    assert done.status == 0, done.stderr
    relay_trace = read_trace(folder / "relay.mcap")
    for data in SIZES:
        trace = read_trace(folder / f"{data}.mcap")
        assert_whole(trace, relay_trace, has_source=has_source)
    sessions = trace.sessions[-1], relay_trace.sessions[-1]
    for session in sessions:
        floors = {name for name in session.extra if name.endswith("_floor") and session.extra[name]["median_ns"] > 0}
        assert floors == {"client_library_floor"} | ({"single_executor_floor"} if session.backend == "ros2" else set())
    return sessions
