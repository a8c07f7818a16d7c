"""The frames `freshness` and `outages`: deadlines, age of information and outages over the time of a run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from ..pairing.pair import LOSSES, OUTCOMES, Outcome, chosen_of
from .batch import filled, first_known, is_present
from .outages import OUTAGE_MESSAGES, age_of_information, find_outages, longest_run, runs_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from ..pairing.roundtrips import RoundTrips
    from .batch import Batch
    from .outages import Outage

    Int64 = NDArray[np.int64]
    Bools = NDArray[np.bool_]


ONE_WAY = ("outbound_ns", "return_ns")
"""Metrics that are wrong by at most `clock_bound_ns`."""

_NEVER = {"outbound_ns": (Outcome.LOST_OUTBOUND,)}
"""Metric -> outcomes of messages that surely never arrived; any loss for a metric that is not here."""

FRESHNESS_SCHEMA = {
    "group": pl.UInt32,
    "run_id": pl.UInt64,
    "relay_id": pl.UInt32,
    "messages": pl.UInt64,
    "deadline_ns": pl.Int64,
    "judged": pl.UInt64,
    "missed": pl.UInt64,
    "missed_ratio": pl.Float64,
    "longest_missed": pl.UInt64,
    "longest_missed_ns": pl.Int64,
    "age_mean_ns": pl.Float64,
    "age_peak_mean_ns": pl.Float64,
    "age_peak_max_ns": pl.Int64,
    "relay_age_mean_ns": pl.Float64,
    "relay_age_peak_max_ns": pl.Int64,
    "clock_bound_ns": pl.Int64,
    "outages": pl.UInt32,
    "outage_longest_ns": pl.Int64,
    "recovery_longest_ns": pl.Int64,
    "unsure": pl.UInt64,
}

OUTAGE_SCHEMA = {
    "group": pl.UInt32,
    "run_id": pl.UInt64,
    "relay_id": pl.UInt32,
    "first_sequence": pl.UInt64,
    "messages": pl.UInt64,
    "start_ns": pl.Int64,
    "end_ns": pl.Int64,
    "duration_ns": pl.Int64,
    "recovery_ns": pl.Int64,
}


def freshness_frame(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
    """Summarize deadline misses, age of information and outages of each run and relay with messages.

    A message misses the deadline if it is lost, never left, or its metric is larger. Without a schedule the response is the
    round trip. A one-way time is judged only if it surely meets or misses the deadline, given its `clock_bound_ns`.

    Returns:
        Columns of `FRESHNESS_SCHEMA`, by group, run and relay. `messages` published; `judged` messages, unsent ones
        included; `unsure` the others (a deadline within the clock bound, a latency without the relay's trace); `missed`,
        `missed_ratio` of the judged, `longest_missed` in a row and `longest_missed_ns` from the first one's planned time to
        the next message in time; `age_*`: information that went to the relay and back, at the ping, exact on one clock;
        `relay_age_*`: at the relay, on the ping's clock, wrong by at most `clock_bound_ns`; `outages` of at least
        `OUTAGE_MESSAGES` losses, the longest one and the longest recovery.
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
                "outages": len(outages),
                "outage_longest_ns": max(
                    (o.duration_ns for o in outages if o.duration_ns is not None), default=None
                ),
                "recovery_longest_ns": max(
                    (o.recovery_ns for o in outages if o.recovery_ns is not None), default=None
                ),
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
    return {
        "group": int(batch.group_of_exchange[number]),
        "run_id": exchange.run.run_id,
        "relay_id": exchange.relay_id,
    }


@dataclass(frozen=True, slots=True, eq=False)
class _Judged:
    """The metric of a deadline for each message, and its error bound.

    `never`: whether a message surely never arrived.
    """

    deadline_ns: int
    value_ns: Int64
    bound_ns: Int64
    has_value: Bools
    never: Bools

    def late(self) -> Bools:
        """Return which messages surely came too late."""
        return self.has_value & (self.value_ns - self.bound_ns > self.deadline_ns)

    def in_time(self) -> Bools:
        """Return which messages surely came within the deadline."""
        return self.has_value & (self.value_ns + self.bound_ns <= self.deadline_ns)


@dataclass(frozen=True, slots=True, eq=False)
class _Run:
    """One run and relay as arrays, by sequence number; missing times are 0 and masked.

    `seen`: whether `outbound_ns` and `bound_ns` have a value. `judged`: None without a deadline.
    """

    sequence: NDArray[np.uint64]
    planned_ns: Int64
    publish_ns: Int64
    receive_ns: Int64
    outbound_ns: Int64
    bound_ns: Int64
    lost: Bools
    seen: Bools
    judged: _Judged | None


def _runs(batch: Batch, roundtrips: RoundTrips) -> Iterator[tuple[int, _Run]]:
    """Yield the number and the messages of each exchange that has any; by group, run and relay."""
    measured = roundtrips.measured
    columns = {
        **{name: measured[name].to_numpy() for name in ("sequence", "publish_ns")},
        "planned_ns": filled(first_known(measured, "scheduled_ns", "publish_ns")),
        "receive_ns": filled(measured["receive_ns"]),
        "outbound_ns": filled(measured["outbound_ns"]),
        "bound_ns": filled(measured["clock_bound_ns"]),
        "lost": roundtrips.outcome != OUTCOMES.index(Outcome.COMPLETED),
        "seen": is_present(measured["outbound_ns"]),
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
    """Return the arrays of `_Judged` for all rows."""
    measured = roundtrips.measured
    # A message without a schedule responds from T1 on.
    values = first_known(measured, metric, "rtt_ns") if metric == "response_ns" else measured[metric]
    never = [OUTCOMES.index(outcome) for outcome in _NEVER.get(metric, map(Outcome, LOSSES))]
    return {
        "value_ns": filled(values),
        "bound_ns": filled(measured["clock_bound_ns"])
        if metric in ONE_WAY
        else np.zeros(measured.height, np.int64),
        "has_value": is_present(values),
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
    # Messages that never left were due after the last one that did.
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
    there = age_of_information(
        chosen_of(seen, run.planned_ns), chosen_of(seen, run.publish_ns + run.outbound_ns)
    )
    if there is not None:
        ages |= {
            "relay_age_mean_ns": there.mean_ns,
            "relay_age_peak_max_ns": there.peak_max_ns,
            "clock_bound_ns": int(run.bound_ns[seen].max()),
        }
    return ages
