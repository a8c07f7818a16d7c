"""Latency over the time of a run and over the size of messages.

At least half of the runs of a result must show the same: with the false alarms of a run below, at most 3 of 10,000
results of five sound runs are reported (10 p^3 for three of five).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import polars as pl

from dds_trace.base.units import counted, format_duration, format_size
from dds_trace.tracefile.format.descriptions import Session

from ..model.applied import SHARED_MEMORY, UNKNOWN, maps_memory, payload_path, udp_receive_buffer_bytes
from ..model.finding import Finding, Subject
from ..model.parameters import SIZE_LINE_COLUMNS, ParameterValue
from ..statistics.intervals import MIN_RUNS
from .evidence import Check, Evidence, Observation, note, warning

_HALF = 2
"""A result is reported if one in this many of its runs, or more, show the same."""


@warning("short_warm_up", Subject.RESULT, "Record with -o warmup={messages}, which leaves them out.")
def short_warm_up(evidence: Evidence) -> Iterator[Observation]:
    """The first messages are not like the others.

    MSER-5 proposes the warm-up. Of simulated runs without a warm-up, independent or with correlations up to 0.95, about
    1 % at most are reported, and 3.1 % where one message in twenty is in a burst (`run_statistics.modes`).
    """
    warmups: dict[int, int] = defaultdict(int)
    for exchange, group in evidence.exchanges_by_group():
        warmups[group] = max(exchange.run.warmup_messages, warmups[group])
    for group, shapes, runs in _results_with(evidence, "warm_up_messages"):
        longest = shapes.sort("warm_up_messages").row(-1, named=True)
        ratio = _median(shapes, "warm_up_ratio")
        yield evidence.result(
            group,
            f"In {shapes.height} of {counted(runs, 'run')} the first messages are not like the others: {ratio:.2g} times "
            f"their latency, for up to {counted(longest['warm_up_messages'], 'message')} ({longest['warm_up_s']:.2g} s).",
            min(abs(ratio - 1), 1.0),
            messages=warmups[group] + longest["warm_up_messages"],
        )


@warning(
    "latency_rises",
    Subject.RESULT,
    "Look at the timeline: a queue that fills, a processor that gets hot, a link that degrades. Longer runs will give other "
    "percentiles.",
)
def rising_latency(evidence: Evidence) -> Iterator[Observation]:
    """The latency rises during a run.

    Of simulated runs without a trend at most 0.5 % are reported (correlations up to 0.95; 1.1 % at 0.99;
    `run_statistics.modes`).
    """
    for group, shapes, runs in _results_with(evidence, "trend_ratio", pl.col("trend_ratio") > 1):
        worst = shapes.sort("trend_ratio").row(-1, named=True)
        rise = worst["trend_ratio"] - 1
        yield evidence.result(
            group,
            f"In {shapes.height} of {counted(runs, 'run')} the latency rises from start to end of the run, by up to "
            f"{100 * rise:.3g} % ({evidence.run_name(worst['run_id'])}).",
            min(rise, 1.0),
        )


@note(
    "two_modes",
    Subject.RESULT,
    "Do not read a median or a mean as typical; look for two paths: a retransmission, a sleeping core, two transports.",
)
def two_modes(evidence: Evidence) -> Iterator[Observation]:
    """The latency is mostly one of two values.

    Of simulated runs with one mode none is reported, and 1.4 % where one message in twenty is in a burst of twenty that is
    five times as slow (`run_statistics.modes`).
    """
    for group, shapes, runs in _results_with(evidence, "modes_share"):
        low_ns, high_ns = round(_median(shapes, "modes_low_ns")), round(_median(shapes, "modes_high_ns"))
        share = _median(shapes, "modes_share")
        yield evidence.result(
            group,
            f"In {shapes.height} of {counted(runs, 'run')} the latency is mostly one of two values, about {format_duration(low_ns)} "
            f"and {format_duration(high_ns)}; {100 * share:.2g} % of the messages have the smaller one.",
            share,
        )


def _results_with(
    evidence: Evidence, column: str, condition: pl.Expr | bool = True
) -> Iterator[tuple[int, pl.DataFrame, int]]:
    runs = evidence.shapes["group"].value_counts()
    totals = dict(runs.iter_rows())
    showing = evidence.shapes.drop_nulls(column).filter(condition)
    for (key,), rows in showing.group_by(["group"], maintain_order=True):
        group = int(str(key))
        if rows.height * _HALF >= totals[group]:
            yield group, rows, totals[group]


def _median(shapes: pl.DataFrame, column: str) -> float:
    median = shapes[column].median()
    assert isinstance(median, float)
    return median


_SEGMENT_BYTES = 512 * 1024
"""Fast DDS's shared-memory segment; a larger message goes another way (eProsima, SHM transport)."""

_JUMP = 2.0
"""Growth of latency over growth of size that no proportional cost explains."""


@note(
    "latency_falls_with_size",
    Subject.RESULT,
    "Measure sizes between the two, and compare the transports and buffers of both devices, before you rely on either.",
)
def falls_with_size(evidence: Evidence) -> Iterator[Observation]:
    """Larger messages are faster.

    Of 20,000 simulated pairs of equal sizes, three or five runs each that differ by 5 %, 0.2 and 0.3 % fall.
    """
    for pair in _neighbouring_sizes(evidence):
        if pair.large["high_ns"] < pair.small["low_ns"]:
            yield pair.observation(evidence, "falls")


