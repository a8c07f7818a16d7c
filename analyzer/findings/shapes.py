"""Checks of the latency over the time of a run: a warm-up that is too short, a rise, two modes.

A campaign has hundreds of runs, and each is tested. So a group is reported if half of its runs or more show the same. With
the false alarms of a run below, of groups of five sound runs at most 3 in 10,000 are reported (10 p^3 for three of five), and
of groups of one run as many as of runs.
"""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise
from typing import TYPE_CHECKING

import polars as pl

from dds_trace.base.units import counted, format_ms

from ..model.applied import SHARED_MEMORY, UNKNOWN, maps_memory, payload_path, udp_receive_buffer_bytes
from ..model.finding import Finding, Severity
from ..model.parameters import SIZE_LINE_COLUMNS
from ..statistics.intervals import MIN_RUNS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from dds_trace.tracefile.format.descriptions import Session

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
        pl.col("runs") >= MIN_RUNS, metric="latency", percentile="p50"
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


_HALF = 2
"""A group is reported from one in so many of its runs on."""


def short_warm_up(evidence: Evidence) -> Iterator[Finding]:
    """Report groups whose runs begin with counted messages unlike the others, and propose the warm-up (MSER-5).

    Of simulated runs without a warm-up, independent or with correlations up to 0.95, about 1 % at most are taken for one with
    a warm-up (6 of 500 with 300 messages and 0.9), and 3.1 % where one message in twenty is in a burst
    (`run_statistics.warm_up`).
    """
    for group, shapes, runs in _groups_that_show(evidence, "warm_up_messages"):
        longest = shapes.sort("warm_up_messages").row(-1, named=True)
        ratio = shapes["warm_up_ratio"].median()
        assert isinstance(ratio, float)
        skipped = max(
            e.run.warmup_messages
            for e, g in zip(evidence.grouping.exchanges, evidence.exchange_groups(), strict=True)
            if g == group
        )
        yield Finding(
            Severity.WARNING,
            "short_warm_up",
            evidence.group_names[group],
            f"In {shapes.height} of {counted(runs, 'run')} the first messages are not like the others: {ratio:.2g} times "
            f"their latency, for up to {counted(longest['warm_up_messages'], 'message')} ({longest['warm_up_s']:.2g} s).",
            f"Record with --warmup {skipped + longest['warm_up_messages']}, which leaves them out.",
            (group,),
            effect=min(abs(ratio - 1), 1.0),
        )


def rising_latency(evidence: Evidence) -> Iterator[Finding]:
    """Report groups whose latency rises through their runs.

    Of simulated runs without a trend at most 0.5 % (correlations up to 0.95; 1.1 % at 0.99) are taken for one
    (`run_statistics.trend`).
    """
    for group, shapes, runs in _groups_that_show(evidence, "trend_ratio", pl.col("trend_ratio") > 1):
        worst = shapes.sort("trend_ratio").row(-1, named=True)
        yield Finding(
            Severity.WARNING,
            "latency_rises",
            evidence.group_names[group],
            f"In {shapes.height} of {counted(runs, 'run')} the latency rises from the begin to the end, by up to "
            f"{100 * (worst['trend_ratio'] - 1):.3g} % ({evidence.run_name(worst['run_id'])}).",
            "Look at the timeline: a queue that fills, a processor that gets hot, a link that degrades. Longer runs "
            "will give other percentiles.",
            (group,),
            effect=min(worst["trend_ratio"] - 1, 1.0),
        )


def two_modes(evidence: Evidence) -> Iterator[Finding]:
    """Report groups whose latency is mostly one of two values, between which a median or a mean has no message.

    Of simulated runs with one mode none is taken for one with two, and 1.4 % where one message in twenty is in a burst of
    twenty that is five times as slow (`run_statistics.modes`).
    """
    for group, shapes, runs in _groups_that_show(evidence, "modes_share"):
        low_ns, high_ns, share = (
            shapes[name].median() for name in ("modes_low_ns", "modes_high_ns", "modes_share")
        )
        assert isinstance(low_ns, float)
        assert isinstance(high_ns, float)
        assert isinstance(share, float)
        yield Finding(
            Severity.INFO,
            "two_modes",
            evidence.group_names[group],
            f"In {shapes.height} of {counted(runs, 'run')} the latency is mostly one of two values, about {format_ms(round(low_ns))} ms and "
            f"{format_ms(round(high_ns))} ms; {100 * share:.2g} % of the messages are of the smaller one.",
            "Do not read a median or a mean as typical; look for two paths: a retransmission, a sleeping core, two transports.",
            (group,),
            effect=share,
        )


def _groups_that_show(
    evidence: Evidence, column: str, also: pl.Expr | None = None
) -> Iterator[tuple[int, pl.DataFrame, int]]:
    """Yield each group half of whose runs show something, the rows that do, and the number of runs and relays."""
    showing = evidence.shapes.drop_nulls(column)
    showing = showing if also is None else showing.filter(also)
    runs: dict[int, int] = defaultdict(int)
    for group in evidence.shapes["group"]:
        runs[group] += 1
    for (key,), rows in showing.group_by(["group"], maintain_order=True):
        group = int(str(key))
        if rows.height * _HALF >= runs[group]:
            yield group, rows, runs[group]
