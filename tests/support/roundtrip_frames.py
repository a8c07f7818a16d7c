"""Round trips written down by hand: the columns of `roundtrips.parquet` from a few stamps and parameters."""

from collections.abc import Iterable, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import polars as pl

from dds_trace.analyzer.model.columns import ROUNDTRIP_COLUMNS
from dds_trace.analyzer.model.metrics import schema_of, with_metrics
from dds_trace.analyzer.model.parameters import PARAMETER_NAMES
from dds_trace.analyzer.pairing.one_way import ONE_WAY_COLUMNS, fit_exchanges
from dds_trace.analyzer.pairing.pair import MISSING
from dds_trace.analyzer.pairing.rows import RowStore

MS = 1_000_000
S = 1_000_000_000

PLAIN: dict[str, Any] = {
    "vendor": "fastdds",
    "backend": "ros2",
    "rmw": "rmw_fastrtps_cpp",
    "bridge": "none",
    "relay_vendor": "fastdds",
    "relay_backend": "ros2",
    "ping_domain_id": 5,
    "relay_domain_id": 5,
    "domain_mode": "same",
    "data_type": "binary",
    "payload_bytes": 33_000,
    "rate_hz": 10.0,
    "reliability": "reliable",
    "durability": "volatile",
    "history": "keep_last",
    "depth": 10,
    "serialization": "raw",
    "ping_device": "ping-pi",
    "relay_device": "relay-pi",
    "connectivity": "wired",
    "setting": "",
}
assert set(PLAIN) == set(PARAMETER_NAMES)


def roundtrips(rows: Iterable[Mapping[str, Any]], **parameters: Any) -> pl.DataFrame:
    """A frame of round trips; a row gives the stamps it has, the rest follows.

    Args:
        rows: stamps (and any other column) of each message; without `sequence` they count from 0, without
            `scheduled_ns` it is `publish_ns`, without `outcome` a message is completed if it has T2.
        parameters: values for every row.
    """
    filled = []
    for number, row in enumerate(rows):
        received = row.get("receive_ns") is not None
        filled.append(
            {
                "run_id": 1,
                "relay_id": 1,
                "sequence": number,
                **PLAIN,
                "scheduled_ns": row.get("publish_ns"),
                "outcome": "completed" if received else "lost_outbound",
                "duplicates": 0,
                "reordered": False,
                **parameters,
                **row,
            }
        )
    schema = schema_of(ROUNDTRIP_COLUMNS)
    extra = {name for row in filled for name in row} - set(schema)
    frame = pl.DataFrame(filled, schema={**schema, **dict.fromkeys(sorted(extra), pl.Int64)})
    return with_metrics(frame)


def steady(latencies_ns: Iterable[int | None], *, period_ns: int = 100 * MS, **parameters: Any) -> pl.DataFrame:
    """One message each period with the given latency both ways and 1 us in the relay; None is a lost message."""
    rows: list[dict[str, Any]] = []
    for number, latency_ns in enumerate(latencies_ns):
        sent = number * period_ns
        if latency_ns is None:
            rows.append({"publish_ns": sent})
            continue
        rows.append(
            {
                "publish_ns": sent,
                "relay_in_ns": sent + latency_ns,
                "relay_out_ns": sent + latency_ns + 1000,
                "receive_ns": sent + 2 * latency_ns + 1000,
            }
        )
    return roundtrips(rows, **parameters)


def with_one_way(frame: pl.DataFrame) -> pl.DataFrame:
    """The frame, whose runs and relays follow one another, with the one-way times that the analysis gives them."""
    of_exchange = frame.partition_by("run_id", "relay_id", maintain_order=True)
    devices = [
        SimpleNamespace(
            ping=SimpleNamespace(device=rows["ping_device"][0], extra={}),
            relay=SimpleNamespace(device=rows["relay_device"][0], extra={}),
        )
        for rows in of_exchange
    ]
    bounds = np.cumsum([0, *(len(rows) for rows in of_exchange)])
    names = ("publish_ns", "relay_in_ns", "relay_out_ns", "receive_ns")
    stamps = {name: frame[name].fill_null(MISSING).to_numpy() for name in names}
    one_way = fit_exchanges(devices, bounds, stamps)
    return frame.drop(ONE_WAY_COLUMNS, strict=False).with_columns(one_way.columns)


def rows_by_group(frame: pl.DataFrame) -> RowStore:
    keys = list(PARAMETER_NAMES)
    counts = frame.group_by(keys, maintain_order=True).agg(pl.len().alias("published"))
    groups = counts.sort(keys, nulls_last=True).with_row_index("group")
    rows = frame.join(groups, on=keys, how="left", nulls_equal=True).sort("group", "run_id", "relay_id", "sequence")
    return RowStore.of(rows.select(frame.columns), groups.drop("group"))


def in_runs(
    latencies_ns: Iterable[int | None], *, runs: int = 3, spread: float = 0.03, **parameters: Any
) -> pl.DataFrame:
    """The same messages in several runs (`run_id` 100 * the given one and up), which are slower and faster by `spread`."""
    held, first = list(latencies_ns), 100 * parameters.pop("run_id", 1)
    factors = [(1 + spread) ** (number - (runs - 1) / 2) for number in range(runs)]
    return pl.concat(
        steady([None if ns is None else round(ns * factor) for ns in held], run_id=first + number, **parameters)
        for number, factor in enumerate(factors)
    )


def of_sizes(factors):
    """Three runs of a size for each factor of 5 ms."""
    sizes = enumerate(factors)
    return pl.concat(in_runs([round(5 * MS * f)] * 30, run_id=i + 1, payload_bytes=1000 + i) for i, f in sizes)
