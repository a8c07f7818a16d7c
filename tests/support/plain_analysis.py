"""The numbers of a folder of traces by struct and loops alone: slow, plain, and none of the analyzer's code.

The expected values of `sample_traces/` come from here, so that a mistake of the analyzer cannot hide in them.
It follows `docs/trace-format.md` for closed traces of one ping and one relay session a file.
"""

from __future__ import annotations

import json
import math
import struct
from typing import TYPE_CHECKING, Any

from mcap.reader import make_reader

if TYPE_CHECKING:
    from pathlib import Path

PERCENTILES = {"p50": 0.50, "p90": 0.90, "p95": 0.95, "p99": 0.99, "p99_9": 0.999}
SUPPORT = {"p50": 1, "p90": 10, "p95": 20, "p99": 100, "p99_9": 1000}
METRICS = ("rtt", "intermediate", "latency", "response")


def _string(data: bytes) -> str:
    (length,) = struct.unpack_from("<I", data, 4)
    return data[8 : 8 + length - 1].decode()


def read_plain(path: Path) -> dict[str, Any]:
    """Sessions, runs and events of one file, read with the public reader."""
    held: dict[str, Any] = {"sessions": {}, "runs": {}, "events": {"t1": [], "t2": [], "t3": [], "t4": []}}
    with path.open("rb") as stream:
        for _schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            name = channel.topic.rsplit("/", 1)[-1]
            if name == "session":
                session = json.loads(_string(message.data))
                held["sessions"][session["session_id"]] = session
            elif name == "run":
                run = json.loads(_string(message.data))
                held["runs"][run["run_id"]] = run
            elif name in held["events"]:
                assert message.data[:4] == b"\x00\x01\x00\x00"
                assert len(message.data) == 60
                fields = struct.unpack_from("<QQqqqqII", message.data, 4)
                names = ("run", "sequence", "t", "t0", "source", "received", "bytes", "relay")
                held["events"][name].append(dict(zip(names, fields, strict=True)))
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
    """Per run of `folder`: parameters, outcomes and the four metrics' summaries."""
    files = [read_plain(path) for path in sorted(folder.rglob("*.mcap"))]
    arrivals: dict[tuple[int, int], dict[str, Any]] = {}
    departures: dict[tuple[int, int], dict[str, Any]] = {}
    for held in files:
        for event in held["events"]["t3"]:
            arrivals.setdefault((event["run"], event["sequence"]), event)
        for event in held["events"]["t4"]:
            departures.setdefault((event["run"], event["sequence"]), event)
    runs: dict[str, Any] = {}
    for held in files:
        for run in held["runs"].values():
            (session,) = held["sessions"].values()
            runs[run["run_id"]] = _one_run(held, run, session, arrivals, departures)
    return {"runs": dict(sorted(runs.items()))}


def _outcome(t2: Any, t3: Any, t4: Any) -> str:
    if t2 is not None:
        return "completed"
    if t3 is None:
        return "lost_outbound"
    return "lost_in_relay" if t4 is None else "lost_return"


def _one_run(held: Any, run: Any, session: Any, arrivals: Any, departures: Any) -> dict[str, Any]:
    run_id = int(run["run_id"], 16)
    replies: dict[int, dict[str, Any]] = {}
    for event in held["events"]["t2"]:
        if event["run"] == run_id:
            replies.setdefault(event["sequence"], event)
    outcomes = {"completed": 0, "lost_outbound": 0, "lost_in_relay": 0, "lost_return": 0}
    values: dict[str, list[int]] = {name: [] for name in METRICS}
    published = 0
    for t1 in held["events"]["t1"]:
        sequence = t1["sequence"]
        if t1["run"] != run_id or sequence < run["warmup_messages"]:
            continue
        published += 1
        t2 = replies.get(sequence)
        t3 = arrivals.get((run_id, sequence))
        t4 = departures.get((run_id, sequence))
        outcomes[_outcome(t2, t3, t4)] += 1
        if t2 is not None:
            values["rtt"].append(t2["t"] - t1["t"])
            values["response"].append(t2["t"] - t1["t0"])
        if t3 is not None and t4 is not None:
            values["intermediate"].append(t4["t"] - t3["t"])
            if t2 is not None:
                values["latency"].append(((t2["t"] - t1["t"]) - (t4["t"] - t3["t"])) // 2)
    return {
        "vendor": session["vendor"],
        "backend": session["backend"],
        "ping_domain_id": session["domain_id"],
        "bridge": run["bridge"],
        "data_type": run["data_type"],
        "payload_bytes": run["payload_bytes"],
        "rate_hz": run["rate_hz"],
        "published": published,
        "outcomes": outcomes,
        **{name: metric_summary(values[name]) for name in METRICS},
    }


def write_expected(folder: Path, target: Path) -> None:
    """Compute `folder` and keep the result as `target` (JSON)."""
    target.write_text(json.dumps(analyze_plain(folder), indent=1) + "\n")