@note(
    "latency_jumps_with_size",
    Subject.RESULT,
    "Measure sizes between the two, and compare the transports and buffers of both devices, before you rely on either.",
)
def jumps_with_size(evidence: Evidence) -> Iterator[Observation]:
    """Larger messages are much slower."""
    for pair in _neighbouring_sizes(evidence):
        proportional_ns = pair.large_bytes / max(pair.small_bytes, 1) * max(pair.small["high_ns"], 1.0)
        if pair.small_bytes > 0 and pair.large["low_ns"] > _JUMP * proportional_ns:
            yield pair.observation(evidence, "jumps")


class _Sizes(NamedTuple):
    """Two neighbouring sizes, with the intervals of their p50 latency."""

    small_bytes: int
    small: dict[str, float]
    large_bytes: int
    large: dict[str, float]

    def observation(self, evidence: Evidence, verb: str) -> Observation:
        group = int(self.large["group"])
        cause = _cause(evidence, group, self.small_bytes, self.large_bytes)
        return evidence.result(
            group,
            f"p50 latency {verb} from {format_duration(self.small['estimate_ns'])} at {format_size(self.small_bytes)} to "
            f"{format_duration(self.large['estimate_ns'])} at {format_size(self.large_bytes)}{cause}.",
        )


def _neighbouring_sizes(evidence: Evidence) -> Iterator[_Sizes]:
    medians = evidence.details.intervals.filter(
        pl.col("runs") >= MIN_RUNS, metric="latency", percentile="p50"
    ).drop_nulls("method")
    intervals = {row["group"]: row for row in medians.iter_rows(named=True)}
    lines: dict[tuple[ParameterValue, ...], list[tuple[int, int]]] = defaultdict(list)
    for group, row in enumerate(evidence.grouping.parameters.iter_rows(named=True)):
        if group in intervals:
            lines[tuple(row[name] for name in SIZE_LINE_COLUMNS)].append((row["payload_bytes"], group))
    for line in lines.values():
        for (small_bytes, small), (large_bytes, large) in pairwise(sorted(line)):
            yield _Sizes(small_bytes, intervals[small], large_bytes, intervals[large])


def _cause(evidence: Evidence, group: int, small_bytes: int, large_bytes: int) -> str:
    exchange = evidence.grouping.exchanges[evidence.grouping.members()[group][0]]
    ping, relay = exchange.ping, exchange.relay
    if (
        relay is not None
        and relay.device == ping.device
        and ping.vendor == "fastdds"
        and small_bytes < _SEGMENT_BYTES <= large_bytes
        and _may_use_memory(ping)
        and _may_use_memory(relay)
    ):
        return f"; between them is Fast DDS's shared-memory segment of {format_size(_SEGMENT_BYTES)}"
    for session in (relay, ping):
        if session is not None:
            name, buffer = _receive_buffer(session)
            if buffer is not None and small_bytes < buffer <= large_bytes:
                return f"; between them is the socket buffer of {session.device} ({name} {format_size(buffer)})"
    return _NO_CAUSE


_NO_CAUSE = "; the recorded environment shows no cause"
_SLOW = frozenset(
    [
        "udp_buffer_overflow",
        "fragments_lost",
        "retransmission_storm",
        "heartbeat_bound_recovery",
        "carried_twice",
        "cpu_saturated",
        "stood_still",
        "schedule_not_held",
        "waits_in_reader",
    ]
)


def with_causes(
    evidence: Evidence, kinds: Collection[Sequence[Finding]], checks: Sequence[Check]
) -> Iterator[list[Finding]]:
    """Name what only the larger size has."""
    titles = {check.code: check.title[0].lower() + check.title[1:] for check in checks}
    slow = [finding for same in kinds for finding in same if finding.code in _SLOW]
    smaller = {int(pair.large["group"]): int(pair.small["group"]) for pair in _neighbouring_sizes(evidence)}

    def explained(finding: Finding) -> Finding:
        if f"{_NO_CAUSE}." not in finding.what:
            return finding
        large_codes, small_codes = (
            dict.fromkeys(other.code for other in slow if group in other.groups)
            for group in (finding.groups[0], smaller[finding.groups[0]])
        )
        causes = [titles[code] for code in large_codes if code not in small_codes]
        words = f"; only at the larger size {' and '.join(causes)}" if causes else _NO_CAUSE
        return replace(finding, what=finding.what.replace(_NO_CAUSE, words))

    for same in kinds:
        yield [explained(finding) for finding in same]


def _may_use_memory(session: Session) -> bool:
    path = payload_path(session)
    return path is None or path == SHARED_MEMORY or (path == UNKNOWN and maps_memory(session))


def _receive_buffer(session: Session) -> tuple[str, int | None]:
    path = payload_path(session)
    if path is not None:
        size = None if path == SHARED_MEMORY else udp_receive_buffer_bytes(session)
        return "SO_RCVBUF of its UDP sockets", size
    buffers = session.host.get("socket_buffers")
    if not isinstance(buffers, dict):
        return "net.core.rmem_default", None
    value = buffers.get("rmem_default", buffers.get("net.core.rmem_default"))
    return "net.core.rmem_default", value if isinstance(value, int) else None
