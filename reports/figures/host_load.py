"""Load of the devices and strength of the Wi-Fi while the latency was measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import polars as pl

from .figure import Figure, LeftOut, Scope, figure_maker

if TYPE_CHECKING:
    from ..book.book import Book


SAMPLES_IN_PAGE = 30_000
"""Most samples in a page, for all groups (about 300 KB of JSON); of more, every n-th is drawn."""


@dataclass(frozen=True, slots=True)
class DeviceLoad:
    """Samples of one device during the runs of one group.

    Attributes:
        role: `ping` or `relay`.
        elapsed_s: time of each sample since the planned first message of its run, rounded to 0.1 s.
        cpu_percent: load of the busiest processor.
        signal_dbm: signal of the weakest Wi-Fi interface.
    """

    role: str
    elapsed_s: tuple[float, ...]
    cpu_percent: tuple[int | None, ...]
    signal_dbm: tuple[int | None, ...]


@dataclass(frozen=True, slots=True)
class HostLoad:
    """Group -> loads of its devices."""

    groups: dict[int, tuple[DeviceLoad, ...]]
    decimated: bool


def host_load_info(book: Book) -> HostLoad:
    """Collect the rows of `details.host_samples` taken during a run, by the run's group and role.

    Wall clocks relate the devices to each other, which is exact enough for one sample per second.
    """
    if not book.analysis.details.host_samples.height:
        return HostLoad({}, decimated=False)
    samples = book.analysis.details.host_samples.filter(
        pl.col("cpu_busiest_percent").is_not_null() | pl.col("wifi_signal_dbm").is_not_null()
    ).sort("wall_ns")
    groups: dict[tuple[int, str], list[pl.DataFrame]] = {}
    for run in book.run_times:
        if run.session is None:
            continue
        first, last = run.session.wall_ns(run.origin_ns), run.session.wall_ns(run.last_ns)
        devices = _devices(book, run.group)
        during = samples.filter(pl.col("wall_ns").is_between(first, last)).filter(
            (pl.col("session_id") == run.session.session_id)
            | ((pl.col("role") == "relay") & pl.col("device").is_in(devices)),
        )
        for role in ("ping", "relay"):
            own = during.filter(role=role).unique(["device", "wall_ns"], maintain_order=True)
            elapsed = ((pl.col("wall_ns") - first) / 1e9).round(1).alias("elapsed_s")
            if own.height:
                groups.setdefault((run.group, role), []).append(own.with_columns(elapsed))
    total = sum(part.height for parts in groups.values() for part in parts)
    step = max(1, -(-total // SAMPLES_IN_PAGE))
    loads_of_group: dict[int, tuple[DeviceLoad, ...]] = {}
    for (group, role), parts in groups.items():
        rows = pl.concat(parts).sort("elapsed_s").gather_every(step)
        load = DeviceLoad(
            role,
            tuple(rows["elapsed_s"].to_list()),
            tuple(rows["cpu_busiest_percent"].round().cast(pl.Int32).to_list()),
            tuple(rows["wifi_signal_dbm"].round().cast(pl.Int32).to_list()),
        )
        loads_of_group[group] = (*loads_of_group.get(group, ()), load)
    return HostLoad(loads_of_group, decimated=step > 1)


def host_load_figure(info: HostLoad) -> Figure | LeftOut:
    """Draw latency, load and signal over one time axis, for the series of the chosen cell."""
    name, title = "host_load", "Processor load and Wi-Fi signal against latency"
    how_to_read = (
        "All panels share the time axis, so a latency that rises where the load rises or the signal falls has its cause below it; the load is that "
        "of the busiest processor."
    )
    if not info.groups:
        return LeftOut(name, title, "no device sampled its load during a run.")
    groups = {str(group): loads for group, loads in info.groups.items()}
    return Figure(name, title, how_to_read, "host_load", {"groups": groups, "decimated": info.decimated})


FIGURE = figure_maker(host_load_info, host_load_figure, Scope.CELL)


def _devices(book: Book, group: int) -> list[str]:
    device = book.analysis.summary["relay_device"][group]
    return [] if device is None else [device]
