"""Round trips by struct and loops: what `analyzer` must find, written without it and without numpy."""

import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

EVENT = struct.Struct("<QQqqqqII")
STAGES = ("t1", "t2", "t3", "t4")


@dataclass(frozen=True)
class PlainRow:
    """One message and one relay; the fields are the measured columns of `roundtrips`."""

    scheduled_ns: int
    publish_ns: int
    receive_ns: int | None
    relay_in_ns: int | None
    relay_out_ns: int | None
    rtt_ns: int | None
    intermediate_ns: int | None
    latency_ns: int | None
    response_ns: int | None
    outcome: str
    duplicates: int
    reordered: bool


def plain_roundtrips(
    run_id: int, warmup: int, packed: Mapping[str, Iterable[bytes]]
) -> dict[tuple[int, int], PlainRow]:
    """(relay_id, sequence) -> row, for one run.

    Args:
        run_id: the run; events of others are ignored.
        warmup: messages with a sequence number below have no row.
        packed: events of `t1` ... `t4`, 56 bytes each; the same bytes twice are one event.
    """
    events = {stage: sorted({EVENT.unpack(data) for data in packed.get(stage, ())}) for stage in STAGES}
    events = {stage: [e for e in held if e[0] == run_id] for stage, held in events.items()}
    published: dict[int, tuple[int, int]] = {}
    for _, sequence, t, t0, *_ in events["t1"]:
        if sequence >= warmup:
            published[sequence] = min((t, t0), published.get(sequence, (t, t0)))
    relays = {e[7] for stage in STAGES[1:] for e in events[stage]} or {0}
    rows = {}
    for relay in sorted(relays):
        instants = {stage: _instants([e for e in events[stage] if e[7] == relay]) for stage in STAGES[1:]}
        recorded = bool(instants["t3"] or instants["t4"])
        replies = {s: min(found) for s, found in instants["t2"].items() if s in published}
        for sequence, (t1, t0) in published.items():
            t2, t3, t4 = (min(instants[s].get(sequence, ()), default=None) for s in STAGES[1:])
            rows[relay, sequence] = PlainRow(
                scheduled_ns=t0,
                publish_ns=t1,
                receive_ns=t2,
                relay_in_ns=t3,
                relay_out_ns=t4,
                rtt_ns=_less(t2, t1),
                intermediate_ns=_less(t4, t3),
                latency_ns=_half(_less(_less(t2, t1), _less(t4, t3))),
                response_ns=_less(t2, t0),
                outcome=_outcome(t2, t3, t4, recorded=recorded),
                duplicates=max(len(instants["t2"].get(sequence, ())) - 1, 0),
                reordered=t2 is not None and any(s > sequence and t < t2 for s, t in replies.items()),
            )
    return rows


def _instants(events: Iterable[tuple[int, ...]]) -> dict[int, set[int]]:
    found: dict[int, set[int]] = {}
    for event in events:
        found.setdefault(event[1], set()).add(event[2])
    return found


def _less(minuend: int | None, subtrahend: int | None) -> int | None:
    return None if minuend is None or subtrahend is None else minuend - subtrahend


def _half(value: int | None) -> int | None:
    return None if value is None else value // 2


def _outcome(t2: int | None, t3: int | None, t4: int | None, *, recorded: bool) -> str:
    for seen, outcome in ((t2, "completed"), (t4, "lost_return"), (t3, "lost_in_relay")):
        if seen is not None:
            return outcome
    return "lost_outbound" if recorded else "lost_unknown"
