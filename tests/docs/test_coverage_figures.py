"""The rates of docs/explanation/statistics.md are those of the files of docs/results."""

import csv
import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
FILES = {
    file.stem.removeprefix("coverage-"): list(csv.DictReader(file.read_text().splitlines()))
    for file in (DOCS / "results").glob("coverage-*.csv")
}


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
