"""One-way times: each pair of devices gets a clock fit (`analyzer/clocks/fit.py`), each message its way out and back.

On the ping's clock, with the fitted offset of the relay's: `outbound = T3 - T1 - offset`, and the return is what is left
of `rtt - intermediate`. A link that is slower one way than the other cannot be told from a clock that is off by half the
difference: asymmetry inside `clock_bound_ns` cannot be seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from .fit import ClockFit, fit_clock

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from dds_trace.tracefile import Run, Session


def ping_boots(sessions: Sequence[Session], runs: Sequence[Run]) -> dict[int, int]:
    """Which boot of its device each run belongs to, by run_id: wall clock at monotonic zero, in whole seconds.

    A device's monotonic clock starts again at every boot, so stamps of two boots must not be mixed. Sessions
    whose zero differs by under two seconds are one boot; a run that does not name its session is in boot 0.
    """
    boot_of_session: dict[int, int] = {}
    known: dict[str, list[int]] = {}
    for session in sessions:
        zero_s = (session.wall_anchor_ns - session.monotonic_anchor_ns) // 1_000_000_000
        of_device = known.setdefault(session.device, [])
        boot_of_session[session.session_id] = next((b for b in of_device if abs(b - zero_s) < 2), zero_s)
        if boot_of_session[session.session_id] not in of_device:
            of_device.append(zero_s)
    return {run.run_id: boot_of_session.get(session_of_run(run), 0) for run in runs}


def session_of_run(run: Run) -> int:
    """The ping session that a run names (`session_id` in its description), or -1."""
    try:
        return int(str(run.extra["session_id"]), 16)
    except (KeyError, ValueError):
        return -1


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Round trips with their one-way times.

    Attributes:
        roundtrips: the input with the columns `outbound_ns` (T1 to T3), `return_ns` (T4 to T2) and
            `clock_bound_ns`, i64, null unless all four stamps are there. The two add up to `rtt_ns -
            intermediate_ns`; each may be wrong by `clock_bound_ns`, one up as the other goes down.
        fits: one for each pair of devices and boot.
    """

    roundtrips: pl.DataFrame
    fits: tuple[ClockFit, ...]


def align_clocks(roundtrips: pl.DataFrame, boots: Mapping[int, int] | None = None) -> Alignment:
    """One-way times of every message that has all four stamps, and the clock fits they rest on.

    Args:
        roundtrips: frame of `docs/trace-format.md`, any order.
        boots: boot of each run (`ping_boots`); without it every device is taken to have been up throughout.
    """
    stamps = ["publish_ns", "relay_in_ns", "relay_out_ns", "receive_ns"]
    complete = pl.all_horizontal(pl.col(stamps).is_not_null()) & (
        pl.col("receive_ns") - pl.col("publish_ns") >= pl.col("relay_out_ns") - pl.col("relay_in_ns")
    )
    keys = [pl.col("ping_device").fill_null(""), pl.col("relay_device").fill_null(""), _boot(boots or {})]
    groups = (
        roundtrips.select(*keys, complete.alias("complete"))
        .with_row_index("row")
        .filter(pl.col("complete"))
        .group_by("ping_device", "relay_device", "boot", maintain_order=True)
        .agg("row")
        .sort("ping_device", "relay_device", "boot")
    )
    t1, t3, t4, t2 = (roundtrips[name].fill_null(0).to_numpy() for name in stamps)
    one_way: dict[str, Any] = {
        name: np.zeros(len(roundtrips), np.int64) for name in ("outbound_ns", "return_ns", "clock_bound_ns")
    }
    known = np.zeros(len(roundtrips), np.bool_)
    fits: list[ClockFit] = []
    for ping_device, relay_device, boot, row_list in groups.iter_rows():
        rows = np.asarray(row_list, np.intp)
        fit, offsets = fit_clock(
            t1[rows],
            t3[rows],
            t4[rows],
            t2[rows],
            ping_device=ping_device,
            relay_device=relay_device,
            boot=boot,
        )
        fits.append(fit)
        under_way = (t2[rows] - t1[rows]) - (t4[rows] - t3[rows])
        outbound = np.clip(t3[rows] - t1[rows] - offsets.offset_ns, 0, under_way)
        one_way["outbound_ns"][rows] = outbound
        one_way["return_ns"][rows] = under_way - outbound
        one_way["clock_bound_ns"][rows] = offsets.bound_ns
        known[rows] = True
    columns = [
        pl.when(pl.Series(known)).then(pl.Series(name, values)).otherwise(None).alias(name)
        for name, values in one_way.items()
    ]
    return Alignment(roundtrips.with_columns(columns), tuple(fits))


def _boot(boots: Mapping[int, int]) -> pl.Expr:
    if not boots:
        return pl.lit(0, pl.Int64).alias("boot")
    run_ids = pl.Series(list(boots), dtype=pl.UInt64)
    return (
        pl.col("run_id")
        .replace_strict(run_ids, pl.Series(list(boots.values()), dtype=pl.Int64), default=0)
        .alias("boot")
    )


def clock_table(fits: Sequence[ClockFit]) -> pl.DataFrame:
    """One row per knot, for drawing offset and drift over time.

    Columns: `ping_device`, `relay_device` str, `boot` i64, `same_clock` bool, `segment` u32 (0, 1, ... within
    the pair), `at_ns` i64 (ping's monotonic clock), `offset_ns`, `bound_ns` i64, `drift_ppb`,
    `drift_bound_ppb` f64 (of the segment), `residual_ns` i64 (of the segment).
    """
    rows = [
        {
            "ping_device": fit.ping_device,
            "relay_device": fit.relay_device,
            "boot": fit.boot,
            "same_clock": fit.same_clock,
            "segment": number,
            "at_ns": knot.at_ns,
            "offset_ns": knot.offset_ns,
            "bound_ns": knot.bound_ns,
            "drift_ppb": segment.drift_ppb,
            "drift_bound_ppb": segment.drift_bound_ppb,
            "residual_ns": segment.residual_ns,
        }
        for fit in fits
        for number, segment in enumerate(fit.segments)
        for knot in segment.knots
    ]
    schema: dict[str, type[pl.DataType]] = {
        "ping_device": pl.String,
        "relay_device": pl.String,
        "boot": pl.Int64,
        "same_clock": pl.Boolean,
        "segment": pl.UInt32,
        "at_ns": pl.Int64,
        "offset_ns": pl.Int64,
        "bound_ns": pl.Int64,
        "drift_ppb": pl.Float64,
        "drift_bound_ppb": pl.Float64,
        "residual_ns": pl.Int64,
    }
    return pl.DataFrame(rows, schema=schema)
