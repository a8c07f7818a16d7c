"""Pings and relays are killed in the middle of a run: no T3 without its T1, no T2 without its T3 and T4.

`DDS_TRACE_KILLS` says how many of each role are killed altogether, 200 by default.
"""

import os
import random
import signal
import time
from functools import partial

import pytest
from middlewares import needs
from processes import relay, running
from waiting import wait_until

from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.format.ring import events_by_stage, read_ring, ring_path
from dds_trace.tracefile.reading.reader import read_trace

KILLS = int(os.environ.get("DDS_TRACE_KILLS", "200"))
LONGEST_S = 0.4
"""A kill comes so long after the first reply at the latest."""

BACKENDS = ("ros2", "cyclonedds", "socket")
LOADS = {
    "1kHz": ("--data", "string", "--rate", 1000, "--messages", 600_000),
    "4MB": ("--data", "string", "--size", "4MB", "--rate", 20, "--messages", 12_000),
}
EACH = -(-KILLS // (len(BACKENDS) * len(LOADS)))

pytestmark = [
    pytest.mark.slow,
    pytest.mark.middleware,
    pytest.mark.timeout(3600),
    pytest.mark.parametrize("load", LOADS),
    pytest.mark.parametrize("backend", [pytest.param(name, marks=needs(name)) for name in BACKENDS]),
]


def start_ping(domain_id, out, backend, load):
    return running(
        *("dds-record", "--role", "ping", "--domain", domain_id, "--out", out, "--backend", backend),
        *("--discovery", "localhost", "--warmup", 0, *LOADS[load]),
    )


def start_relay(domain_id, out, backend):
    return relay(domain_id, out, "--backend", backend, "--discovery", "localhost")


def has_reply(out):
    ring = ring_path(out)
    contents = read_ring(ring, 0) if ring.exists() else None
    return contents is not None and Stage.T2 in dict(events_by_stage(contents.slots))


def events(path, stage, **of):
    """Set of (run, sequence) of a stage in trace and ring, of one relay alone if given."""
    columns = read_trace(path).events[stage]
    kept = columns.take(columns.relay_id == of["relay_id"]) if of else columns
    return set(zip(kept.run_id.tolist(), kept.sequence.tolist(), strict=True))


def test_killed_pings_leave_no_t3_without_t1(domain_id, tmp_path, backend, load):
    moment, outs = random.Random(f"ping {backend} {load}"), []
    with start_relay(domain_id, tmp_path / "relay.mcap", backend) as other:
        for number in range(EACH):
            outs.append(tmp_path / f"ping{number}.mcap")
            with start_ping(domain_id, outs[-1], backend, load) as command:
                wait_until(lambda: has_reply(outs[-1]))
                time.sleep(moment.random() * LONGEST_S)
                command.send_signal(signal.SIGKILL)
                assert command.finish().status == -signal.SIGKILL
        assert other.stop().status == 0
    sent = set().union(*(events(out, Stage.T1) for out in outs))
    relayed = events(tmp_path / "relay.mcap", Stage.T3)
    assert len(relayed) > 0
    assert relayed - sent == set()


def test_killed_relays_leave_no_t2_without_t3_and_t4(domain_id, tmp_path, backend, load):
    moment, answered = random.Random(f"relay {backend} {load}"), 0
    for number in range(EACH):
        out, other_out = tmp_path / f"ping{number}.mcap", tmp_path / f"relay{number}.mcap"
        with start_relay(domain_id, other_out, backend) as other, start_ping(domain_id, out, backend, load) as command:
            wait_until(partial(has_reply, out))
            time.sleep(moment.random() * LONGEST_S)
            other.send_signal(signal.SIGKILL)
            assert other.finish().status == -signal.SIGKILL
            command.stop()
        relay_id = read_trace(other_out).sessions[0].relay_id
        replies = events(out, Stage.T2, relay_id=relay_id)
        assert replies - events(other_out, Stage.T3) == set()
        assert replies - events(other_out, Stage.T4) == set()
        answered += len(replies)
    assert answered > 0
