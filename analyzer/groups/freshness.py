"""Freshness: what a control loop at the receiver feels, message by message in the order of time.

Deadline misses and their longest run, how old the newest information is (S. Kaul, R. Yates, M. Gruteser,
"Real-time status: how often should one update?", INFOCOM 2012), outages and how long recovery takes.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Iterator

Int64 = NDArray[np.int64]
Bools = NDArray[np.bool_]

OUTAGE_MESSAGES = 3
"""Lost messages in a row that make an outage: single losses are loss, not an outage."""

RECOVERED_MESSAGES = 5
"""Messages in a row that must be in time before an outage counts as overcome."""


@dataclass(frozen=True, slots=True)
class AgeOfInformation:
    """How old the newest information at a receiver was, from its first reception to the last.

    Attributes:
        mean_ns: average over time.
        peak_mean_ns: average over the peaks, each just before newer information arrived.
        peak_max_ns: the highest peak.
        updates: receptions that brought newer information than any before.
    """

    mean_ns: float
    peak_mean_ns: float
    peak_max_ns: int
    updates: int


def age_of_information(generated_ns: Int64, received_ns: Int64) -> AgeOfInformation | None:
    """Age of information from when each message was made and when it was received, on one clock.

    The age rises by a second each second and falls to `received - generated` when a newer message arrives, a
    saw-tooth: between updates k and k + 1 it goes from `r[k] - g[k]` to the peak `r[k+1] - g[k]`. An older
    message that comes late changes nothing.

    Args:
        generated_ns: int64, of the messages that were received.
        received_ns: int64, likewise.

    Returns:
        None with fewer than two updates: there is no time to average over.
    """
    order = np.lexsort((generated_ns, received_ns))
    generated, received = generated_ns[order], received_ns[order]
    newest_before = np.maximum.accumulate(np.concatenate([[np.iinfo(np.int64).min], generated[:-1]]))
    newer = generated > newest_before[: len(generated)]
    generated, received = generated[newer], received[newer]
    # Of several updates at one instant the last counts: the others never were the newest for any time.
    last = np.concatenate([received[1:] != received[:-1], [True]]) if len(received) else newer[:0]
    generated, received = generated[last], received[last]
    if len(received) < 2:
        return None
    fallen = (received - generated)[:-1].astype(np.float64)
    peaks = received[1:] - generated[:-1]
    area = (peaks.astype(np.float64) ** 2 - fallen**2) / 2
    return AgeOfInformation(
        mean_ns=float(area.sum() / float(received[-1] - received[0])),
        peak_mean_ns=float(peaks.mean()),
        peak_max_ns=int(peaks.max()),
        updates=len(received),
    )


def longest_run(happened: Bools) -> int:
    """Length of the longest run of True."""
    return max((stop - start for start, stop in runs_of(happened)), default=0)


def runs_of(happened: Bools) -> list[tuple[int, int]]:
    """Start and stop (one past the end) of each run of True, in order."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], happened, [False]]).astype(np.int8)))
    return [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]


@dataclass(frozen=True, slots=True)
class Outage:
    """A run of lost messages.

    Attributes:
        first_sequence: first message lost.
        messages: how many were lost in a row.
        start_ns: when the first of them was planned (T0, else T1), ping's monotonic clock.
        end_ns: when the next message that got through was received; None if the run ended first.
        recovery_ns: from `end_ns` until the first of `RECOVERED_MESSAGES` messages in a row that were in time was
            received; 0 if they were from the start, None if it never came to that.
    """

    first_sequence: int
    messages: int
    start_ns: int
    end_ns: int | None
    recovery_ns: int | None

    @property
    def duration_ns(self) -> int | None:
        """How long the receiver had nothing new, None if the run ended first."""
        return None if self.end_ns is None else self.end_ns - self.start_ns


def find_outages(
    sequence: NDArray[np.uint64],
    planned_ns: Int64,
    receive_ns: Int64,
    lost: Bools,
    in_time: Bools,
) -> list[Outage]:
    """The outages of one run, in order.

    Args:
        sequence: of every published message, rising.
        planned_ns: when each was planned to be sent.
        receive_ns: when its reply was received; anything where `lost`.
        lost: whether no reply was received.
        in_time: whether it was received in time, by deadline or by what the run usually needs.
    """
    found = []
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
        found.append(Outage(int(sequence[start]), stop - start, int(planned_ns[start]), end, recovery))
    return found


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
}


