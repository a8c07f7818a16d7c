"""Per-message latency as an MCAP for Foxglove and PlotJuggler, with a Foxglove layout (docs/how-to/analyze.md)."""

from __future__ import annotations

import json
import os
import re
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
from mcap.writer import CompressionType, Writer

from dds_trace.analyzer.model.metrics import METRICS
from dds_trace.analyzer.model.parameters import ParameterValue
from dds_trace.base.errors import OutputError, OutputExistsError
from dds_trace.base.files import replacing, write_whole
from dds_trace.base.printable import printable
from dds_trace.base.units import format_size
from dds_trace.base.version import __version__
from dds_trace.tracefile.format.encoding import CDR_HEADER

SCHEMA_NAME = "dds_trace_msgs/msg/MessageLatency"
_FIRST = ("latency", "rtt", "response", "intermediate")
TIMES = (*_FIRST, *(name for name in METRICS if name not in _FIRST), "outbound", "return", "clock_bound")
"""Columns `<name>_ns` of the round trips; fields `<name>_ms` of the message, NaN where unknown."""

SCHEMA = "".join(
    ["uint64 sequence\n", *(f"float64 {name}_ms\n" for name in TIMES), "uint32 payload_bytes\n", "bool lost\n"]
)

_RECORD = np.dtype(
    [
        ("cdr", f"V{len(CDR_HEADER)}"),
        ("sequence", "<u8"),
        *((f"{name}_ms", "<f8") for name in TIMES),
        ("payload_bytes", "<u4"),
        ("lost", "u1"),
    ]
)
"""The serialized message needs no padding."""

PLOTTED_TOPICS = 12
"""Most lines of a plot in the layout; the file has all topics."""


@dataclass(frozen=True, slots=True)
class DerivedTrace:
    """The written MCAP and Foxglove layout and their content; times without a clock anchor count from the device's boot."""

    path: Path
    layout: Path
    topics: tuple[str, ...]
    messages: int


def write_derived(
    roundtrips: pl.DataFrame,
    path: str | os.PathLike[str],
    ping_wall: Mapping[int, int] | None = None,
    *,
    force: bool = False,
) -> DerivedTrace:
    """Write per-message latency to `path`, and the layout to `NAME.foxglove.json` in the same folder.

    Args:
        roundtrips: frame of `docs/trace-format.md`; one-way times are optional.
        path: ends in `.mcap`.
        ping_wall: wall clock minus monotonic clock of each run's ping, ns.
        force: overwrite existing files.

    Raises:
        OutputExistsError: a file is there already.
        OutputError: a file cannot be written.
    """
    path = Path(path)
    layout = path.with_suffix(".foxglove.json")
    for target in (path, layout):
        if target.exists() and not force:
            raise OutputExistsError(f"{target}: exists already; choose another name or add --force")
    rows = _in_order(roundtrips, ping_wall or {})
    topics = tuple(rows["topic"].unique(maintain_order=True))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as draft, draft.open("wb") as file:
            _write_messages(Writer(file, compression=CompressionType.ZSTD), rows, topics)
        write_whole(layout, json.dumps(foxglove_layout(topic_words(rows)), indent=2) + "\n")
    except OSError as err:
        raise OutputError(
            f"{path}: cannot be written ({err.strerror or err}); check disk space and permissions"
        ) from err
    return DerivedTrace(path, layout, topics, len(rows))


def _in_order(roundtrips: pl.DataFrame, ping_wall: Mapping[int, int]) -> pl.DataFrame:
    """Return the messages in the order of log time, with the columns `topic` and `log_ns` (i64, never below 0)."""
    runs = pl.Series(list(ping_wall), dtype=pl.UInt64)
    offsets = pl.Series(list(ping_wall.values()), dtype=pl.Int64)
    offset = pl.col("run_id").replace_strict(runs, offsets, default=0) if ping_wall else pl.lit(0, pl.Int64)
    missing = [pl.lit(None, pl.Int64).alias(f"{name}_ns") for name in TIMES if f"{name}_ns" not in roundtrips.columns]
    keys = ["vendor", "bridge", "data_type", "payload_bytes", "rate_hz", "run_id", "relay_id"]
    names = roundtrips.select(keys).unique()
    with_topics = names.with_columns(
        pl.Series("topic", [topic_name(row) for row in names.iter_rows(named=True)], pl.String)
    )
    return (
        roundtrips.with_columns(missing)
        .with_columns(log_ns=(pl.col("publish_ns") + offset).clip(0))
        .join(with_topics.select("run_id", "relay_id", *keys[:5], "topic"), on=keys, how="left", nulls_equal=True)
        .sort("log_ns", "run_id", "relay_id", "sequence")
    )


