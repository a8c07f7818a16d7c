"""How often what is said is true, by simulation with a known truth: the tables of docs/results/coverage.md.

    python benchmarks/coverage.py --quick               200 samples a cell: a look, with errors of 2 to 3 points
    python benchmarks/coverage.py                       1000 samples a cell, hours
    python benchmarks/coverage.py leaders losers        some of the tables
    python benchmarks/coverage.py --write docs/results  write the tables as CSV, too

The exit code is 1 if a bar is missed by more than two standard errors of the simulation.
"""

from __future__ import annotations

import argparse
import sys
import time
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
from coverage_comparisons import looks_table, losses_table, results_table
from coverage_intervals import interval_tables

if TYPE_CHECKING:
    from collections.abc import Callable

    from simulated import Table

TABLES: dict[str, Callable[[int], Table]] = {
    "losses": losses_table,
    "comparisons": results_table,
    "looks": looks_table,
    "leaders": leaders_table,
    "leaders-found": found_leaders_table,
    "leaders-messages": message_leaders_table,
    "losers": losers_table,
    "deadlines": deadlines_table,
    "until": until_table,
}
INTERVALS = "intervals"


def main() -> int:
    """Simulate, print the tables and the bars that are missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", choices=[[], INTERVALS, *TABLES], help="which; all without any")
    parser.add_argument("--quick", action="store_true", help="200 samples a cell")
    parser.add_argument("--write", type=Path, metavar="FOLDER", help="write coverage-TABLE.csv")
    options = parser.parse_args()
    samples = 200 if options.quick else 1000
    missed: list[str] = []
    for name in options.tables or (INTERVALS, *TABLES):
        started = time.perf_counter()
        for table in interval_tables(samples) if name == INTERVALS else [TABLES[name](samples)]:
            print("\n".join(table.markdown()), end="\n\n", flush=True)
            missed += table.missed
            if options.write is not None:
                table.write(options.write)
        print(f"{time.perf_counter() - started:.0f} s  {name}", file=sys.stderr)
    print("\n".join(["missed bars:", *missed] if missed else ["every bar holds"]))
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
