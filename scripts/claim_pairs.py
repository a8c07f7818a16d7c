"""Rows of the runs of a sweep, and what pairs of results say of a claim; `claims.py` asks them."""

from __future__ import annotations

import csv
import math
from collections import Counter, defaultdict
from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING, TypeAlias

import polars as pl

from dds_trace.analyzer.model.setting import LOAD, parse_setting
from dds_trace.analyzer.run_statistics.received import late_share
from dds_trace.analyzer.verdicts.setup_runs import SetupRuns
from dds_trace.base.units import format_duration, format_rate, format_size

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from dds_trace.analyzer.analysis import Analysis

Row: TypeAlias = "Mapping[str, str]"
Key: TypeAlias = "tuple[object, ...]"
"""Values of `NAMES`."""
Runs: TypeAlias = "Mapping[Key, Sequence[Row]]"

NAMES = ("setup", "link", "device", "data", "payload_bytes", "rate_hz")
LATE_MS = (1, 10, 100)
FAST, FAST_ACROSS = "fastdds", "fastdds through builtin"
CYCLONE, CYCLONE_ACROSS = "cyclonedds", "cyclonedds through builtin-zenoh"
WIRED, AIR, LAPTOP, PI = "ethernet-100m", "air-30", "none", "emulated-pi3"
SMALL, LARGE = (33_000, 145_000), (502_000, 1_000_000)
WORDS: Mapping[object, str] = {
    FAST: "Fast DDS",
    FAST_ACROSS: "Fast DDS across",
    CYCLONE: "Cyclone DDS",
    CYCLONE_ACROSS: "Cyclone DDS across",
    WIRED: "wire",
    AIR: "air",
    LAPTOP: "",
    PI: "Pi 3",
    "binary": "",
    "string": "String",
    "imu": "IMU",
}
MBIT_S = {WIRED: 100, AIR: 30 / 2}
"""Rates of the links; both directions share that of the air."""
SAME = 1.25
"""Largest factor between two that are alike."""


def place_of(row: Mapping[str, object]) -> dict[str, str]:
    """Return setup, link and device of a row of round trips, or of the setting of a candidate."""
    bridge, link = str(row["bridge"]), str(row["connectivity"])
    return {
        "setup": f"{row['vendor']}" + ("" if bridge == "none" else f" through {bridge}"),
        "link": link.removeprefix("emulated-"),
        "device": parse_setting(str(row["setting"])).get(LOAD, LAPTOP),
    }


def run_rows(analysis: Analysis) -> list[dict[str, object]]:
    """Return a row for each run: messages that were due, those received, the median with the others infinitely late, and late ones.

    `upper` is the share of late messages that further runs of this result very likely do not exceed.
    """
    rows = []
    group = ("vendor", "bridge", "connectivity", "setting", "data_type", "payload_bytes", "rate_hz")
    for result in analysis.load_messages().partition_by(group, maintain_order=True):
        first = result.row(0, named=True)
        delivered = SetupRuns.of(result).delivered("latency")
        late = [late_share(delivered, ms * 1e6) for ms in LATE_MS]
        own = {f"upper_{ms}_ms": share and share.upper for ms, share in zip(LATE_MS, late, strict=True)}
        for run in result.partition_by("run_id", maintain_order=True):
            times_ns = sorted(run["latency_ns"].cast(pl.Float64).fill_null(math.inf))
            rows.append(
                {
                    **place_of(first),
                    **{name: first[column] for name, column in zip(NAMES[3:], group[4:], strict=True)},
                    "published": len(times_ns),
                    "received": sum(map(math.isfinite, times_ns)),
                    "p50_ns": median(times_ns),
                    **{f"beyond_{ms}_ms": sum(time_ns > ms * 1e6 for time_ns in times_ns) for ms in LATE_MS},
                    **own,
                }
            )
    return sorted(rows, key=lambda row: tuple(map(str, row.values())))


def write_rows(path: Path, rows: Sequence[Mapping[str, object]]) -> None:
    """Write a CSV file."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, next(iter(rows), {}), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def runs_of(rows: Iterable[Row]) -> Runs:
    """Return the runs of each result."""
    runs: dict[Key, list[Row]] = defaultdict(list)
    for row in rows:
        words = tuple(row[name] for name in NAMES[:4])
        runs[(*words, int(row["payload_bytes"]), float(row["rate_hz"]))].append(row)
    return runs


@dataclass(frozen=True, slots=True)
class Asked:
    """Pairs of results, and what the paper says of the first against the second.

    Attributes:
        first: values of the first; `second`: what the other has in place of them.
        where: values of both.
        carried: whether both sides send less than the link's rate, None for all pairs.
        says: `more`, `less`, `alike` (within `SAME`) or `differs`.
        of: of how many pairs: `each`, `every` (one that is not so contradicts), `most` or `some`.
        factor: more than this many times.
        value: column that is compared.
        about: what of the claim it is, if the claim has several parts.
    """

    first: Mapping[str, object]
    second: Mapping[str, object]
    where: Mapping[str, tuple[object, ...]]
    says: str = "more"
    of: str = "each"
    factor: float = 1.0
    value: str = "p50_ns"
    about: str = ""
    carried: bool | None = None


@dataclass(frozen=True, slots=True)
class Pair:
    """One pair: `yes` or `no` where the ranges of the runs do not overlap, else `open`; `ratio` of the medians.

    `chance` is the probability that they do not, in one direction, where nothing differs: 1 in 20 for three runs and three.
    """

    verdict: str
    ratio: float
    words: str
    chance: float


def ratio_of(numerator: float, denominator: float) -> float:
    """Return a ratio; unknown of two that are infinite."""
    if math.isinf(numerator) and math.isinf(denominator):
        return math.nan
    return numerator / denominator if denominator else math.inf


def pairs_of(runs: Runs, asked: Asked) -> list[Pair]:
    """Return the pairs that were recorded."""
    pairs = []
    for key, first in runs.items():
        values = dict(zip(NAMES, key, strict=True))
        if any(values[name] != value for name, value in asked.first.items()):
            continue
        if any(values[name] not in allowed for name, allowed in asked.where.items()):
            continue
        other = {**values, **asked.second}
        second = runs.get(tuple(other.values()))
        if second and asked.carried in (None, is_carried(values) and is_carried(other)):
            pairs.append(judged(asked, values, first, second))
    return pairs


def is_carried(values: Mapping[str, object]) -> bool:
    """Return whether a result's messages, without headers, are less than its link carries."""
    offered_mbit_s = float(str(values["payload_bytes"])) * float(str(values["rate_hz"])) * 8e-6
    return offered_mbit_s < MBIT_S[str(values["link"])]


