"""The frames `freshness` and `outages`: deadlines, age of information and outages as a receiver sees them in time."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from ..pairing.pair import LOSSES, Outcome, chosen_of
from .age import age_of_information
from .batch import grouped_rows, with_group
from .outages import OUTAGE_MESSAGES, find_outages, longest_run, runs_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from ..pairing.roundtrips import RoundTrips
    from .batch import Batch
    from .outages import Outage

    Int64 = NDArray[np.int64]
    Bools = NDArray[np.bool_]


ONE_WAY = ("outbound_ns", "return_ns")
"""Metrics that are wrong by at most `clock_bound_ns`."""

_NEVER = {"outbound_ns": (Outcome.LOST_OUTBOUND.value,)}
"""Metric -> outcomes of messages that surely never made this way; any loss for a metric that is not here."""

FRESHNESS_SCHEMA = {
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
    """Summarize freshness: `group` u32, then the columns of `FRESHNESS_SCHEMA`, a row per run and relay."""
    wanted = batch.wanted
    runs = roundtrips.described.select("run_id", "relay_id").iter_rows()
    unsent = dict(zip(runs, roundtrips.counts["unsent"].to_list(), strict=True))
    rows = grouped_rows(batch, roundtrips, ["run_id", "relay_id"])
    of_runs = summarize_freshness(rows, wanted.deadline_ns, f"{wanted.deadline_metric}_ns", unsent)
    return with_group(batch, roundtrips, of_runs)


def outage_frame(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
    """List the outages: `group` u32, then the columns of `OUTAGE_SCHEMA`, a row per outage."""
    wanted = batch.wanted
    lost = roundtrips.counts.select(pl.sum_horizontal(LOSSES)).to_series()
    if not (lost >= OUTAGE_MESSAGES).any():
        return pl.DataFrame(schema={"group": pl.UInt32, **OUTAGE_SCHEMA})
    rows = grouped_rows(batch, roundtrips, ["run_id", "relay_id"])
    outages = outage_table(rows, wanted.deadline_ns, f"{wanted.deadline_metric}_ns")
    return with_group(batch, roundtrips, outages)


def summarize_freshness(
    roundtrips: pl.DataFrame,
    deadline_ns: int | None = None,
    metric: str = "response_ns",
    unsent: Mapping[tuple[int, int], int] | None = None,
) -> pl.DataFrame:
    """Summarize deadline misses, age of information and outages: one row per run and relay.

    Args:
        roundtrips: frame of `docs/trace-format.md`; with `outbound_ns` and `clock_bound_ns` the age at
            the relay is given too.
        deadline_ns: a message misses it if it is lost or its `metric` is larger. None: nothing is judged.
        metric: column that the deadline is for. Of `response_ns` a message without a schedule has its round trip. A
            one-way time meets or misses the deadline surely, by its `clock_bound_ns`, or is not judged.
        unsent: (run_id, relay_id) -> messages that were due and never left; they miss the deadline.

    Returns:
        Sorted by run and relay. `messages` published; `judged` those whose fate against the deadline is known, and the
        unsent ones; `unsure` the others, of which it cannot be told (a one-way time whose clock bound holds the deadline, a
        reply without the relay's trace, which has no latency); `missed`, `missed_ratio` of the judged,
        `longest_missed` in a row and `longest_missed_ns` from the first one's planned time to the next in
        time; `age_*`: information that went to the relay and back, at the ping, exact on one clock; `relay_age_*`:
        at the relay, on the ping's clock, wrong by at most `clock_bound_ns`; `outages` of at least
        `OUTAGE_MESSAGES` losses, the longest one and the longest recovery. Null where there is no value.
    """
    rows = []
    for run in _runs(roundtrips, metric):
        row: dict[str, object] = {"run_id": run.run_id, "relay_id": run.relay_id, "messages": len(run.lost)}
        row |= _deadline(run, deadline_ns, (unsent or {}).get((run.run_id, run.relay_id), 0))
        row |= _ages(run)
        outages = _outages(run, deadline_ns)
        row["outages"] = len(outages)
        row["outage_longest_ns"] = max(
            (o.duration_ns for o in outages if o.duration_ns is not None), default=None
        )
        row["recovery_longest_ns"] = max(
            (o.recovery_ns for o in outages if o.recovery_ns is not None), default=None
        )
        rows.append(row)
    return pl.DataFrame(rows, schema=FRESHNESS_SCHEMA)


def outage_table(
    roundtrips: pl.DataFrame,
    deadline_ns: int | None = None,
    metric: str = "response_ns",
) -> pl.DataFrame:
    """List outages for drawing: columns of `OUTAGE_SCHEMA`, the fields of `Outage`, times in ns."""
    rows = [
        {
            "run_id": run.run_id,
            "relay_id": run.relay_id,
            "first_sequence": outage.first_sequence,
            "messages": outage.messages,
            "start_ns": outage.start_ns,
            "end_ns": outage.end_ns,
            "duration_ns": outage.duration_ns,
            "recovery_ns": outage.recovery_ns,
        }
        for run in _runs(roundtrips, metric)
        for outage in _outages(run, deadline_ns)
    ]
    return pl.DataFrame(rows, schema=OUTAGE_SCHEMA)


@dataclass(frozen=True, slots=True, eq=False)
class _Run:
    """One run and relay as arrays, by rising sequence number; missing times are 0 and masked."""

    run_id: int
    relay_id: int
    sequence: NDArray[np.uint64]
    planned_ns: Int64
    receive_ns: Int64
    lost: Bools
    value_ns: Int64
    known: Bools
    never: Bools
    either_way_ns: Int64
    publish_ns: Int64
    outbound_ns: Int64
    bound_ns: Int64
    aligned: Bools


def _runs(roundtrips: pl.DataFrame, metric: str) -> Iterator[_Run]:
    aligned = "outbound_ns" in roundtrips.columns and "clock_bound_ns" in roundtrips.columns
    frame = roundtrips.select(
        "run_id",
        "relay_id",
        "sequence",
        "publish_ns",
        "receive_ns",
        pl.coalesce("scheduled_ns", "publish_ns").alias("planned_ns"),
        (pl.col("outcome") != "completed").alias("lost"),
        _value(metric).alias("value_ns"),
        pl.col("outcome").is_in(_NEVER.get(metric, LOSSES)).alias("never"),
        (pl.col("clock_bound_ns") if metric in ONE_WAY and aligned else pl.lit(0, pl.Int64)).alias(
            "either_way_ns"
        ),
        pl.col("outbound_ns") if aligned else pl.lit(None, pl.Int64).alias("outbound_ns"),
        pl.col("clock_bound_ns") if aligned else pl.lit(None, pl.Int64).alias("bound_ns"),
    ).rename({"clock_bound_ns": "bound_ns"} if aligned else {})
    starts = _starts(frame)
    if starts is None:
        frame = frame.sort("run_id", "relay_id", "sequence")
        starts = _starts(frame) or []
    columns = {
        **{name: frame[name].to_numpy() for name in ("sequence", "planned_ns", "publish_ns", "lost")},
        **{
            n: frame[n].fill_null(0).to_numpy() for n in ("receive_ns", "value_ns", "outbound_ns", "bound_ns")
        },
        "never": frame["never"].to_numpy(),
        "either_way_ns": frame["either_way_ns"].fill_null(0).to_numpy(),
        "known": frame["value_ns"].is_not_null().to_numpy(),
        "aligned": frame["outbound_ns"].is_not_null().to_numpy(),
    }
    runs = [(*frame.row(start)[:2], start, stop) for start, stop in pairwise([*starts, len(frame)])]
    for run_id, relay_id, start, stop in sorted(runs):
        yield _Run(run_id, relay_id, **{name: values[start:stop] for name, values in columns.items()})


def _value(metric: str) -> pl.Expr:
    """Return the time that the deadline is for, of a response from T1 where there was no schedule."""
    if metric == "response_ns":
        return pl.coalesce("response_ns", pl.col("receive_ns") - pl.col("publish_ns"))
    return pl.col(metric)


def _starts(frame: pl.DataFrame) -> list[int] | None:
    """Return the first row of each run and relay, None unless their rows stand together by rising sequence number."""
    run_id, relay_id, sequence = (frame[name].to_numpy() for name in ("run_id", "relay_id", "sequence"))
    new = np.ones(len(frame), np.bool_)
    new[1:] = (run_id[1:] != run_id[:-1]) | (relay_id[1:] != relay_id[:-1])
    starts = np.flatnonzero(new)
    together = len(set(zip(run_id[starts].tolist(), relay_id[starts].tolist(), strict=True))) == len(starts)
    rising = new[1:] | (sequence[1:] >= sequence[:-1])
    return starts.tolist() if together and rising.all() else None


def _outages(run: _Run, deadline_ns: int | None) -> list[Outage]:
    if not run.lost.any():  # what was in time takes longer to tell
        return []
    return find_outages(run.sequence, run.planned_ns, run.receive_ns, run.lost, _in_time(run, deadline_ns))


def _in_time(run: _Run, deadline_ns: int | None) -> Bools:
    """Tell which messages came within the deadline; without one, within the time that 90 % of the run's messages took."""
    if deadline_ns is not None:
        return run.known & (run.value_ns + run.either_way_ns <= deadline_ns)
    usual = run.receive_ns - run.planned_ns
    arrived = usual[~run.lost]
    return ~run.lost & (usual <= (np.quantile(arrived, 0.9) if len(arrived) else 0))


def _deadline(run: _Run, deadline_ns: int | None, unsent: int) -> dict[str, object]:
    if deadline_ns is None:
        return {"deadline_ns": None}
    late = run.known & (run.value_ns - run.either_way_ns > deadline_ns)
    missed = run.never | late
    judged = missed | (run.known & (run.value_ns + run.either_way_ns <= deadline_ns))
    lengths_ns = []
    for start, stop in runs_of(missed):
        end_ns = run.planned_ns[stop] if stop < len(missed) else run.planned_ns[stop - 1]
        lengths_ns.append(int(end_ns - run.planned_ns[start]))
    # Those that never left were due after the last one that did.
    ending = len(missed) - int(np.flatnonzero(~missed)[-1]) - 1 if not missed.all() else len(missed)
    all_judged, all_missed = int(judged.sum()) + unsent, int(missed.sum()) + unsent
    return {
        "deadline_ns": deadline_ns,
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
    seen = run.aligned
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
