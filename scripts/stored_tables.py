"""Tables of the pages, from rows that a benchmark or a sweep left: `quoted.py` writes them.

python scripts/stored_tables.py runs/paper-claims   # keeps the rows of that sweep for docs/results/study.md
"""

from __future__ import annotations

import csv
import itertools
import math
from collections import Counter, defaultdict
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, TypeAlias

import polars as pl

from dds_trace.analyzer.pipeline import analyze
from dds_trace.base.units import format_duration, format_rate, format_size

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

TOP = Path(__file__).parents[1]
RATIOS = TOP / "benchmarks" / "node.csv"
STUDY = TOP / "docs" / "results" / "study"
CLAIMS = STUDY / "claims.csv"


def read_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV file."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table."""
    return "".join(f"| {' | '.join(cells)} |\n" for cells in (head, ["---"] * len(head), *rows))


def ratio_table(rows: Sequence[Mapping[str, str]]) -> str:
    """Return `bench_node.py --csv` as a table: a row for each contest, the ratio of each load with its extremes, misses bold."""
    loads = dict.fromkeys((int(row["size_bytes"]), float(row["rate_hz"])) for row in rows)
    ratios = {(row["ours"], row["against"], int(row["size_bytes"]), float(row["rate_hz"])): row for row in rows}
    contests = dict.fromkeys((row["ours"], row["against"], row["bar"]) for row in rows)

    def cell(row: Mapping[str, str] | None) -> str:
        if row is None:
            return ""
        ends = sorted(map(float, row["ratios"].split()))
        shown = f"{float(row['ratio']):.2f}"
        is_missed = row["bar"] and float(row["ratio"]) > float(row["bar"])
        span = f" ({ends[0]:.2f} to {ends[-1]:.2f})" if len(ends) > 1 else ""
        return (f"**{shown}**" if is_missed else shown) + span

    return markdown(
        ["ours", "against", *(f"{format_size(size)} at {format_rate(rate)}" for size, rate in loads), "bar"],
        (
            [ours, against, *(cell(ratios.get((ours, against, *load))) for load in loads), bar]
            for ours, against, bar in contests
        ),
    )


LINK_SETUPS = {
    ("fastdds", "none"): "Fast DDS, same domain",
    ("fastdds", "builtin"): "Fast DDS, `builtin`",
    ("cyclonedds", "none"): "Cyclone DDS, same domain",
}
LABELS = {65_400: "87 KB", 151_875: "33 KB", 2_330_025: "1 MB"}
"""Sizes that the paper's programs sent -> those of its text."""


def link_table(rows: Sequence[Mapping[str, str]]) -> str:
    """Return the rows of study/link.csv as a table: a size of the text, then the one that was sent, in each setup."""
    results = {}
    for row in rows:
        size, setup = int(row["payload_bytes"]), (row["vendor"], row["bridge"])
        results[LABELS.get(size) or format_size(size), float(row["rate_hz"]), row["depth"], setup] = row

    def cell(row: Mapping[str, str]) -> str:
        is_whole = row["received"] == row["planned"]
        share = "all" if is_whole else f"**{row['received']} of {row['planned']}**"
        return f"{share}, {format_duration(round(float(row['latency_p50_ns'])))}"

    lines = []
    for label, rate, depth in itertools.product(("33 KB", "87 KB", "1 MB"), (4.0, 20.0), ("10", "1")):
        cells = [results[label, rate, depth, setup] for setup in LINK_SETUPS]
        sent = int(cells[0]["payload_bytes"])
        shown = format_size(sent) if depth == "10" else f"{sent:,} B"
        lines.append([shown, f"{rate:g} Hz", depth, *map(cell, cells)])
    return markdown(["size", "rate", "depth", *LINK_SETUPS.values()], lines)


Result: TypeAlias = "tuple[str, str, str, str, int, float]"
"""Setup, link, device, data type, bytes and rate."""
Runs: TypeAlias = "dict[Result, list[Mapping[str, str]]]"

