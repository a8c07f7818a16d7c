"""How far what `choose` learned is off: each campaign of docs/results/ in turn is asked for by what the others measured.

Usage: bench_learning.py [--csv FILE] (two minutes). `just readme` writes its table in docs/results/learning.md. Ends with 1 where a bar is missed.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
import tarfile
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

from dds_trace.analyzer.pipeline import analyze
from dds_trace.extensions.campaigns.learning.model import FACTOR, OUTSIDE, UNMEASURED, Learned, question_of
from dds_trace.extensions.campaigns.learning.results import Campaign, campaign_of

RESULTS = Path(__file__).parents[1] / "docs" / "results"
STATISTICS = ("response 0.5", "response 0.9", "response 0.99")
BARS = {"number": (0.7, 1.0), "within": (0.9, 1.0), "covered": (0.85, 0.97)}
"""Least and most of the share of those inside, of those with a number, and of the intervals; of the median and p90."""


def campaign_name(archive: Path) -> str:
    """Return the campaign of an archive: its folder, of which `study` has two."""
    folder = archive.parent.relative_to(RESULTS).as_posix()
    return f"study/{archive.name.partition('.')[0].partition('-')[0]}" if folder == "study" else folder


def kept_campaigns(*names: str) -> dict[str, Campaign]:
    """Return what docs/results/ keeps of these campaigns, or of all that sent messages of their own."""
    with tempfile.TemporaryDirectory() as scratch:
        for archive in sorted(RESULTS.rglob("*.tar.xz")):
            name = campaign_name(archive)
            with tarfile.open(archive) as file:
                if (not names or name in names) and any("ping.mcap" in member for member in file.getnames()):
                    file.extractall(Path(scratch, name.replace("/", "-")), filter="data")
        return {
            path.name: campaign_of(analyze(path, details=False).load_messages())
            for path in sorted(Path(scratch).iterdir())
        }


def left_out(campaigns: Mapping[str, Campaign], statistic: str) -> Iterator[dict[str, object]]:
    """Yield a row for each campaign: its results, those inside what the others measured, and what was said of these."""
    for name, campaign in campaigns.items():
        learned = Learned([other for other in campaigns.values() if other is not campaign], statistic)
        row = dict.fromkeys(("results", "inside", "number", "within", "covered"), 0)
        for result in campaign.results:
            time_ns = result.times_ns.get(statistic)
            if time_ns is None:
                continue
            answer = learned.guess(question_of(result.parameters))
            is_number = not isinstance(answer, str)
            row["results"] += 1
            row["inside"] += is_number or not answer.startswith((OUTSIDE, UNMEASURED))
            if is_number:
                value, lower, upper = answer
                row["number"] += 1
                row["within"] += abs(math.log(value) - math.log(time_ns)) <= math.log(FACTOR)
                row["covered"] += lower <= time_ns <= upper
        yield {"campaign": name, "statistic": statistic, **row}


def shares(rows: list[dict[str, object]]) -> dict[str, float]:
    """Return the shares that have a bar."""
    inside, number, within, covered = (sum(int(row[key]) for row in rows) for key in ("inside", *BARS))
    return {"number": number / max(1, inside), "within": within / max(1, number), "covered": covered / max(1, number)}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--csv", type=Path)
    arguments = parser.parse_args()
    campaigns, rows, is_missed = kept_campaigns(), list[dict[str, object]](), False
    for statistic in STATISTICS:
        rows += (of_statistic := list(left_out(campaigns, statistic)))
        for name, share in shares(of_statistic).items():
            low, high = BARS[name]
            is_fine = low <= share <= high
            is_missed |= not is_fine and statistic != STATISTICS[-1]
            print(
                f"{statistic}: {name} {share:.1%} ({low:.0%} to {high:.0%}){'' if is_fine else ': missed'}", flush=True
            )
    if arguments.csv:
        with arguments.csv.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
    return int(is_missed)


if __name__ == "__main__":
    sys.exit(main())
