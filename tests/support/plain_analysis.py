"""The numbers of a folder of traces by struct and loops alone: slow, plain, and none of the analyzer's code.

The expected values of `sample_traces/` come from here, so that a mistake of the analyzer cannot hide in them.
It follows `docs/trace-format.md` for closed traces of one ping and one relay session a file.
"""

import json
import math
import struct
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from plain_roundtrips import STAGES, plain_roundtrips

PERCENTILES = {"p50": 0.50, "p90": 0.90, "p95": 0.95, "p99": 0.99, "p99_9": 0.999}
SUPPORT = {"p50": 1, "p90": 10, "p95": 20, "p99": 100, "p99_9": 1000}
METRICS = ("rtt", "intermediate", "latency", "response")
OUTCOMES = ("completed", "lost_outbound", "lost_in_relay", "lost_return")


def _string(data: bytes) -> str:
    (length,) = struct.unpack_from("<I", data, 4)
    return data[8 : 8 + length - 1].decode()


def read_plain(path: Path) -> dict[str, Any]:
    held: dict[str, Any] = {"sessions": {}, "runs": {}, "events": {stage: [] for stage in STAGES}}
    with path.open("rb") as stream:
        for _schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            name = channel.topic.rsplit("/", 1)[-1]
            if name in ("session", "run"):
                described = json.loads(_string(message.data))
                held[f"{name}s"][described[f"{name}_id"]] = described
            elif name in held["events"]:
                assert message.data[:4] == b"\x00\x01\x00\x00"
                assert len(message.data) == 60
                held["events"][name].append(message.data[4:])
    return held


def percentile(ordered: list[int], q: float) -> float:
    position = q * (len(ordered) - 1)
    low = math.floor(position)
    high = min(low + 1, len(ordered) - 1)
    return ordered[low] + (ordered[high] - ordered[low]) * (position - low)


def metric_summary(values: list[int]) -> dict[str, float | None]:
    ordered = sorted(values)
    out: dict[str, float | None] = {"count": len(ordered)}
    if not ordered:
        return out
    out["mean"] = math.fsum(ordered) / len(ordered)
    out["min"] = ordered[0]
    out["max"] = ordered[-1]
    for name, q in PERCENTILES.items():
        out[name] = percentile(ordered, q) if len(ordered) >= SUPPORT[name] else None
    return out


def analyze_plain(folder: Path) -> dict[str, Any]:
    files = [read_plain(path) for path in sorted(folder.rglob("*.mcap"))]
    packed = {stage: [event for held in files for event in held["events"][stage]] for stage in STAGES}
    runs: dict[str, Any] = {}
    for held in files:
        for run in held["runs"].values():
            (session,) = held["sessions"].values()
            runs[run["run_id"]] = _one_run(run, session, packed)
    return {"runs": dict(sorted(runs.items()))}


def _one_run(run: Any, session: Any, packed: Mapping[str, list[bytes]]) -> dict[str, Any]:
    rows = plain_roundtrips(int(run["run_id"], 16), run["warmup_messages"], packed).values()
    measured = {name: [getattr(row, f"{name}_ns") for row in rows] for name in METRICS}
    return {
        "vendor": session["vendor"],
        "backend": session["backend"],
        "ping_domain_id": session["domain_id"],
        "bridge": run["bridge"],
        "data_type": run["data_type"],
        "payload_bytes": run["payload_bytes"],
        "rate_hz": run["rate_hz"],
        "published": len(rows),
        "outcomes": dict.fromkeys(OUTCOMES, 0) | Counter(row.outcome for row in rows),
        **{name: metric_summary([ns for ns in values if ns is not None]) for name, values in measured.items()},
    }
