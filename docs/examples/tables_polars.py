"""Read the tables with polars: `python tables_polars.py runs/analysis`."""

import json
import sys
from pathlib import Path

import polars as pl

folder = Path(sys.argv[1])

# Lazily: only the columns that are asked for are read.
tail = (
    pl.scan_parquet(folder / "roundtrips.parquet")
    .filter(pl.col("outcome") == "completed", pl.col("bridge") == "none")
    .group_by("vendor", "data_type", "payload_bytes")
    .agg(
        (pl.col("latency_ns").quantile(0.99, "linear") / 1e6).alias("p99_ms"),
        pl.col("publish_utc").min().alias("first_utc"),
    )
    .sort("data_type", "payload_bytes", "vendor")
    .collect()
)
print(tail)

metadata = pl.read_parquet_metadata(folder / "roundtrips.parquet")
print("by", metadata["dds_trace.version"], metadata["dds_trace.contract"])
for clock in json.loads(metadata["dds_trace.clocks"])["sessions"]:
    print(clock["role"], clock["device"], "started", clock["started"])
    print("synchronized:", clock["synchronized"])
