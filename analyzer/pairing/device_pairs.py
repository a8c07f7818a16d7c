"""The clock fits of the campaign by pair of devices, with the knots that each rests on and the slews that it shows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import polars as pl

from ..clocks.slews import Slew, Stretch, find_slews

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_PAIR = ("ping_device", "relay_device", "boot", "relay_boot")


@dataclass(frozen=True, slots=True, eq=False)
class DevicePair:
    """The fit of two devices and their boots over the whole campaign.

    Attributes:
        segments: its rows of `Details.clock_fits`.
        knots: rows of `Details.clock_knots` that it rests on, by time.
        slews: slews that its steps are.
    """

    segments: list[dict[str, Any]]
    knots: pl.DataFrame
    slews: tuple[Slew, ...]


def pair_devices(
    clock_fits: pl.DataFrame, clock_knots: pl.DataFrame, boots: Mapping[int, int]
) -> Iterator[DevicePair]:
    """Yield each fit of the campaign.

    Args:
        clock_fits: frame of `one_way.segment_table`.
        clock_knots: frame of `one_way.knots_of`.
        boots: boot of each run's ping, by run_id (`boots.ping_boots`).
    """
    boot = pl.Series("boot", [boots.get(run_id, 0) for run_id in clock_knots["run_id"]], pl.Int64)
    knots = (
        clock_knots.with_columns(boot)
        .sort("at_ns")
        .partition_by(*_PAIR, maintain_order=True, as_dict=True, include_key=True)
    )
    for key, fits in clock_fits.partition_by(*_PAIR, maintain_order=True, as_dict=True).items():
        own = knots.get(key, clock_knots.clear()).select(clock_knots.columns)
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
        at_ns, offset_ns, bound_ns = (own[n].to_numpy() for n in ("at_ns", "offset_ns", "bound_ns"))
        yield DevicePair(segments, own, tuple(find_slews(stretches, at_ns, offset_ns, bound_ns)))
