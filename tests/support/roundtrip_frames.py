"""Round trips written down by hand: the columns of `roundtrips.parquet` from a few stamps and parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import polars as pl

from dds_trace.analyzer.model.column import schema_of
from dds_trace.analyzer.model.columns import ROUNDTRIP_COLUMNS
from dds_trace.analyzer.model.metrics import with_metrics
from dds_trace.analyzer.model.parameters import PARAMETER_NAMES

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

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
            },
        )
    schema = schema_of(ROUNDTRIP_COLUMNS)
    extra = {name for row in filled for name in row} - set(schema)
    frame = pl.DataFrame(filled, schema={**schema, **dict.fromkeys(sorted(extra), pl.Int64)})
    return with_metrics(frame)


def steady(
    latencies_ns: Iterable[int | None], *, period_ns: int = 100 * MS, **parameters: Any
) -> pl.DataFrame:
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
            },
        )
    return roundtrips(rows, **parameters)
