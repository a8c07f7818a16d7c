"""One-way times of each run and relay, and the clock of each pair of devices over the campaign.

A run is fitted on its own, so that its times do not depend on what else is analyzed; the campaign's fit takes the knots of all runs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from ..clocks.boots import boot_id_of, share_boot
from ..clocks.fit import ClockFit, RelayedMessages, fit_clocks
from ..clocks.slews import Slew, Stretch, find_slews, is_bent
from .exchanges import Exchange

_PAIR = ("ping_device", "relay_device", "boot", "relay_boot")


@dataclass(frozen=True, slots=True, eq=False)
class DevicePair:
    """The fit of two devices and their boots over the campaign: rows of `clock_fits` and `clock_knots`; slews caused steps."""

    segments: list[dict[str, Any]]
    knots: pl.DataFrame
    slews: tuple[Slew, ...]


def pair_devices(clock_fits: pl.DataFrame, clock_knots: pl.DataFrame, boots: Mapping[int, int]) -> Iterator[DevicePair]:
    boot = pl.Series("boot", [boots.get(run_id, 0) for run_id in clock_knots["run_id"]], pl.Int64)
    knots = (
        clock_knots.with_columns(boot)
        .sort("at_ns")
        .partition_by(*_PAIR, maintain_order=True, as_dict=True, include_key=True)
    )
    for key, fits in clock_fits.partition_by(*_PAIR, maintain_order=True, as_dict=True).items():
        knots_of_pair = knots.get(key, clock_knots.clear()).select(clock_knots.columns)
        segments = list(fits.iter_rows(named=True))
        stretches = [
            Stretch(
                segment["start_ns"],
                segment["end_ns"],
                segment["drift_ppb"],
                segment["drift_bound_ppb"],
                segment["step_before_ns"] or 0,
                segment["step_bound_ns"] or 0,
            )
            for segment in segments
        ]
        at_ns, offset_ns, bound_ns = (knots_of_pair[n].to_numpy() for n in ("at_ns", "offset_ns", "bound_ns"))
        yield DevicePair(segments, knots_of_pair, tuple(find_slews(stretches, at_ns, offset_ns, bound_ns)))


ONE_WAY_COLUMNS = ("outbound_ns", "return_ns", "clock_bound_ns")

_FOUR_STAMPS = ("publish_ns", "relay_in_ns", "relay_out_ns", "receive_ns")

_SANE_NS = 1 << 60
_LEAST_SANE_NS = -_SANE_NS + 2
"""Stamps beyond (36 years of uptime) are damaged; sums and differences of the others fit into an int64."""


@dataclass(frozen=True, slots=True, eq=False)
class OneWay:
    """The one-way times of the rows of some exchanges.

    Attributes:
        columns: `ONE_WAY_COLUMNS`, i64, null unless all four stamps are there and agree; the bound is also null where the clocks
            of the run were stepped or slewed (`_is_bounded`).
        fits: of each exchange; None without a message to fit.
    """

    columns: tuple[pl.Series, ...]
    fits: tuple[ClockFit | None, ...]

    @classmethod
    def unknown(cls, rows: int, exchanges: int) -> OneWay:
        return cls(
            tuple(pl.Series(name, [None], pl.Int64).new_from_index(0, rows) for name in ONE_WAY_COLUMNS),
            (None,) * exchanges,
        )


def fit_exchanges(
    exchanges: Sequence[Exchange], bounds: NDArray[np.int64], stamps: Mapping[str, NDArray[np.int64]]
) -> OneWay:
    """Fit the clocks of every exchange by its own messages; `stamps` are T1, T3, T4 and T2, or `pair.MISSING`."""
    rows = int(bounds[-1])
    values: dict[str, NDArray[np.int64]] = {}
    is_fitted, is_bounded = np.zeros((2, rows), np.bool_)
    fitted: list[tuple[int, slice | NDArray[np.intp], RelayedMessages]] = []
    damaged = [name for name in _FOUR_STAMPS if not _are_sane(stamps[name])]
    for number, (exchange, first, after) in enumerate(
        zip(exchanges, bounds[:-1].tolist(), bounds[1:].tolist(), strict=True)
    ):
        span = slice(first, after)
        usable = _usable(stamps, span, damaged)
        if usable.all():
            at: slice | NDArray[np.intp] = span
        elif usable.any():
            at = first + np.flatnonzero(usable)
        else:
            continue
        is_fitted[span] = usable
        messages = RelayedMessages(
            publish_ns=stamps["publish_ns"][at],
            relay_in_ns=stamps["relay_in_ns"][at],
            relay_out_ns=stamps["relay_out_ns"][at],
            receive_ns=stamps["receive_ns"][at],
            ping_device=exchange.ping.device,
            relay_device=exchange.relay.device if exchange.relay else "",
            relay_boot=boot_id_of(exchange.relay) if exchange.relay else None,
            same_boot=share_boot(exchange.ping, exchange.relay),
        )
        fitted.append((number, at, messages))
    fits: list[ClockFit | None] = [None] * len(exchanges)
    clock_fits = fit_clocks([messages for *_, messages in fitted])
    for (number, at, messages), (fit, offsets) in zip(fitted, clock_fits, strict=True):
        t1, t3, t4, t2 = (getattr(messages, name) for name in _FOUR_STAMPS)
        under_way = t2 - t1
        under_way -= t4
        under_way += t3
        outbound = t3 - t1
        outbound -= offsets.offset_ns
        np.clip(outbound, 0, under_way, out=outbound)
        under_way -= outbound
        # The bound is a view of the same array.
        times_ns = zip(ONE_WAY_COLUMNS, (outbound, under_way, offsets.bound_ns.copy()), strict=True)
        for name, times in times_ns:
            if len(times) == rows:
                values[name] = times
            else:
                if name not in values:
                    values[name] = np.zeros(rows, np.int64)
                values[name][at] = times
        is_bounded[at] = _is_bounded(fit)
        fits[number] = fit
    columns = []
    for name in ONE_WAY_COLUMNS:
        column = pl.Series(name, values[name] if values else np.zeros(rows, np.int64))
        has_value = is_bounded if name == "clock_bound_ns" else is_fitted
        columns.append(column if has_value.all() else column.set(pl.Series(~has_value), None))
    return OneWay(tuple(columns), tuple(fits))


def _is_bounded(fit: ClockFit) -> bool:
    return fit.same_clock or not (
        fit.steps or any(is_bent(*np.array(s.knots, np.int64).T) for s in fit.segments if len(s.knots) > 2)
    )


def _usable(stamps: Mapping[str, NDArray[np.int64]], rows: slice, damaged: Sequence[str]) -> NDArray[np.bool_]:
    t1, t3, t4, t2 = (stamps[name][rows] for name in _FOUR_STAMPS)
    usable: NDArray[np.bool_] = t2 - t1 >= t4 - t3
    for name in damaged:
        stamp = stamps[name][rows]
        usable &= (stamp >= _LEAST_SANE_NS) & (stamp < _SANE_NS)
    return usable


def _are_sane(stamp: NDArray[np.int64]) -> bool:
    return not len(stamp) or bool(stamp.min() >= _LEAST_SANE_NS and stamp.max() < _SANE_NS)


KNOT_SCHEMA: dict[str, type[pl.DataType]] = {
    "group": pl.UInt32,
    "run_id": pl.UInt64,
    "relay_id": pl.UInt32,
    "ping_device": pl.String,
    "relay_device": pl.String,
    "messages": pl.UInt64,
    "at_ns": pl.Int64,
    "offset_ns": pl.Int64,
    "bound_ns": pl.Int64,
    "relay_boot": pl.String,
    "same_boot": pl.Boolean,
}


_KNOT_COLUMNS = ("at_ns", "offset_ns", "bound_ns")


def knots_of(exchanges: Sequence[Exchange], groups: Sequence[int], fits: Sequence[ClockFit | None]) -> pl.DataFrame:
    """List the knots of every run: the frame `clock_knots` with `KNOT_SCHEMA`, null for boots that are unknown."""
    described = [
        (
            (
                group,
                exchange.run.run_id,
                exchange.relay_id,
                fit.ping_device,
                fit.relay_device,
                segment.messages,
                fit.relay_boot,
                share_boot(exchange.ping, exchange.relay),
            ),
            segment.knots,
        )
        for exchange, group, fit in zip(exchanges, groups, fits, strict=True)
        if fit is not None
        for segment in fit.segments
    ]
    segments = pl.DataFrame(
        [values for values, _ in described],
        schema={name: dtype for name, dtype in KNOT_SCHEMA.items() if name not in _KNOT_COLUMNS},
        orient="row",
    )
    knots = [knot for _, knots_of_segment in described for knot in knots_of_segment]
    segment = np.repeat(
        np.arange(len(described)), np.array([len(knots_of_segment) for _, knots_of_segment in described], np.int64)
    )
    knot_frame = pl.DataFrame(knots, schema=dict.fromkeys(_KNOT_COLUMNS, pl.Int64), orient="row")
    return segments[segment].hstack(knot_frame).select(*KNOT_SCHEMA)


def fit_devices(knots: pl.DataFrame, boots: Mapping[int, int]) -> tuple[ClockFit, ...]:
    """Fit the clock of each pair of devices and boots over the campaign, from the frame of `knots_of`.

    A relay that was rebooted has another boot id, and another clock. `boots`: of each run's ping, by run_id (`boots.ping_boots`).
    """
    ids = pl.Series(list(boots), dtype=pl.UInt64)
    boot_numbers = pl.Series(list(boots.values()), dtype=pl.Int64)
    boot = pl.col("run_id").replace_strict(ids, boot_numbers, default=0) if boots else pl.lit(0, pl.Int64)
    keys = ["ping_device", "relay_device", "boot", "relay_boot", "same_boot"]
    pairs = []
    for part in knots.with_columns(boot=boot).sort(*keys, "at_ns").partition_by(keys, maintain_order=True):
        ping_device, relay_device, boot_number, relay_boot, same_boot = part.select(keys).row(0)
        at_ns, offset_ns, bound_ns = (part[n].to_numpy() for n in ("at_ns", "offset_ns", "bound_ns"))
        # A knot becomes a message without duration that has the interval of the knot.
        pairs.append(
            RelayedMessages(
                publish_ns=at_ns,
                relay_in_ns=at_ns + offset_ns + bound_ns,
                relay_out_ns=at_ns + offset_ns - bound_ns,
                receive_ns=at_ns,
                ping_device=ping_device,
                relay_device=relay_device,
                boot=boot_number,
                relay_boot=relay_boot,
                same_boot=same_boot,
            )
        )
    return tuple(fit for fit, _ in fit_clocks(pairs))


SEGMENT_SCHEMA: dict[str, type[pl.DataType]] = {
    "ping_device": pl.String,
    "relay_device": pl.String,
    "boot": pl.Int64,
    "same_clock": pl.Boolean,
    "segment": pl.UInt32,
    "start_ns": pl.Int64,
    "end_ns": pl.Int64,
    "at_ns": pl.Int64,
    "offset_ns": pl.Int64,
    "bound_ns": pl.Int64,
    "drift_ppb": pl.Float64,
    "drift_bound_ppb": pl.Float64,
    "residual_ns": pl.Int64,
    "step_before_ns": pl.Int64,
    "step_bound_ns": pl.Int64,
    "relay_boot": pl.String,
}


def segment_table(fits: Sequence[ClockFit]) -> pl.DataFrame:
    """List the segments: the frame `clock_fits`, one row per pair of devices, boot and stretch of time without a step.

    Columns of `SEGMENT_SCHEMA`, as in `ClockSegment`; `step_before_ns` is the jump that began the segment, wrong by at most
    `step_bound_ns`, null for the first.
    """
    rows = []
    for fit in fits:
        for number, segment in enumerate(fit.segments):
            step = fit.steps[number - 1] if number else None
            rows.append(
                {
                    "ping_device": fit.ping_device,
                    "relay_device": fit.relay_device,
                    "boot": fit.boot,
                    "same_clock": fit.same_clock,
                    "segment": number,
                    **{name: getattr(segment, name) for name in list(SEGMENT_SCHEMA)[5:13]},
                    "step_before_ns": step.size_ns if step else None,
                    "step_bound_ns": step.bound_ns if step else None,
                    "relay_boot": fit.relay_boot,
                }
            )
    return pl.DataFrame(rows, schema=SEGMENT_SCHEMA)
