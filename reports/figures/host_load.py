"""Load of the devices, strength of the Wi-Fi and a replayed link while the latency was measured."""

from __future__ import annotations

from dataclasses import dataclass, fields

import polars as pl

from ..book.book import Book
from .figure import FigureMaker, Plan, Scope

SAMPLES_IN_PAGE = 30_000
"""Most samples in a page (about 300 KB of JSON); of more, every n-th is drawn."""


LOADS = {
    "cpu_percent": ("Busiest processor", "%"),
    "signal_dbm": ("Wi-Fi signal", "dBm"),
    "delay_ms": ("Delay of the link", "ms"),
    "rate_mbit_s": ("Rate of the link", "Mbit/s"),
}
"""Field of `DeviceLoad` -> its label and unit."""


@dataclass(frozen=True, slots=True)
class DeviceLoad:
    """Samples of one device during the runs of one group; `elapsed_s` since the planned first message, rounded to 0.1 s."""

    role: str
    elapsed_s: tuple[float, ...]
    cpu_percent: tuple[int | None, ...]
    signal_dbm: tuple[int | None, ...]
    delay_ms: tuple[float | None, ...]
    rate_mbit_s: tuple[float | None, ...]


def host_load_plan(book: Book) -> Plan | None:
    if not book.analysis.details.host_samples.height:
        return None
    samples = book.analysis.details.host_samples.filter(
        pl.any_horizontal(pl.col("cpu_busiest_percent", "wifi_signal_dbm", "link_delay_ms").is_not_null())
    ).sort("wall_ns")
    during = _during_runs(samples, book)
    step = max(1, -(-during.height // SAMPLES_IN_PAGE))
    loads_of_group: dict[int, tuple[DeviceLoad, ...]] = {}
    for (group, role), rows in during.partition_by("group", "role", as_dict=True).items():
        drawn = rows.gather_every(step)
        load = DeviceLoad(role, *(tuple(drawn[column.name].to_list()) for column in fields(DeviceLoad)[1:]))
        loads_of_group[group] = (*loads_of_group.get(group, ()), load)
    loads = [(name, *words) for name, words in LOADS.items()]
    return {"groups": loads_of_group, "loads": loads, "decimated": step > 1} if loads_of_group else None


FIGURE = FigureMaker(
    name="host_load",
    title="Latency and what the devices sampled",
    how_to_read=(
        "All panels share the time axis, so what changes where the latency rises may be its cause; marks with a rim are of the relay's "
        "device."
    ),
    nothing="no device sampled its load during a run.",
    kind="host_load",
    make=host_load_plan,
    scope=Scope.CELL,
)


def _during_runs(samples: pl.DataFrame, book: Book) -> pl.DataFrame:
    """Return the samples of the ping's session and of the relay's device during each run, as `DeviceLoad` has them."""
    relay_device = book.analysis.summary["relay_device"]
    runs = pl.DataFrame(
        [
            {
                "group": run.group,
                "ping_session_id": run.session.session_id,
                "relay_device": relay_device[run.group],
                "first_ns": run.session.wall_ns(run.origin_ns),
                "last_ns": run.session.wall_ns(run.last_ns),
            }
            for run in book.run_times
            if run.session is not None
        ],
        schema={
            "group": pl.Int64,
            "ping_session_id": samples.schema["session_id"],
            "relay_device": pl.String,
            "first_ns": pl.Int64,
            "last_ns": pl.Int64,
        },
    ).with_row_index("run")
    first = samples["wall_ns"].search_sorted(runs["first_ns"], "left")
    after = samples["wall_ns"].search_sorted(runs["last_ns"], "right")
    run_samples = runs.with_columns(sample=pl.int_ranges(first, after)).explode("sample").drop_nulls("sample")
    at_relay = (pl.col("role") == "relay") & (pl.col("device") == pl.col("relay_device"))
    return (
        pl.concat([run_samples, samples[run_samples["sample"]]], how="horizontal")
        .filter((pl.col("session_id") == pl.col("ping_session_id")) | at_relay)
        .unique(["run", "role", "device", "wall_ns"], keep="first", maintain_order=True)
        .select(
            "group",
            "role",
            elapsed_s=((pl.col("wall_ns") - pl.col("first_ns")) / 1e9).round(1),
            cpu_percent=pl.col("cpu_busiest_percent").round().cast(pl.Int32),
            signal_dbm=pl.col("wifi_signal_dbm").round().cast(pl.Int32),
            delay_ms=pl.col("link_delay_ms"),
            rate_mbit_s=pl.col("link_rate_mbit_s"),
        )
        .sort("role", "elapsed_s", maintain_order=True)
    )
