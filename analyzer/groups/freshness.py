"""The frames `freshness` and `outages`: deadlines, age of information and outages."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from ..model.metrics import frame_schema
from ..pairing.pair import LOSSES, OUTCOMES, Outcome, chosen_of
from ..pairing.roundtrips import RoundTrips
from .batch import Batch, filled, first_known, is_present

Int64 = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class AgeOfInformation:
    """Age of the newest information at a receiver from the first update to the last: mean over time, and its peaks."""

    mean_ns: float
    peak_mean_ns: float
    peak_max_ns: int
    updates: int


def age_of_information(generated: Int64, received: Int64) -> AgeOfInformation | None:
    """Compute the age of information from the times (ns) at which received messages were made and received, on one clock.

    It rises from `r[k] - g[k]` at update k to the peak `r[k+1] - g[k]`; an older message that comes late changes nothing.
    """
    if not (_is_ascending(received) and _is_ascending(generated)):
        generated, received = _updates(generated, received)
    if len(received) < 2:
        return None
    peaks = received[1:] - generated[:-1]
    # In place, as a long run's arrays are large.
    area, fallen = peaks.astype(np.float64), (received - generated)[:-1].astype(np.float64)
    peak_mean_ns = float(area.mean())
    area *= area
    fallen *= fallen
    area -= fallen
    area /= 2
    return AgeOfInformation(
        mean_ns=float(area.sum() / float(received[-1] - received[0])),
        peak_mean_ns=peak_mean_ns,
        peak_max_ns=int(peaks.max()),
        updates=len(received),
    )


def _is_ascending(times: Int64) -> bool:
    return bool((times[1:] > times[:-1]).all())


def _updates(generated: Int64, received: Int64) -> tuple[Int64, Int64]:
    order = np.lexsort((generated, received))
    generated, received = generated[order], received[order]
    newer = np.ones(len(generated), np.bool_)
    newer[1:] = generated[1:] > np.maximum.accumulate(generated)[:-1]
    generated, received = chosen_of(newer, generated), chosen_of(newer, received)
    # Of several updates at one instant the last one counts: the others were never the newest.
    last = np.ones(len(received), np.bool_)
    last[:-1] = received[1:] != received[:-1]
    return chosen_of(last, generated), chosen_of(last, received)


def late_by(received: Int64, period_ns: int) -> tuple[Int64, int]:
    """Return by how much each message after the first came later than one period after the newest before it, ns, and the empty periods.

    A control loop of that period which begins at the first message has nothing new in an empty period. `received` are the times
    of reception on one clock in the order of sending; a message that an older one overtook changes nothing.
    """
    newest = np.maximum.accumulate(received)
    gaps = np.diff(newest[np.concatenate([[True], received[1:] >= newest[:-1]])]) if len(received) else received
    if not len(gaps):
        return gaps, 0
    ticks = (np.cumsum(np.concatenate([[0], gaps])) + period_ns // 2) // period_ns
    return np.maximum(gaps - period_ns, 0), int(ticks[-1] + 1 - len(np.unique(ticks)))


OUTAGE_MESSAGES = 3
"""Lost messages in a row that make an outage: single losses are loss, not an outage."""

RECOVERED_MESSAGES = 5
"""Messages in a row in time that end the recovery from an outage."""


def longest_run(happened: Bools) -> int:
    return max((stop - start for start, stop in runs_of(happened)), default=0)


def runs_of(happened: Bools) -> list[tuple[int, int]]:
    changes = np.flatnonzero(np.diff(np.concatenate([[False], happened, [False]]).astype(np.int8)))
    return [(int(start), int(stop)) for start, stop in changes.reshape(-1, 2)]


@dataclass(frozen=True, slots=True)
class Outage:
    """A run of lost messages, from T0 (else T1) of the first one to the next reception; None for a time that the run does not reach."""

    first_sequence: int
    messages: int
    start_ns: int
    end_ns: int | None
    recovery_ns: int | None

    @property
    def duration_ns(self) -> int | None:
        """Time without a new message at the receiver; None if the run ended first."""
        return None if self.end_ns is None else self.end_ns - self.start_ns


def find_outages(
    sequence: NDArray[np.uint64], planned_ns: Int64, receive_ns: Int64, lost: Bools, in_time: Bools
) -> list[Outage]:
    outages = []
    good = in_time & ~lost
    for start, stop in runs_of(lost):
        if stop - start < OUTAGE_MESSAGES:
            continue
        end = int(receive_ns[stop]) if stop < len(lost) else None
        recovery = None
        if end is not None:
            steady = (s for s, e in runs_of(good[stop:]) if e - s >= RECOVERED_MESSAGES)
            first = next(steady, None)
            recovery = None if first is None else max(0, int(receive_ns[stop + first]) - end)
        outages.append(Outage(int(sequence[start]), stop - start, int(planned_ns[start]), end, recovery))
    return outages


ONE_WAY = ("outbound_ns", "return_ns")
"""Metrics that are wrong by at most `clock_bound_ns`."""

_NEVER = {"outbound_ns": (Outcome.LOST_OUTBOUND,)}
"""Outcomes of messages that surely never arrived; for other metrics all losses."""

FRESHNESS_SCHEMA = frame_schema(
    "group:u32 run_id:u64 relay_id:u32 messages:u64 deadline_ns:i64 judged:u64 missed:u64 "
    "missed_ratio:f64 longest_missed:u64 longest_missed_ns:i64 age_mean_ns:f64 age_peak_mean_ns:f64 "
    "age_peak_max_ns:i64 relay_age_mean_ns:f64 relay_age_peak_max_ns:i64 clock_bound_ns:i64 outages:u32 "
    "outage_longest_ns:i64 recovery_longest_ns:i64 unsure:u64 period_ns:i64 late_by_p50_ns:f64 late_by_p99_ns:f64 late_by_max_ns:i64 "
    "empty_periods:u64"
)

OUTAGE_SCHEMA = frame_schema(
    "group:u32 run_id:u64 relay_id:u32 first_sequence:u64 messages:u64 start_ns:i64 end_ns:i64 "
    "duration_ns:i64 recovery_ns:i64"
)


def freshness_frame(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
    """Summarize deadline misses, age of information and outages of each run and relay with messages.

    A message misses the deadline if it is lost, never left, or its metric is larger; a one-way time is judged only if it does
    or does not so surely, by its `clock_bound_ns`. Without a schedule the response is the round trip.

    Returns:
        Columns of `FRESHNESS_SCHEMA`. `judged` includes unsent messages; `unsure` are the others; `longest_missed` in a row and
        `longest_missed_ns` to the next message in time; `age_*` of information that went to the relay and back, `relay_age_*`
        at the relay, wrong by at most `clock_bound_ns`; `late_by_*` of the messages at the relay (without its trace: of the
        replies), `empty_periods` of a control loop there (`late_by`).
    """
    unsent = roundtrips.counts["unsent"].to_list()
    rows: list[dict[str, object]] = []
    for number, run in _runs(batch, roundtrips):
        outages = _outages(run)
        rows.append(
            {
                **_names(batch, number),
                "messages": len(run.lost),
                **_deadline(run, unsent[number]),
                **_ages(run),
                **_late_by(run, batch.exchanges[number].run.rate_hz),
                "outages": len(outages),
                "outage_longest_ns": max((o.duration_ns for o in outages if o.duration_ns is not None), default=None),
                "recovery_longest_ns": max((o.recovery_ns for o in outages if o.recovery_ns is not None), default=None),
            }
        )
    return pl.DataFrame(rows, schema=FRESHNESS_SCHEMA)


def outage_frame(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
    """List the outages: columns of `OUTAGE_SCHEMA`, the fields of `Outage`, by group, run and relay."""
    lost = roundtrips.counts.select(pl.sum_horizontal(LOSSES)).to_series()
    if not (lost >= OUTAGE_MESSAGES).any():
        return pl.DataFrame(schema=OUTAGE_SCHEMA)
    rows = [
        {
            **_names(batch, number),
            "first_sequence": outage.first_sequence,
            "messages": outage.messages,
            "start_ns": outage.start_ns,
            "end_ns": outage.end_ns,
            "duration_ns": outage.duration_ns,
            "recovery_ns": outage.recovery_ns,
        }
        for number, run in _runs(batch, roundtrips)
        for outage in _outages(run)
    ]
    return pl.DataFrame(rows, schema=OUTAGE_SCHEMA)


def _names(batch: Batch, number: int) -> dict[str, object]:
    exchange = batch.exchanges[number]
    return {"group": int(batch.group_of_exchange[number]), "run_id": exchange.run.run_id, "relay_id": exchange.relay_id}


@dataclass(frozen=True, slots=True, eq=False)
class _Judged:
    """The metric of a deadline for each message, its error bound, and whether it surely never arrived."""

    deadline_ns: int
    value_ns: Int64
    bound_ns: Int64
    has_value: Bools
    never: Bools

    def late(self) -> Bools:
        return self.has_value & (self.value_ns - self.bound_ns > self.deadline_ns)

    def in_time(self) -> Bools:
        return self.has_value & (self.value_ns + self.bound_ns <= self.deadline_ns)


@dataclass(frozen=True, slots=True, eq=False)
class _Run:
    """One run and relay as arrays by sequence number; `seen`: whether `outbound_ns` and `bound_ns` have a value."""

    sequence: NDArray[np.uint64]
    planned_ns: Int64
    publish_ns: Int64
    receive_ns: Int64
    outbound_ns: Int64
    bound_ns: Int64
    relay_in_ns: Int64
    lost: Bools
    seen: Bools
    relayed: Bools
    judged: _Judged | None


def _runs(batch: Batch, roundtrips: RoundTrips) -> Iterator[tuple[int, _Run]]:
    measured = roundtrips.measured
    columns = {
        **{name: measured[name].to_numpy() for name in ("sequence", "publish_ns")},
        "planned_ns": filled(first_known(measured, "scheduled_ns", "publish_ns")),
        "receive_ns": filled(measured["receive_ns"]),
        "outbound_ns": filled(measured["outbound_ns"]),
        "bound_ns": filled(measured["clock_bound_ns"]),
        "lost": roundtrips.outcome != OUTCOMES.index(Outcome.COMPLETED),
        "seen": is_present(measured["clock_bound_ns"]),
        "relay_in_ns": filled(measured["relay_in_ns"]),
        "relayed": is_present(measured["relay_in_ns"]),
    }
    deadline_ns = batch.options.deadline_ns
    judged = {} if deadline_ns is None else _judged_columns(roundtrips, f"{batch.options.deadline_metric}_ns")
    bounds = roundtrips.bounds.tolist()

    def order(number: int) -> tuple[int, int, int]:
        exchange = batch.exchanges[number]
        return int(batch.group_of_exchange[number]), exchange.run.run_id, exchange.relay_id

    for number in sorted(range(len(batch.exchanges)), key=order):
        here = slice(bounds[number], bounds[number + 1])
        if here.start < here.stop:
            judged_run = None
            if deadline_ns is not None:
                judged_run = _Judged(deadline_ns, **{name: values[here] for name, values in judged.items()})
            yield number, _Run(judged=judged_run, **{name: values[here] for name, values in columns.items()})


def _judged_columns(roundtrips: RoundTrips, metric: str) -> dict[str, NDArray[Any]]:
    measured = roundtrips.measured
    # A message without a schedule responds from T1 on.
    values = first_known(measured, metric, "rtt_ns") if metric == "response_ns" else measured[metric]
    never = [OUTCOMES.index(outcome) for outcome in _NEVER.get(metric, map(Outcome, LOSSES))]
    return {
        "value_ns": filled(values),
        "bound_ns": filled(measured["clock_bound_ns"]) if metric in ONE_WAY else np.zeros(measured.height, np.int64),
        "has_value": is_present(measured["clock_bound_ns"] if metric in ONE_WAY else values),
        "never": np.isin(roundtrips.outcome, never),
    }


def _outages(run: _Run) -> list[Outage]:
    if not run.lost.any():
        return []
    return find_outages(run.sequence, run.planned_ns, run.receive_ns, run.lost, _in_time(run))


def _in_time(run: _Run) -> Bools:
    """Return which messages came within the deadline; without one, within the time of 90 % of the run's messages."""
    if run.judged is not None:
        return run.judged.in_time()
    usual = run.receive_ns - run.planned_ns
    arrived = usual[~run.lost]
    return ~run.lost & (usual <= (np.quantile(arrived, 0.9) if len(arrived) else 0))


