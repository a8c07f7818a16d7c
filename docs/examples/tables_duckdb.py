"""Ask the tables with SQL: `python tables_duckdb.py runs/analysis`."""

import sys
from pathlib import Path

import duckdb

folder = Path(sys.argv[1])
roundtrips = str(folder / "roundtrips.parquet")
summary = str(folder / "summary.parquet")

print("The slowest messages, with the time at which to look into other logs:")
slowest = """
    SELECT CAST(publish_utc AS TIMESTAMPTZ) AT TIME ZONE 'UTC' AS sent_utc,
        vendor, data_type, sequence, latency_ns / 1e6 AS latency_ms
    FROM read_parquet($file) WHERE outcome = 'completed'
    ORDER BY latency_ns DESC, run_id, sequence LIMIT 5
"""
for row in duckdb.execute(slowest, {"file": roundtrips}).fetchall():
    print(*row)

print("p99 by middleware, bridge, data and rate, and the share that came back:")
by_data = """
    SELECT vendor, bridge, data_type, payload_bytes, rate_hz,
        latency_p99_ns / 1e6 AS p99_ms, received_ratio
    FROM read_parquet($file)
    ORDER BY data_type, payload_bytes, rate_hz, vendor, bridge
"""
for row in duckdb.execute(by_data, {"file": summary}).fetchall():
    print(*row)

print("What the file says of itself:")
metadata = """
    SELECT decode(key), decode(value) FROM parquet_kv_metadata($file)
    WHERE decode(key) LIKE 'dds_trace.%'
"""
for key, value in duckdb.execute(metadata, {"file": summary}).fetchall():
    print(key, value[:70])
