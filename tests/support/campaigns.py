"""Campaigns of several runs in files of their own, and two analyses of one compared."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
from trace_files import (
    WALL_ANCHOR_NS,
    Event,
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

from dds_trace.analyzer.analysis import Analysis
from dds_trace.tracefile.format.events import Stage

MESSAGES = 40
MS = 1_000_000


def write_runs(
    folder: Path, numbers: Iterable[int], *, latency_ns: int = 100, groups: int = 1, received: Collection[Stage] = ()
) -> None:
    """`pingN.mcap` and `relayN.mcap` of each number: 40 messages, every seventh lost, latency rising with the run.

    Args:
        folder: where; made if it is not there.
        numbers: of the runs.
        latency_ns: of the first message of run 0.
        groups: payload sizes that the runs have in turn.
        received: stages (T3, T2) whose events have the middleware's stamps: sent 2 ns after T1 or T4, received 5 ns before.
    """
    for number in numbers:
        start = number * 1000 * MS
        messages = [
            Message(
                s,
                t0=start + s * MS,
                t1=start + s * MS + 3,
                t3=start + s * MS + 50,
                t4=start + s * MS + 60,
                t2=None if s % 7 == 6 else start + s * MS + 13 + 2 * (latency_ns + s + 1000 * number),
            )
            for s in range(MESSAGES)
        ]
        held = run(
            run_id=7 + number,
            payload_bytes=1000 + number % groups,
            planned_messages=MESSAGES,
            published=MESSAGES,
            extra={"session_id": f"{1 + number:016x}"},
        )
        fields = {"run_id": held.run_id, "payload_bytes": held.payload_bytes, "relay_id": 0xBEEF}
        of_ping, of_relay = ping_events(messages, **fields), relay_events(messages, **fields)
        for stage, events in ((Stage.T2, of_ping), (Stage.T3, of_relay)):
            if stage in received:
                events[stage] = [_stamped(messages[s], stage, **fields) for _, s, *_ in events[stage]]
        write_trace(folder / f"ping{number}.mcap", ping_session(session_id=1 + number), [held], of_ping)
        relay = relay_session(session_id=1001 + number, relay_id=0xBEEF)
        write_trace(folder / f"relay{number}.mcap", relay, (), of_relay)


def write_run(
    folder: Path,
    number: int,
    messages: Sequence[Message],
    *,
    ping: Mapping[str, Any] | None = None,
    relay: Mapping[str, Any] | None = None,
    **described: Any,
) -> None:
    """`ping.mcap` and `relay.mcap` of run 70 + number, with further fields of its sessions and its description."""
    fields = {"run_id": 70 + number, "planned_messages": len(messages), "published": len(messages), **described}
    fields["extra"] = {"session_id": f"{50 + number:016x}", **fields.get("extra", {})}
    write_pair(
        folder,
        messages,
        ping=ping_session(session_id=50 + number, **ping or {}),
        relay=relay_session(session_id=5000 + number, **relay or {}),
        runs=[run(**fields)],
    )


def _stamped(message: Message, stage: Stage, **fields: int) -> Event:
    sent, came = (message.t4, message.t2) if stage is Stage.T2 else (message.t1, message.t3)
    assert sent is not None
    assert came is not None
    wall_ns = WALL_ANCHOR_NS - ping_session().monotonic_anchor_ns
    return event(message.sequence, came, source_ns=wall_ns + sent + 2, received_ns=wall_ns + came - 5, **fields)


def assert_same_results(found: Analysis, expected: Analysis) -> None:
    assert found.load_roundtrips().equals(expected.load_roundtrips())
    assert found.summary.equals(expected.summary)
    assert found.distributions.equals(expected.distributions)
    assert found.timeline.equals(expected.timeline)
    assert found.findings == expected.findings
    assert found.sources == expected.sources
    assert found.runs == expected.runs


@pytest.fixture
def runs(tmp_path):
    """A folder of six runs of three groups, of 1000, 1001 and 1002 bytes in turn."""
    write_runs(tmp_path / "runs", range(6), groups=3)
    return tmp_path / "runs"