def _deadline(run: _Run, unsent: int) -> dict[str, object]:
    if run.judged is None:
        return {"deadline_ns": None}
    missed = run.judged.never | run.judged.late()
    judged = missed | run.judged.in_time()
    lengths_ns = []
    for start, stop in runs_of(missed):
        end_ns = run.planned_ns[stop] if stop < len(missed) else run.planned_ns[stop - 1]
        lengths_ns.append(int(end_ns - run.planned_ns[start]))
    # Unsent messages were due after the last sent one.
    ending = len(missed) - int(np.flatnonzero(~missed)[-1]) - 1 if not missed.all() else len(missed)
    all_judged, all_missed = int(judged.sum()) + unsent, int(missed.sum()) + unsent
    return {
        "deadline_ns": run.judged.deadline_ns,
        "judged": all_judged,
        "unsure": int((~judged).sum()),
        "missed": all_missed,
        "missed_ratio": all_missed / all_judged if all_judged else None,
        "longest_missed": max(longest_run(missed), ending + unsent if unsent else 0),
        "longest_missed_ns": max(lengths_ns, default=0),
    }


def _ages(run: _Run) -> dict[str, object]:
    ages: dict[str, object] = {}
    came = ~run.lost
    back = age_of_information(chosen_of(came, run.planned_ns), chosen_of(came, run.receive_ns))
    if back is not None:
        ages |= {
            "age_mean_ns": back.mean_ns,
            "age_peak_mean_ns": back.peak_mean_ns,
            "age_peak_max_ns": back.peak_max_ns,
        }
    seen = run.seen
    there = age_of_information(chosen_of(seen, run.planned_ns), chosen_of(seen, run.publish_ns + run.outbound_ns))
    if there is not None:
        ages |= {
            "relay_age_mean_ns": there.mean_ns,
            "relay_age_peak_max_ns": there.peak_max_ns,
            "clock_bound_ns": int(run.bound_ns[seen].max()),
        }
    return ages


def _late_by(run: _Run, rate_hz: float) -> dict[str, object]:
    period_ns = round(1e9 / rate_hz) if rate_hz > 0 else 0
    times = (run.relay_in_ns, run.relayed) if run.relayed.any() else (run.receive_ns, ~run.lost)
    received = chosen_of(times[1], times[0])
    late_ns, empty = late_by(received, period_ns) if period_ns else (received[:0], 0)
    if not len(late_ns):  # one message, or all later ones overtaken
        return {}
    return {
        "period_ns": period_ns,
        "late_by_p50_ns": float(np.quantile(late_ns, 0.5)),
        "late_by_p99_ns": float(np.quantile(late_ns, 0.99)),
        "late_by_max_ns": int(late_ns.max()),
        "empty_periods": empty,
    }
