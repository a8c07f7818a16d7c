"""How often what is said is true, by simulation with a known truth: the tables of docs/results/coverage.md.

    python benchmarks/coverage.py --quick               200 samples a cell: a look, with errors of 2 to 3 points
    python benchmarks/coverage.py                       1000 samples a cell, 80 minutes of CPU time
    python benchmarks/coverage.py leaders losers        some of the tables
    python benchmarks/coverage.py --write docs/results  write them, too: coverage-TABLE.csv, and the tables of coverage.md

The exit code is 1 if a bar is missed by more than two standard errors of the simulation.
"""

from __future__ import annotations

import argparse
import csv
import os
import re
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING

from coverage_campaigns import (
    deadlines_table,
    found_leaders_table,
    leaders_table,
    losers_table,
    message_leaders_table,
    until_table,
)
from coverage_comparisons import default_table, looks_table, losses_table, named_table, results_table
from coverage_intervals import interval_tables
from coverage_kinds import (
    advice_table,
    best_table,
    bursts_table,
    changes_table,
    dependent_table,
    kinds_table,
    late_table,
)
from simulated import Table

if TYPE_CHECKING:
    from collections.abc import Callable

TABLES: dict[str, Callable[[int], Table]] = {
    "losses": losses_table,
    "comparisons": results_table,
    "named": named_table,
    "default": default_table,
    "looks": looks_table,
    "leaders": leaders_table,
    "leaders-found": found_leaders_table,
    "leaders-messages": message_leaders_table,
    "losers": losers_table,
    "deadlines": deadlines_table,
    "until": until_table,
    "leaders-kinds": kinds_table,
    "leaders-dependent": dependent_table,
    "leaders-best": best_table,
    "comparisons-kinds": changes_table,
    "advice": advice_table,
    "deadlines-kinds": late_table,
    "deadlines-bursts": bursts_table,
}
INTERVALS = "intervals"


MARK = re.compile(r"<!-- coverage-(?P<table>[\w-]+)(?:, (?P<where>.*))? -->\n\n(?:\|.*\n)*")
"""`<!-- coverage-TABLE, COLUMN=VALUE, ... -->`, and the table after it: the rows of the file with these values."""


def _table(mark: re.Match[str], folder: Path) -> str:
    rows = list(csv.DictReader((folder / f"coverage-{mark['table']}.csv").read_text().splitlines()))
    where = dict(part.split("=") for part in (mark["where"] or "").split(", ") if part)
    shown = Table(mark["table"], tuple(name for name in rows[0] if name not in where))
    shown.rows += [tuple(row[name] for name in shown.columns) for row in rows if where.items() <= row.items()]
    comment = mark[0].split("\n", 1)[0]
    return "\n".join([comment, "", *shown.markdown(), ""])


def made(name: str, samples: int) -> tuple[list[Table], float]:
    """Return tables, and the CPU time that they took, s."""
    started = time.process_time()
    tables = list(interval_tables(samples)) if name == INTERVALS else [TABLES[name](samples)]
    return tables, time.process_time() - started


def main() -> int:
    """Simulate, print the tables and the bars that are missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", choices=[[], INTERVALS, *TABLES], help="which; all without any")
    parser.add_argument("--quick", action="store_true", help="200 samples a cell")
    parser.add_argument("--samples", type=int, metavar="COUNT", help="as many samples a cell")
    parser.add_argument("--write", type=Path, metavar="FOLDER", help="write coverage-TABLE.csv and coverage.md")
    options = parser.parse_args()
    samples = options.samples or (200 if options.quick else 1000)
    missed: list[str] = []
    names = options.tables or (INTERVALS, *TABLES)
    os.environ["POLARS_MAX_THREADS"] = "1"
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        for name, (tables, seconds) in zip(names, pool.map(partial(made, samples=samples), names), strict=True):
            for table in tables:
                print("\n".join(table.markdown()), end="\n\n", flush=True)
                missed += table.missed
                if options.write is not None:
                    table.write(options.write)
            print(f"{seconds:.0f} s of CPU time  {name}", file=sys.stderr)
    if options.write is not None:
        for page in (options.write / "coverage.md", options.write.parent / "explanation" / "statistics.md"):
            page.write_text(MARK.sub(partial(_table, folder=options.write), page.read_text()))
    print("\n".join(["missed bars:", *missed] if missed else ["every bar holds"]))
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