def summarize_freshness(
    roundtrips: pl.DataFrame, deadline_ns: int | None = None, metric: str = "latency_ns"
) -> pl.DataFrame:
    """One row per run and relay: deadline misses, age of information, outages.

    Args:
        roundtrips: frame of `docs/trace-format.md`; with `outbound_ns` and `clock_bound_ns` the age at
            the relay is given too.
        deadline_ns: a message misses it if it is lost or its `metric` is larger. None: nothing is judged.
        metric: column that the deadline is for.

    Returns:
        Sorted by run and relay. `messages` published; `judged` those whose fate against the deadline is known (a reply
        without the relay's trace has no latency and is not judged); `missed`, `missed_ratio` of the judged,
        `longest_missed` in a row and `longest_missed_ns` from the first one's planned time to the next in
        time; `age_*`: information that went to the relay and back, at the ping, exact on one clock; `relay_age_*`:
        at the relay, on the ping's clock, wrong by at most `clock_bound_ns`; `outages` of at least
        `OUTAGE_MESSAGES` losses, the longest one and the longest recovery. Null where there is nothing to say.
    """
    rows = []
    for run in _runs(roundtrips, metric):
        row: dict[str, object] = {"run_id": run.run_id, "relay_id": run.relay_id, "messages": len(run.lost)}
        row |= _deadline(run, deadline_ns)
        row |= _ages(run)
        outages = find_outages(
            run.sequence, run.planned_ns, run.receive_ns, run.lost, _in_time(run, deadline_ns)
        )
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
    metric: str = "latency_ns",
) -> pl.DataFrame:
    """One row per outage, for drawing: `run_id`, `relay_id` and the fields of `Outage`, times in ns (i64, null)."""
    schema = {
        "run_id": pl.UInt64,
        "relay_id": pl.UInt32,
        "first_sequence": pl.UInt64,
        "messages": pl.UInt64,
        "start_ns": pl.Int64,
        "end_ns": pl.Int64,
        "duration_ns": pl.Int64,
        "recovery_ns": pl.Int64,
    }
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
        for outage in find_outages(
            run.sequence, run.planned_ns, run.receive_ns, run.lost, _in_time(run, deadline_ns)
        )
    ]
    return pl.DataFrame(rows, schema=schema)


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
        pl.col(metric).alias("value_ns"),
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
        "known": frame["value_ns"].is_not_null().to_numpy(),
        "aligned": frame["outbound_ns"].is_not_null().to_numpy(),
    }
    runs = [(*frame.row(start)[:2], start, stop) for start, stop in pairwise([*starts, len(frame)])]
    for run_id, relay_id, start, stop in sorted(runs):
        of_run: dict[str, Any] = {name: values[start:stop] for name, values in columns.items()}
        yield _Run(run_id, relay_id, **of_run)


def _starts(frame: pl.DataFrame) -> list[int] | None:
    """Where the rows of each run and relay begin, None unless they stand together by rising sequence number."""
    run_id, relay_id, sequence = (frame[name].to_numpy() for name in ("run_id", "relay_id", "sequence"))
    new = np.ones(len(frame), np.bool_)
    new[1:] = (run_id[1:] != run_id[:-1]) | (relay_id[1:] != relay_id[:-1])
    starts = np.flatnonzero(new)
    together = len(set(zip(run_id[starts].tolist(), relay_id[starts].tolist(), strict=True))) == len(starts)
    rising = new[1:] | (sequence[1:] >= sequence[:-1])
    return starts.tolist() if together and rising.all() else None


def _in_time(run: _Run, deadline_ns: int | None) -> Bools:
    """Received within the deadline; without one, no later than nine of ten messages of the run usually are."""
    if deadline_ns is not None:
        return run.known & (run.value_ns <= deadline_ns)
    usual = run.receive_ns - run.planned_ns
    arrived = usual[~run.lost]
    return ~run.lost & (usual <= (np.quantile(arrived, 0.9) if len(arrived) else 0))


def _deadline(run: _Run, deadline_ns: int | None) -> dict[str, object]:
    if deadline_ns is None:
        return {"deadline_ns": None}
    judged = run.lost | run.known
    missed = run.lost | (run.known & (run.value_ns > deadline_ns))
    lengths_ns = []
    for start, stop in runs_of(missed):
        end_ns = run.planned_ns[stop] if stop < len(missed) else run.planned_ns[stop - 1]
        lengths_ns.append(int(end_ns - run.planned_ns[start]))
    return {
        "deadline_ns": deadline_ns,
        "judged": int(judged.sum()),
        "missed": int(missed.sum()),
        "missed_ratio": float(missed.sum() / judged.sum()) if judged.any() else None,
        "longest_missed": longest_run(missed),
        "longest_missed_ns": max(lengths_ns, default=0),
    }


def _ages(run: _Run) -> dict[str, object]:
    found: dict[str, object] = {}
    back = age_of_information(run.planned_ns[~run.lost], run.receive_ns[~run.lost])
    if back is not None:
        found |= {
            "age_mean_ns": back.mean_ns,
            "age_peak_mean_ns": back.peak_mean_ns,
            "age_peak_max_ns": back.peak_max_ns,
        }
    seen = run.aligned
    there = age_of_information(run.planned_ns[seen], (run.publish_ns + run.outbound_ns)[seen])
    if there is not None:
        found |= {
            "relay_age_mean_ns": there.mean_ns,
            "relay_age_peak_max_ns": there.peak_max_ns,
            "clock_bound_ns": int(run.bound_ns[seen].max()),
        }
    return found