LATE_MS = (1, 10, 100)
FAST, FAST_ACROSS = "fastdds", "fastdds through builtin"
CYCLONE, CYCLONE_ACROSS = "cyclonedds", "cyclonedds through builtin-zenoh"
WIRED, AIR, LAPTOP, PI = "ethernet-100m", "air-30", "none", "emulated-pi3"
SAME = 1.25
"""Largest factor between two that are alike."""


def keep_claims(folder: Path, path: Path = CLAIMS) -> None:
    """Write a row for each run of a sweep: messages, those received, its median with lost ones infinitely late, and late ones."""
    trips = analyze(folder).load_roundtrips()
    late = trips.with_columns(pl.col("latency_ns").cast(pl.Float64).fill_null(math.inf))
    rows = []
    for run in late.partition_by("run_id", maintain_order=True):
        first, times_ns = run.row(0, named=True), run["latency_ns"]
        setting = dict(part.split("=", 1) for part in first["setting"].split(",") if "=" in part)
        rows.append(
            {
                "setup": first["vendor"] + ("" if first["bridge"] == "none" else f" through {first['bridge']}"),
                "link": first["connectivity"].removeprefix("emulated-"),
                "device": setting.get("load", LAPTOP),
                "data": first["data_type"],
                "payload_bytes": first["payload_bytes"],
                "rate_hz": first["rate_hz"],
                "published": len(run),
                "received": int(times_ns.is_finite().sum()),
                "p50_ns": sorted(times_ns)[len(run) // 2],
                **{f"beyond_{ms}_ms": int((times_ns > ms * 1e6).sum()) for ms in LATE_MS},
            }
        )
    rows.sort(key=lambda row: tuple(map(str, row.values())))
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, rows[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def runs_of(rows: Iterable[Mapping[str, str]]) -> Runs:
    """Return the runs of each result."""
    runs: Runs = defaultdict(list)
    for row in rows:
        key = row["setup"], row["link"], row["device"], row["data"], int(row["payload_bytes"]), float(row["rate_hz"])
        runs[key].append(row)
    return runs


@dataclass(frozen=True, slots=True)
class Asked:
    """Pairs of results, and what the paper says of the first against the second.

    Attributes:
        first: values of the first; `second`: what the other has in place of them.
        where: values of both.
        is_alike: whether both are said to be alike; else the first is said to have more.
        factor: more than this many times.
        value: what is compared.
    """

    first: Mapping[str, object]
    second: Mapping[str, object]
    where: Mapping[str, tuple[object, ...]]
    is_alike: bool = False
    factor: float = 1.0
    value: str = "p50_ns"


NAMES = ("setup", "link", "device", "data", "payload_bytes", "rate_hz")


def answers(runs: Runs, asked: Asked) -> list[tuple[str, float]]:
    """Return for each pair `yes`, `no` or `open`, by the ranges of the runs, and the ratio of the medians."""
    found = []
    for key, first in runs.items():
        values = dict(zip(NAMES, key, strict=True))
        is_first = all(values[name] == value for name, value in asked.first.items())
        if not is_first or not all(values[name] in allowed for name, allowed in asked.where.items()):
            continue
        other = runs.get(tuple({**values, **asked.second}.values()))  # type: ignore[call-overload]
        if not other:
            continue
        own, base = (sorted(float(row[asked.value]) for row in side) for side in (first, other))
        low, middle, high = (
            math.nan if math.isinf(top) and math.isinf(bottom) else top / bottom / asked.factor if bottom else math.inf
            for top, bottom in ((own[0], base[-1]), (median(own), median(base)), (own[-1], base[0]))
        )
        if asked.is_alike:
            verdict = "yes" if low > 1 / SAME and high < SAME else "no" if low > SAME or high < 1 / SAME else "open"
        else:
            verdict = "yes" if low > 1 else "no" if high < 1 else "open"
        found.append((verdict, middle))
    return found


def outcome(runs: Runs, questions: Sequence[Asked]) -> tuple[str, str]:
    """Return what was measured and what it means for the claim; all of it is emulated."""
    found = [answer for asked in questions for answer in answers(runs, asked)]
    if not found:
        return "", "not recorded yet"
    counts, ratios = (
        Counter(verdict for verdict, _ in found),
        sorted(ratio for _, ratio in found if math.isfinite(ratio)),
    )
    span = f"; ratios {ratios[0]:.3g} to {ratios[-1]:.3g}" if ratios else ""
    measured = f"yes in {counts['yes']} of {len(found)}, no in {counts['no']}{span}"
    if counts["yes"] == len(found):
        return measured, "reproduced, emulated"
    if counts["yes"] and not counts["no"]:
        return measured, "same in direction, emulated"
    if counts["no"] and not counts["yes"]:
        return measured, "contradicted, emulated"
    return measured, "in part, emulated" if counts["yes"] else "undecided, emulated"


def across(same: str, other: str, *, same_is_slower: bool = False, **where: tuple[object, ...]) -> Asked:
    """Ask whether a message takes longer across domains than in one."""
    sides = ({"setup": same}, {"setup": other}) if same_is_slower else ({"setup": other}, {"setup": same})
    return Asked(*sides, where)


def faster_rates(*setups: str, alike: bool, slow: float = 1.0, fast: float = 4.0, **where: tuple[object, ...]) -> Asked:
    """Ask whether the higher rate takes longer, or as long."""
    return Asked({"rate_hz": fast}, {"rate_hz": slow}, {"setup": setups, "data": ("binary",), **where}, alike)


def jump(low: int, high: int, *setups: str, **where: tuple[object, ...]) -> Asked:
    """Ask whether the larger size takes more time than its bytes say."""
    return Asked({"payload_bytes": high}, {"payload_bytes": low}, {"setup": setups, **where}, factor=SAME * high / low)


LARGE, SMALL = (502_000, 1_000_000), (33_000, 145_000)
LICENCE = "Connext: refused without RTI's licence"
CLAIMS_OF_PAPER: tuple[tuple[str, str, Sequence[Asked]], ...] = (
    (
        "Cyclone DDS, two domains, air: more frequency, more latency of large files",
        "",
        [faster_rates(CYCLONE_ACROSS, alike=False, link=(AIR,), payload_bytes=LARGE)],
    ),
    (
        "air: a sudden rise at 502 KB",
        "",
        [jump(145_000, 502_000, FAST, FAST_ACROSS, CYCLONE, CYCLONE_ACROSS, link=(AIR,), rate_hz=(1.0,))],
    ),
    (
        "Fast DDS, two domains, air: 502 KB slower than 1 MB",
        "",
        [Asked({"payload_bytes": 502_000}, {"payload_bytes": 1_000_000}, {"setup": (FAST_ACROSS,), "link": (AIR,)})],
    ),
    (
        "Cyclone DDS, two domains, wired, Pi 3: the same over all sizes",
        "",
        [
            Asked(
                {"payload_bytes": size},
                {"payload_bytes": 33_000},
                {"setup": (CYCLONE_ACROSS,), "link": (WIRED,), "device": (PI,), "rate_hz": (1.0, 4.0)},
                is_alike=True,
            )
            for size in (145_000, *LARGE)
        ],
    ),
    (
        "two domains, air: a spike above 145 KB",
        "",
        [jump(145_000, size, FAST_ACROSS, CYCLONE_ACROSS, link=(AIR,), rate_hz=(1.0,)) for size in LARGE],
    ),
    (
        "Cyclone DDS, air, Pi 3: small files faster in one domain, large ones in two",
        "",
        [
            across(CYCLONE, CYCLONE_ACROSS, link=(AIR,), device=(PI,), data=("binary",), payload_bytes=SMALL),
            across(CYCLONE, CYCLONE_ACROSS, same_is_slower=True, link=(AIR,), device=(PI,), payload_bytes=LARGE),
        ],
    ),
    (
        "Cyclone DDS, wired, Pi 3: large files faster in one domain",
        "",
        [across(CYCLONE, CYCLONE_ACROSS, link=(WIRED,), device=(PI,), payload_bytes=LARGE)],
    ),
    (
        "Fast DDS: one domain faster for every size, frequency, device, link",
        "`builtin` in place of Integration Service",
        [across(FAST, FAST_ACROSS)],
    ),
    ("Connext, air: alike up to 87 KB, then two domains", LICENCE, []),
    ("Connext, wired: alike up to 145 KB, then one domain", LICENCE, []),
    (
        "String, IMU: alike in one domain and in two, but not Fast DDS",
        LICENCE,
        [
            Asked({"setup": CYCLONE_ACROSS}, {"setup": CYCLONE}, {"data": ("string", "imu")}, is_alike=True),
            across(FAST, FAST_ACROSS, data=("string", "imu")),
        ],
    ),
    (
        "frequency matters, but not for Fast DDS on a Pi 3 over the air",
        "",
        [faster_rates(FAST, alike=True, link=(AIR,), device=(PI,)), faster_rates(CYCLONE, CYCLONE_ACROSS, alike=False)],
    ),
    (
        "up to 145 KB no effect of frequency",
        "",
        [faster_rates(FAST, CYCLONE, alike=True, fast=rate, payload_bytes=SMALL) for rate in (4.0, 20.0)],
    ),
    ("live camera, Jetson: Connext best across domains", LICENCE, []),
    (
        "not Fast DDS across domains; Cyclone DDS for large files over the air",
        "",
        [Asked({"setup": FAST_ACROSS}, {"setup": CYCLONE_ACROSS}, {"link": (AIR,), "payload_bytes": LARGE})],
    ),
    (
        "no vendor is best everywhere; mostly one domain wins",
        "",
        [across(FAST, FAST_ACROSS), across(CYCLONE, CYCLONE_ACROSS)],
    ),
    (
        "across domains more of the large files may arrive",
        "messages received",
        [
            Asked({"setup": other}, {"setup": same}, {"payload_bytes": LARGE}, value="received")
            for same, other in ((FAST, FAST_ACROSS), (CYCLONE, CYCLONE_ACROSS))
        ],
    ),
    ("over the air across domains nothing is hard real time", "", []),
    (
        "about 120 participants fit a domain",
        "participant 120 takes the next domain's ports, in silence; `record` warns",
        [],
    ),
    (
        "future work: QoS, load, moving nodes, 5G, security, a recommender, 502 KB",
        "axes, links from a file, `dds-trace choose`, `explain`",
        [],
    ),
)
REAL_TIME = 18
REPRODUCED = {19: "reproduced", 20: "done"}


def late_words(runs: Runs) -> tuple[str, str]:
    """Return the largest share of any run beyond 1, 10 and 100 ms, over the air and across domains."""
    rows = [
        row for key, own in runs.items() if key[0] in (FAST_ACROSS, CYCLONE_ACROSS) and key[1] == AIR for row in own
    ]
    if not rows:
        return "", "not recorded yet"
    shares = [max(int(row[f"beyond_{ms}_ms"]) / int(row["published"]) for row in rows) for ms in LATE_MS]
    words = ", ".join(f"{share:.0%} beyond {ms} ms" for share, ms in zip(shares, LATE_MS, strict=True))
    return f"worst run: {words}", "reproduced, emulated" if shares[0] else "contradicted, emulated"


def claim_table(rows: Sequence[Mapping[str, str]]) -> str:
    """Return the twenty claims of the paper, with what the rows of `keep_claims` say of each."""
    runs = runs_of(rows)
    lines = []
    for number, (claim, remark, questions) in enumerate(CLAIMS_OF_PAPER, 1):
        measured, verdict = late_words(runs) if number == REAL_TIME else outcome(runs, questions)
        if not questions and number != REAL_TIME:
            verdict = REPRODUCED.get(number, "not possible here")
        lines.append([str(number), claim, "; ".join(filter(None, (measured, remark))), verdict])
    return markdown(["#", "the paper says", "measured", "outcome"], lines)
