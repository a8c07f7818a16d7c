"""What the analyzer does, with mcap, numpy and polars alone: a folder of traces -> round trips and their summary."""

import json
import sys
from pathlib import Path

import numpy as np
import polars as pl
from mcap.reader import make_reader

FIELDS = ["run_id", "sequence", "at", "scheduled_ns", "source_ns", "received_ns", "payload_bytes", "relay_id"]
EVENT = np.dtype({"names": FIELDS, "formats": ["<u8", "<u8", "<i8", "<i8", "<i8", "<i8", "<u4", "<u4"]})
MESSAGE = ("run_id", "relay_id", "sequence")
SETTINGS = ("vendor", "backend", "bridge", "data_type", "payload_bytes", "rate_hz")
METRICS = ("rtt", "intermediate", "latency", "response")
PERCENTILES = {"p50": (0.5, 1), "p90": (0.9, 10), "p95": (0.95, 20), "p99": (0.99, 100), "p99_9": (0.999, 1000)}
LOST = ("lost_outbound", "lost_in_relay", "lost_return")


def load(folder: Path) -> tuple[dict[str, pl.DataFrame], pl.DataFrame]:
    """Return the events t1 to t4, and a row for each run."""
    events, described = {f"t{n}": [] for n in (1, 2, 3, 4)}, {"run": {}, "session": {}}
    for path in sorted(folder.rglob("*.mcap")):
        with path.open("rb") as file:
            for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
                kind = channel.topic.rpartition("/")[2]
                if kind in events:
                    events[kind].append(message.data[4:])  # CDR: a header of 4 bytes, then fields without gaps
                elif kind in described:
                    text = json.loads(message.data[8:].rstrip(b"\0"))
                    described[kind][text[f"{kind}_id"]] = text  # the last one counts
    sessions = described["session"]
    runs = [{"bridge": "none", **sessions[run["session_id"]], **run} for run in described["run"].values()]
    numbered = [{"run_id": int(run["run_id"], 16), "warmup": run["warmup_messages"]} for run in runs]
    rows = [number | {name: run[name] for name in SETTINGS} for number, run in zip(numbered, runs, strict=True)]
    frames = {kind: pl.DataFrame(np.frombuffer(b"".join(found), EVENT)) for kind, found in events.items()}
    return frames, pl.DataFrame(rows, schema_overrides={"run_id": pl.UInt64, "warmup": pl.UInt64})


def pair(events: dict[str, pl.DataFrame], runs: pl.DataFrame) -> pl.DataFrame:
    """Return a row for each message and relay, without warm-up: its times in ns, and where it was lost."""
    relays = pl.concat(events[kind].select("run_id", "relay_id") for kind in ("t2", "t3", "t4")).unique()
    sent = events["t1"].group_by("run_id", "sequence").agg(pl.min("at").alias("publish_ns"), pl.first("scheduled_ns"))
    rows = sent.join(runs, "run_id").filter(pl.col("sequence") >= pl.col("warmup")).join(relays, "run_id", how="left")
    for kind, name in (("t2", "receive_ns"), ("t3", "relay_in_ns"), ("t4", "relay_out_ns")):
        first = events[kind].group_by(MESSAGE).agg(pl.min("at").alias(name), pl.len().alias(f"copies_{kind}"))
        rows = rows.join(first, MESSAGE, how="left", nulls_equal=True)
    t0, t1, t2, t3, t4 = map(pl.col, ("scheduled_ns", "publish_ns", "receive_ns", "relay_in_ns", "relay_out_ns"))
    place = pl.when(t3.is_null()).then(0).when(t4.is_null()).then(1).otherwise(2).replace_strict(dict(enumerate(LOST)))
    return rows.sort(MESSAGE).with_columns(
        rtt_ns=t2 - t1,
        intermediate_ns=t4 - t3,
        latency_ns=((t2 - t1) - (t4 - t3)) // 2,
        response_ns=t2 - pl.when(t0 != 0).then(t0),
        duplicates=pl.col("copies_t2").fill_null(1) - 1,
        outcome=pl.when(t2.is_null()).then(place).otherwise(pl.lit("completed")),
    )


def summarize(rows: pl.DataFrame, by: tuple[str, ...] = SETTINGS) -> pl.DataFrame:
    """Return a row for each group: counts, and statistics of each metric; a percentile of too few messages is null."""
    columns = [pl.len().alias("published"), pl.count("receive_ns").alias("received")]
    columns += [(pl.col("outcome") == name).sum().alias(name) for name in LOST]
    for metric, ns in ((metric, pl.col(f"{metric}_ns")) for metric in METRICS):
        of = {"mean": ns.mean(), "std": ns.std(), "min": ns.min().cast(float), "max": ns.max().cast(float)}
        of |= {p: pl.when(ns.count() >= n).then(ns.quantile(q, "linear")) for p, (q, n) in PERCENTILES.items()}
        columns += [value.alias(f"{metric}_{name}_ns") for name, value in of.items()]
    return rows.group_by(by).agg(columns).sort(by)


if __name__ == "__main__":
    print(summarize(pair(*load(Path(sys.argv[1])))))