def topic_name(row: Mapping[str, ParameterValue]) -> str:
    """Name the channel of a run and relay: `/latency/fastdds/builtin/binary_33000B_10Hz/run_RRRRRRRR/relay_PPPPPPPP`.

    Only letters, digits and underscores, so that every tool accepts it as a topic.
    """
    message = f"{row['data_type']}_{row['payload_bytes']}B_{row['rate_hz']:g}Hz"
    words = [row["vendor"], row["bridge"], message, f"run_{row['run_id']:016x}", f"relay_{row['relay_id']:08x}"]
    return "/latency/" + "/".join(re.sub(r"[^A-Za-z0-9_]+", "_", str(word)) for word in words)


def topic_words(rows: pl.DataFrame) -> dict[str, str]:
    """Return topic -> its name in words, `fastdds, builtin, binary 33 KB, 10 Hz, run 2, relay pi4`.

    Runs are counted by their start. The relay is left out where its run has no other; its id replaces a device that several have.
    """
    by_name: dict[str, dict[int, int]] = defaultdict(dict)
    topics = list(rows.unique("topic", maintain_order=True).iter_rows(named=True))
    relays = Counter(row["run_id"] for row in topics)
    devices = Counter((row["run_id"], row["relay_device"]) for row in topics)
    words = {}
    for row in topics:
        ways = [row["vendor"]] if row["bridge"] == "none" else [row["vendor"], row["bridge"]]
        message = f"{row['data_type']} {format_size(row['payload_bytes'])}"
        name = printable(", ".join((*ways, message, f"{row['rate_hz']:g} Hz")))
        run_id, device = row["run_id"], row["relay_device"]
        number = by_name[name].setdefault(run_id, len(by_name[name]) + 1)
        relay = printable(device) if device and devices[run_id, device] == 1 else f"{row['relay_id']:08x}"
        words[row["topic"]] = f"{name}, run {number}" + (f", relay {relay}" if relays[run_id] > 1 else "")
    return words


def _write_messages(writer: Writer, rows: pl.DataFrame, topics: Sequence[str]) -> None:
    writer.start(profile="ros2", library=f"dds-trace {__version__}")
    schema = writer.register_schema(SCHEMA_NAME, "ros2msg", SCHEMA.encode())
    words = topic_words(rows)
    channels = {topic: writer.register_channel(topic, "cdr", schema, {"name": words[topic]}) for topic in topics}
    records = np.zeros(len(rows), _RECORD)
    records["cdr"] = np.void(CDR_HEADER)
    records["sequence"] = rows["sequence"].to_numpy()
    for name in TIMES:
        # numpy divides; polars multiplies by a reciprocal, which is off in the last place.
        records[f"{name}_ms"] = rows[f"{name}_ns"].cast(pl.Float64).fill_null(float("nan")).to_numpy() / 1e6
    records["payload_bytes"] = rows["payload_bytes"].to_numpy()
    records["lost"] = (rows["outcome"] != "completed").to_numpy()
    size, data = _RECORD.itemsize, records.tobytes()
    counts = dict.fromkeys(topics, 0)
    for number, (topic, log_ns) in enumerate(rows.select("topic", "log_ns").iter_rows()):
        message = data[number * size : (number + 1) * size]
        writer.add_message(channels[topic], log_ns, message, log_ns, counts[topic])
        counts[topic] += 1
    writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves this one untyped


def foxglove_layout(topics: Mapping[str, str]) -> dict[str, object]:
    """Lay out four plots of the first `PLOTTED_TOPICS` of topic -> its name: latency, response, one way each, losses."""
    plots = {
        "Plot!latency": ("Latency (ms)", ("latency_ms",)),
        "Plot!response": ("Response: planned sending to reply (ms)", ("response_ms",)),
        "Plot!oneway": (
            "One way: outbound and return, and the clocks' bound (ms)",
            ("outbound_ms", "return_ms", "clock_bound_ms"),
        ),
        "Plot!lost": ("Lost", ("lost",)),
    }
    shown = list(topics.items())[:PLOTTED_TOPICS]
    return {
        "configById": {
            panel: {
                "title": title,
                "paths": [
                    {
                        "value": f"{topic}.{field}",
                        "enabled": True,
                        "timestampMethod": "receiveTime",
                        "label": words + (f", {field.removesuffix('_ms')}" if len(fields) > 1 else ""),
                    }
                    for topic, words in shown
                    for field in fields
                ],
                "showLegend": True,
                "legendDisplay": "left",
                "showXAxisLabels": True,
                "showYAxisLabels": True,
                "isSynced": True,
                "xAxisVal": "timestamp",
            }
            for panel, (title, fields) in plots.items()
        },
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {
            "direction": "column",
            "first": {"direction": "column", "first": "Plot!latency", "second": "Plot!response"},
            "second": {"direction": "column", "first": "Plot!oneway", "second": "Plot!lost", "splitPercentage": 70},
        },
    }
