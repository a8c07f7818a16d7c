"""The proof that one setup is better than another: its verdicts, and in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from dds_trace.analyzer.model.parameters import CONTENDER_COLUMNS
from dds_trace.analyzer.pipeline import analyze
from dds_trace.base.units import MISSING
from dds_trace.extensions.gates.compare import CompareOptions, compare
from dds_trace.extensions.gates.costs import pays, speaks_against
from dds_trace.extensions.gates.ignoring import IGNORABLE_COLUMNS, match_without
from dds_trace.reports.book.groups import time_words

Proof: TypeAlias = "dict[str, Any]"
"""`kept` (is better), `verdict` (better, worse, mixed, no difference or incomplete), `reason`, and the rows of the comparison `proof` and `received`, ns."""

_MESSAGE = ("data_type", "payload_bytes", "rate_hz")
_PROOF = (*_MESSAGE, "statistic", "base_ns", "new_ns", "ratio", "ratio_low", "ratio_high", "verdict")
_RECEIVED = (*_MESSAGE, "base_received_ratio", "new_received_ratio", "difference_high", "verdict")


def compared() -> CompareOptions:
    """Return how setups are compared: messages of a kind, with the time that they wait to be sent."""
    match = match_without(name for name in CONTENDER_COLUMNS if name in IGNORABLE_COLUMNS)
    return CompareOptions(metrics=("response",), statistics=("p50", "p90", "p99"), match=match, paired=True)


def proof_of(name: str, base: Path, new: Path) -> Proof:
    """Compare the recordings of two folders, repeat by repeat; `name` is the new side's."""

    comparison = compare(analyze(base, details=False), analyze(new, details=False), compared())
    pays_off = pays(comparison)
    proof = comparison.rows.select(_PROOF).rows(named=True)
    received = comparison.delivery.select(_RECEIVED).rows(named=True)
    verdicts = {row["verdict"] for row in (*proof, *received)}
    verdict = "better" if pays_off else "worse" if "worse" in verdicts else "no difference"
    if not pays_off and "better" in verdicts:
        verdict = "mixed" if any(speaks_against(proof, received)) else "incomplete"
    reason = f"{name} " + ("is proven better" if pays_off else f"looked best, but {why_not(proof, received)}")
    differing = [sentence.partition(" ")[0] for sentence in comparison.ignored]  # each begins with its column
    outcome = {"verdict": verdict, "reason": reason, "ignored": differing}
    return {"kept": pays_off, **outcome, "proof": proof, "received": received}


def proof_lines(proof: Sequence[Mapping[str, Any]], received: Sequence[Mapping[str, Any]]) -> list[str]:
    """Describe each row; what was received comes first where the base lost most."""
    lost_most = any(row["base_received_ratio"] < 0.5 for row in received)
    parts = [list(map(_response, proof)), list(map(_delivery, received))]
    return [line for part in (reversed(parts) if lost_most else parts) for line in part]


def why_not(proof: Sequence[Proof], received: Sequence[Proof]) -> str:
    fewer, slower = speaks_against(proof, received)
    judged = [_delivery(row, "fewer") for row in fewer] + [_response(row, "slower") for row in slower]
    if not judged and "better" in {row["verdict"] for row in (*proof, *received)}:
        return "a result is missing, or is not to be judged"
    moved = min((row for row in proof if row["ratio"] is not None), key=lambda row: row["ratio"], default=None)
    most = (
        "" if moved is None or moved["verdict"] != "inconclusive" else f"; moved most, not proven: {_response(moved)}"
    )
    return (judged[0] if judged else "no time and no share received is proven better") + most


def _response(row: Mapping[str, Any], verdict: str = "") -> str:
    before, after = map(time_words, (row["base_ns"], row["new_ns"]))
    if before == after == MISSING:
        return f"{_result(row)}: response {row['statistic']}: too few messages"
    ratios = [row[name] for name in ("ratio", "ratio_low", "ratio_high")]
    has_ratio = "lost" not in (before, after) and None not in ratios
    times = ", paired {:.2f} times ({:.2f} to {:.2f})".format(*ratios) if has_ratio else ""
    return f"{_result(row)}: response {row['statistic']} {before} -> {after}{times}: {verdict or row['verdict']}"


def _delivery(row: Mapping[str, Any], verdict: str = "") -> str:
    shares = f"{row['base_received_ratio']:.2%} -> {row['new_received_ratio']:.2%}"
    return f"{_result(row)}: received {shares}: {verdict or row['verdict']}"


def _result(row: Mapping[str, Any]) -> str:
    return f"{row['data_type']} {row['payload_bytes']:,} bytes at {row['rate_hz']:g} Hz"
