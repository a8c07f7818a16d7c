"""Every table of docs/results/coverage.md is part of a CSV file next to it; so are the rates of docs/explanation/statistics.md."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
FILES = {
    file.stem.removeprefix("coverage-"): list(csv.DictReader(file.read_text().splitlines()))
    for file in (DOCS / "results").glob("coverage-*.csv")
}


def tables_of(page):
    for block in re.findall(r"(?:^\|.*\|\n)+", page.read_text(), re.MULTILINE):
        header, _, *rows = (
            [cell.strip() for cell in line.strip().strip("|").split("|")] for line in block.splitlines()
        )
        yield header, [dict(zip(header, row, strict=True)) for row in rows]


TABLES = list(tables_of(DOCS / "results/coverage.md"))


@pytest.mark.parametrize(("header", "rows"), TABLES, ids=[", ".join(header)[:50] for header, _ in TABLES])
def test_a_table_of_the_figures_is_part_of_its_file(header, rows):
    fitting = {name: file for name, file in FILES.items() if set(header) <= set(file[0])}
    missing = {
        name: [row for row in rows if not any(row.items() <= written.items() for written in file)]
        for name, file in fitting.items()
    }
    assert [] in missing.values(), missing


def numbers(table, *columns, **where):
    rows = [row for row in FILES[table] if where.items() <= row.items()]
    return [float(number) for row in rows for column in columns for number in row[column].split(" / ")]


KINDS = ("kinds: 1", "kinds: 6", "kinds: 20")


@pytest.mark.parametrize(
    ("said", "figures"),
    [
        (
            "`compare`: slower, faster",
            [
                *numbers(
                    "verdicts", "+20 % found", scenario="independent, runs +-5 %", **{"runs x messages": "5 x 1000"}
                )
            ],
        ),
        *(
            (said, [max(numbers("comparisons", column, **{"equal results": results})) for results in ("1", "50")])
            for said, column in (
                ("`compare`: slower, faster", "slower or faster"),
                ("a gate fails", "`latency_p99 > +20%` fails"),
            )
        ),
        ("more is lost", numbers("losses", "0.5 % against 5 %", runs="5 x 1000")[0:4:3]),
        ("is fastest", [max(numbers("leaders", *KINDS)), max(numbers("leaders-messages", *KINDS))]),
        ("is fastest", numbers("leaders-found", "called, kinds: 1")[:3]),
        ("loses more", [max(numbers("losers", *KINDS))]),
        ("`--until` is reached", [min(numbers("until", "of these hold")[:8])]),
    ],
)
def test_the_rates_of_the_statistics_are_those_of_the_files(said, figures):
    page = (DOCS / "explanation/statistics.md").read_text()
    line = page[page.rindex(f"\n| {said} |") :].splitlines()[1]
    written = {float(number) for number in re.findall(r"\d+(?:\.\d+)?", line)}
    assert all(figure in written or round(figure) in written for figure in figures), (figures, line)
