"""Read the tables with pandas: `python tables_pandas.py runs/analysis`."""

import sys
from pathlib import Path

import pandas as pd

folder = Path(sys.argv[1])
columns = ["vendor", "bridge", "publish_utc", "latency_ns", "outcome"]
roundtrips = pd.read_parquet(folder / "roundtrips.parquet", columns=columns)

# A lost message has no latency: it is missing, never zero.
lost = roundtrips[roundtrips.outcome != "completed"]
print(f"{len(lost)} of {len(roundtrips)} messages lost")

# Medians for every second of UTC, to compare with the load of the machine.
second = pd.Grouper(key="publish_utc", freq="1s")
by_second = roundtrips.groupby(["vendor", "bridge", second]).latency_ns.median()
print((by_second / 1e6).dropna().rename("latency_ms"))

# Columns know their units.
import pyarrow.parquet as pq  # noqa: E402 - pandas reads no units

schema = pq.read_schema(folder / "roundtrips.parquet")
latency = schema.field("latency_ns").metadata
print(latency[b"unit"].decode(), latency[b"meaning"].decode())