def judged(asked: Asked, values: Mapping[str, object], first: Sequence[Row], second: Sequence[Row]) -> Pair:
    """Judge one pair."""
    own, base = (sorted(float(row[asked.value]) for row in side) for side in (first, second))
    low, middle, high = (
        ratio_of(top, bottom) / asked.factor
        for top, bottom in ((own[0], base[-1]), (median(own), median(base)), (own[-1], base[0]))
    )
    is_alike, differs = low > 1 / SAME and high < SAME, low > SAME or high < 1 / SAME
    yes, no = {
        "alike": (is_alike, differs),
        "differs": (differs, is_alike),
        "more": (low > 1, high < 1),
        "less": (high < 1, low > 1),
    }[asked.says]
    fixed = {name for name, allowed in asked.where.items() if len(allowed) == 1} | set(asked.first)
    fixed |= set() if values["data"] == "binary" else {"payload_bytes", "rate_hz"}
    where = [word for name, value in values.items() if name not in fixed and (word := value_words(name, value))]
    sides = (
        f"{' '.join(value_words(name, value) for name, value in which.items())} {side_words(asked.value, side)}"
        for which, side in ((asked.first, first), (asked.second, second))
    )
    chance = 1 / math.comb(len(own) + len(base), len(own))
    words = ": ".join(filter(None, (", ".join(where), ", ".join(sides))))
    return Pair("yes" if yes else "no" if no else "open", middle, words, chance)


def place_words(place: Iterable[object]) -> str:
    """Return how a sentence names link and device."""
    return " and ".join(filter(None, (WORDS[name] for name in place)))


def value_words(name: str, value: object) -> str:
    """Return how a sentence names a value."""
    if name == "payload_bytes":
        return format_size(int(str(value)))
    return format_rate(float(str(value))) if name == "rate_hz" else WORDS[value]


def side_words(value: str, side: Sequence[Row]) -> str:
    """Return the median of the runs, and their range."""
    if value == "received":
        return f"{sum(int(row[value]) for row in side)} of {sum(int(row['published']) for row in side)}"
    times_ns = sorted(float(row[value]) for row in side)
    low, middle, high = (
        "lost" if math.isinf(ns) else format_duration(ns) for ns in (times_ns[0], median(times_ns), times_ns[-1])
    )
    if low == high:
        return middle
    units = {time.split()[-1] for time in (low, middle, high)}
    ends = (low, high) if len(units) > 1 else (low.split()[0], high.split()[0])
    return f"{middle} ({'..'.join(ends)})"


REPRODUCED, SAME_WAY, CONTRADICTED, UNDECIDED = "reproduced", "the same in direction", "contradicted", "undecided"


def is_more_than_chance(count: int, pairs: Sequence[Pair]) -> bool:
    """Return whether so many of the pairs, or more, are decided by chance in less than 5 % of cases."""
    chance, all_pairs = max(pair.chance for pair in pairs), len(pairs)
    rest = (math.comb(all_pairs, k) * chance**k * (1 - chance) ** (all_pairs - k) for k in range(count, all_pairs + 1))
    return sum(rest) < 0.05


def outcome(pairs: Sequence[Pair], of: str) -> str:
    """Return what the pairs mean for what is said of so many of them."""
    counts = Counter(pair.verdict for pair in pairs)
    yes, no = (counts[verdict] if is_more_than_chance(counts[verdict], pairs) else 0 for verdict in ("yes", "no"))
    if {"most": yes > len(pairs) / 2, "some": yes > 0}.get(of, yes == len(pairs)):
        return REPRODUCED
    if of in ("some", "most"):
        return CONTRADICTED if no > len(pairs) / 2 else UNDECIDED
    if no > 2 * yes or (no and of == "every"):
        return CONTRADICTED
    return SAME_WAY if yes > 2 * no else UNDECIDED


def measured(pairs: Sequence[Pair]) -> str:
    """Return how many pairs are as the paper says and how many are not, with the most telling one of the more frequent, unless alike."""
    counts = Counter(pair.verdict for pair in pairs)
    verdict = "no" if counts["no"] > counts["yes"] else "yes"
    decided = [pair for pair in pairs if pair.verdict == verdict]
    finite = [pair for pair in decided if 0 < pair.ratio < math.inf]
    most = max(finite or decided, key=lambda pair: abs(math.log(pair.ratio)) if finite else 0.0, default=None)
    against = f", not {counts['no']}" if counts["no"] and counts["open"] else ""
    words = f"{counts['yes']} of {len(pairs)}{against}"
    return f"{words} ({most.words})" if most and not 1 / SAME < most.ratio < SAME else words
