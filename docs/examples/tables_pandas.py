"""Read the Parquet files of an analysis with pandas: `python tables_pandas.py runs/analysis`."""

import sys
from pathlib import Path

import pandas as pd

folder = Path(sys.argv[1])
columns = ["vendor", "bridge", "data_type", "sequence", "publish_utc", "latency_ns", "outcome"]
roundtrips = pd.read_parquet(folder / "roundtrips.parquet", columns=columns)

# A lost message has no latency: it is missing, never zero, and no mean may forget it.
lost = roundtrips[roundtrips.outcome != "completed"]
print(f"{len(lost)} of {len(roundtrips)} messages lost")

# A median for every second of UTC and each middleware and bridge, to compare with the load of the machine or the network.
by_second = roundtrips.groupby(["vendor", "bridge", pd.Grouper(key="publish_utc", freq="1s")]).latency_ns.median() / 1e6
print(by_second.dropna().rename("latency_ms"))

# Columns know their units.
import pyarrow.parquet as pq  # noqa: E402 - pandas itself reads no metadata of columns

latency = pq.read_schema(folder / "roundtrips.parquet").field("latency_ns").metadata
print(latency[b"unit"].decode(), latency[b"meaning"].decode())
