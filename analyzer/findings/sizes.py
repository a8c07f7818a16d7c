"""Checks of latency over message size: where it falls or jumps as messages grow, and the cause if the traces show it."""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise
from typing import TYPE_CHECKING

import polars as pl

from dds_trace.tracefile.units.durations import format_ms

from ..model.applied import SHARED_MEMORY, UNKNOWN, maps_memory, payload_path, udp_receive_buffer_bytes
from ..model.finding import Finding, Severity
from ..model.parameters import SIZE_LINE_COLUMNS
from ..statistics.intervals import RUNS_TO_TELL

if TYPE_CHECKING:
    from collections.abc import Iterator

    from dds_trace.tracefile import Session

    from ..model.parameters import ParameterValue
    from .evidence import Evidence

_SEGMENT_BYTES = 512 * 1024
"""Fast DDS's shared-memory segment: a message that does not fit goes another way (eProsima, SHM transport)."""

_JUMP = 2.0
"""Growth of latency divided by that of the size from which on a cost in proportion to the size is no explanation."""


def unlike_sizes(evidence: Evidence) -> Iterator[Finding]:
    """Report neighbouring sizes, all else equal, between whose p50 intervals the latency surely falls or jumps.

    Only intervals that rest on runs count: within one run they leave out what differs from run to run. Of 20,000
    simulated pairs of equal sizes, three or five runs each that differ by 5 %, 0.2 and 0.3 % fall.
    """
    medians = evidence.details.intervals.filter(
        pl.col("runs") >= RUNS_TO_TELL, metric="latency", percentile="p50"
    ).drop_nulls("method")
    interval = {row["group"]: row for row in medians.iter_rows(named=True)}
    lines: dict[tuple[ParameterValue, ...], list[tuple[int, int]]] = defaultdict(list)
    for group, row in enumerate(evidence.grouping.parameters.iter_rows(named=True)):
        if group in interval:
            lines[tuple(row[name] for name in SIZE_LINE_COLUMNS)].append((row["payload_bytes"], group))
    names = evidence.group_names
    for line in lines.values():
        for (small, before), (large, after) in pairwise(sorted(line)):
            one, other = interval[before], interval[after]
            falls = other["high_ns"] < one["low_ns"]
            jumps = small > 0 and other["low_ns"] > _JUMP * (large / small) * max(one["high_ns"], 1.0)
            if falls or jumps:
                cause = _cause(evidence, after, small, large)
                yield Finding(
                    Severity.INFO,
                    "latency_falls_with_size" if falls else "latency_jumps_with_size",
                    names[after],
                    f"p50 latency {'falls' if falls else 'jumps'} from {format_ms(one['estimate_ns'])} ms at {small} B to "
                    f"{format_ms(other['estimate_ns'])} ms at {large} B{cause}.",
                    "Measure sizes between the two, and compare the transports and buffers of both devices, before "
                    "you rely on either.",
                    (after,),
                )


def _cause(evidence: Evidence, group: int, small: int, large: int) -> str:
    """Name what lies between the two sizes by the fingerprints."""
    exchange = evidence.grouping.exchanges[evidence.grouping.members()[group][0]]
    sessions = [each for each in (exchange.relay, exchange.ping) if each is not None]
    through_memory = len(sessions) > 1 and all(map(_goes_through_memory, sessions))
    if through_memory and exchange.ping.vendor == "fastdds" and small < _SEGMENT_BYTES <= large:
        on_one = exchange.relay is not None and exchange.relay.device == exchange.ping.device
        if on_one:
            return f"; between them lies Fast DDS's shared-memory segment of {_SEGMENT_BYTES} B"
    for session in sessions:
        name, buffer = _receive_buffer(session)
        if buffer is not None and small < buffer <= large:
            return f"; between them lies the socket buffer of {session.device} ({name} {buffer} B)"
    return "; the recorded environment shows no cause"


def _goes_through_memory(session: Session) -> bool:
    """Tell whether shared memory may have carried the payload; an older trace does not tell, so it may."""
    path = payload_path(session)
    if path is None or path == SHARED_MEMORY:
        return True
    return path == UNKNOWN and maps_memory(session)


def _receive_buffer(session: Session) -> tuple[str, int | None]:
    """Return the name and the bytes of the buffer that a session received into, None where a datagram met no buffer."""
    path = payload_path(session)
    if path is not None:
        used = None if path == SHARED_MEMORY else udp_receive_buffer_bytes(session)
        return "SO_RCVBUF of its UDP sockets", used
    buffers = session.host.get("socket_buffers")
    value = (
        buffers.get("rmem_default", buffers.get("net.core.rmem_default"))
        if isinstance(buffers, dict)
        else None
    )
    return "net.core.rmem_default", value if isinstance(value, int) else None
