"""Tables of the pages, from rows that a benchmark or a sweep left: `quoted.py` writes them."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from statistics import mean, stdev
from typing import TYPE_CHECKING

from dds_trace.analyzer.statistics.distributions import student_quantile
from dds_trace.analyzer.statistics.power import runs_to_decide
from dds_trace.base.units import format_rate, format_size
from dds_trace.recorder.choices import Security

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from dds_trace.analyzer.model.metrics import Column

TOP = Path(__file__).parents[1]
RATIOS = TOP / "benchmarks" / "node.csv"
SPEED = TOP / "benchmarks" / "speed.csv"
LEARNING = TOP / "docs" / "results" / "learning.csv"
EVIDENCE = TOP / "docs" / "results" / "evidence.csv"
SECURITY = TOP / "docs" / "results" / "security" / "runs.csv"
STUDY = TOP / "docs" / "results" / "study"


def read_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV file."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table."""
    return "".join(f"| {' | '.join(cells)} |\n" for cells in (head, ["---"] * len(head), *rows))


def column_table(columns: Iterable[Column]) -> str:
    """Return the columns of a file that an analysis writes."""
    rows = ([f"`{each.name}`", f"`{each.dtype}`", each.unit, each.meaning] for each in columns)
    return markdown(("column", "type", "unit", "meaning"), rows)


def cost_table() -> str:
    """Return the runs a side that a gate takes, by the distance of a change from its limit and the spread of runs."""
    spreads = (0.02, 0.05, 0.1, 0.2)
    rows = [
        [
            f"{distance - 1:.0%}".replace("%", " %"),
            *(str(runs_to_decide(math.log(distance), *(2 * [s]))) for s in spreads),
        ]
        for distance in (1.05, 1.1, 1.2, 1.5)
    ]
    return markdown(("from the limit", *(f"runs vary by {spread:.0%}".replace("%", " %") for spread in spreads)), rows)


def ratio_table(rows: Sequence[Mapping[str, str]], *, is_throughput: bool = False) -> str:
    """Return the round trips or the throughputs of `benchmarks/node.csv`: a row for each contest, the ratio of each load with its extremes, misses bold."""
    rows = [row for row in rows if (float(row["rate_hz"]) == 0) is is_throughput]
    loads = sorted({(int(row["size_bytes"]), float(row["rate_hz"])) for row in rows})
    ratios = {(row["ours"], row["against"], int(row["size_bytes"]), float(row["rate_hz"])): row for row in rows}
    contests = dict.fromkeys((row["ours"], row["against"], row["bar"]) for row in rows)

    def cell(row: Mapping[str, str] | None) -> str:
        if row is None:
            return ""
        ends = sorted(map(float, row["ratios"].split()))
        shown = f"{float(row['ratio']):.2f}"
        is_missed = row["bar"] and float(row["ratio"]) > float(row["bar"])
        span = f"<br>{ends[0]:.2f}-{ends[-1]:.2f}" if len(ends) > 1 else ""
        bound = f"<br>`client_bound` in {row['client_bound']}" if int(row.get("client_bound") or 0) else ""
        return (f"**{shown}**" if is_missed else shown) + span + bound

    return markdown(
        ["ours", "against", *(f"{format_size(size)}<br>{format_rate(rate)}" for size, rate in loads), "bar"],
        (
            [ours, against, *(cell(ratios.get((ours, against, *load))) for load in loads), bar]
            for ours, against, bar in contests
        ),
    )


def speed_table(rows: Sequence[Mapping[str, str]]) -> str:
    """Return the rows of `benchmarks/speed.csv`, what was asked in brackets, misses bold."""

    def cell(row: Mapping[str, str], figure: str, unit: str = "") -> str:
        asked = dict(bar.split("=") for bar in row["asked"].split()).get(figure)
        if not row[figure]:
            return ""
        shown = f"{row[figure]}{unit}"
        is_missed = asked is not None and float(row[figure]) > float(asked)
        return (f"**{shown}**" if is_missed else shown) + (f" ({asked})" if asked else "")

    return markdown(
        ["what a user types", "processor", "over the peer", "", "over 413bda57", "peak, MB"],
        (
            [
                row["row"],
                cell(row, "cpu_s", " s"),
                cell(row, "over_peer"),
                row["peer"],
                cell(row, "over_before"),
                cell(row, "peak_mb"),
            ]
            for row in rows
        ),
    )


def security_table(rows: Sequence[Mapping[str, str]]) -> str:
    """Return the medians of `docs/results/security/runs.csv` in ms: of a typical run, with the 95 % interval between the runs."""
    runs: dict[tuple[str, str], dict[int, list[float]]] = {}
    for row in rows:
        sizes = runs.setdefault((row["backend"], row["security"]), {})
        sizes.setdefault(int(row["payload_bytes"]), []).append(math.log(float(row["rtt_p50_ns"]) / 1e6))

    def cell(logarithms: Sequence[float]) -> str:
        half = student_quantile(0.975, len(logarithms) - 1) * stdev(logarithms) / math.sqrt(len(logarithms))
        typical, low, high = (math.exp(mean(logarithms) + shift) for shift in (0, -half, half))
        return f"{typical:.3g} ({low:.3g} to {high:.3g})"

    levels = [level.value for level in Security]
    return markdown(
        ["backend", "security", *map(format_size, next(iter(runs.values())))],
        (
            [f"`{backend}`", f"`{level}`", *(cell(sizes[size]) for size in sorted(sizes))]
            for (backend, level), sizes in sorted(runs.items(), key=lambda item: (item[0][0], levels.index(item[0][1])))
        ),
    )


def evidence_table(rows: Sequence[Mapping[str, str]], table: str) -> str:
    """Return what `benchmarks/bench_evidence.py` counted: of `harmless` recordings the share with exit code 30, of `losses` also right intervals."""

    def share(row: Mapping[str, str], name: str) -> str:
        return f"{int(row[name]) / int(row['recordings']):.1%}"

    rows = [row for row in rows if row["table"] == table]
    if table == "harmless":
        return markdown(["nothing is lost", "exit 30"], ([row["kind"], share(row, "exit_30")] for row in rows))
    head = ["losses", "shown by", "exit 30", "interval right"]
    return markdown(head, ([row["kind"], row["shown_by"], share(row, "exit_30"), share(row, "within")] for row in rows))


def learning_table(rows: Sequence[Mapping[str, str]]) -> str:
    """Return what `benchmarks/bench_learning.py` counted: a row for each campaign that has results inside, and one for all."""
    counts = ("results", "inside", "number", "within", "covered")
    by_name: dict[str, dict[str, list[int]]] = {}
    for row in rows:
        for name in (row["campaign"], "all"):
            sums = by_name.setdefault(name, {}).setdefault(row["statistic"], [0] * len(counts))
            sums[:] = [total + int(row[count]) for total, count in zip(sums, counts, strict=True)]

    def cells(name: str) -> Iterator[str]:
        yield name
        for number in range(len(counts)):
            yield " / ".join(str(sums[number]) for sums in by_name[name].values())

    def share(number: int, whole: int) -> str:
        return " / ".join(f"{100 * sums[number] / max(1, sums[whole]):.0f} %" for sums in by_name["all"].values())

    seen = sorted(
        name for name, of_name in by_name.items() if name != "all" and any(sums[1] for sums in of_name.values())
    )
    head = ["left out", "results", "inside", "with a number", "within 2 times", "in the 90 % range"]
    return markdown(
        head, [*map(list, map(cells, [*seen, "all"])), ["share", "", "", share(2, 1), share(3, 2), share(4, 2)]]
    )
