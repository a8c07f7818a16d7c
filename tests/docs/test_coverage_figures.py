"""The rates of docs/explanation/statistics.md and docs/results/coverage.md are those of the files of docs/results."""

import csv
import re
from functools import partial
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
PAGES = "\n\n".join((DOCS / page).read_text() for page in ("results/coverage.md", "explanation/statistics.md"))
FILES = {
    file.stem.removeprefix("coverage-"): list(csv.DictReader(file.read_text().splitlines()))
    for file in (DOCS / "results").glob("coverage-*.csv")
}


def numbers(table, *columns, **where):
    rows = [row for row in FILES[table] if all(re.fullmatch(value, row[name]) for name, value in where.items())]
    cells = [row[column].partition(" (")[0] for row in rows for column in columns]
    return [float(number) for cell in cells for number in cell.split(" / ") if number not in ("", "-")]


def ends(*where, **more):
    found = numbers(*where, **more)
    return [min(found), max(found)]


KINDS = ("kinds: 1", "kinds: 6", "kinds: 20")
RESULTS = [{"equal results": results} for results in ("1", "50")]
BY_PASSES, EACH_KIND = "each other, by a correlation", "a walk.*|.*to pass"
false_leaders = partial(ends, "leaders-dependent", "called the fastest", setups="2")
LEVELS = {"levels of runs": "levels.*"}
FIVE = {"runs x messages": "5 x 1000"}
FEWER, ALL, THREE = "**Fewer than three", "Independent or correlated", r"[3-9].*|\d\d.*"
NOT_SINGLE = {"losses, 3 x 1000": "shares.*|outages.*"}


@pytest.mark.parametrize(
    ("said", "figures"),
    [
        ("| `compare`: slower", numbers("verdicts", "+20 % found", scenario="independent, runs .-5 %", **FIVE)),
        ("| `compare`: slower", [max(numbers("comparisons", "slower or faster", **n)) for n in RESULTS]),
        ("| a gate fails |", [max(numbers("comparisons", "`latency_p99 > +20%` fails", **n)) for n in RESULTS]),
        ("| more is lost", numbers("losses", "0.5 % against 5 %", runs="5 x 1000")[0:4:3]),
        ("| is fastest", [max(numbers(table, *KINDS)) for table in ("leaders", "leaders-messages")]),
        ("| is fastest", numbers("leaders-found", "called, kinds: 1")[:3]),
        ("(of independent passes", numbers("leaders-found", "called, kinds: 1", repeats="3")),
        ("| loses more", [max(numbers("losers", *KINDS))]),
        ("| `--until` is", [min(numbers("until", "of these hold")[:8])]),
        *((FEWER, ends("intervals", "p99", bursts=n, scenario="b.*")) for n in (r"2(\.5)?", r"1(\..*)?", "0.*")),
        (ALL, ends("intervals", "p50", "p90", "p99", bursts="")),
        *((ALL, ends("intervals", column, bursts=THREE, scenario="b.*")) for column in ("p50", "p90", "p99")),
        *((ALL, ends("intervals", column, bursts=THREE, scenario="o.*")) for column in ("p50", "p90", "p99")),
        ("Received ratio:", ends("intervals", "received ratio", bursts=THREE)),
        ("**Outages of 100", numbers("losses", "0.5 % against 5 %")[-2:-1]),
        ("**Passes that depend", numbers("leaders-found", "called, kinds: 1")[1:2]),
        ("`compare` of 1, 6", [max(numbers("comparisons-kinds", "measured in turns", "independent"))]),
        ("`--fail-if default`", [max(numbers("default", "equal: fail")), *ends("default", "equal: undecided")]),
        ("`--fail-if default`", numbers("default", "+50 % of one: fail", lost="0 %")),
        ("Campaigns of equal", [max(numbers("leaders", kinds, setups="2")) for kinds in KINDS]),
        ("Campaigns of equal", [max(numbers("leaders-kinds", "kinds: 1", "kinds: 6", "kinds: 12"))]),
        (BY_PASSES, false_leaders(passes=EACH_KIND, repeats="5", kinds="6|12")),
        (BY_PASSES, false_leaders(passes=EACH_KIND, repeats="3", kinds="6|12")),
        (BY_PASSES, [*false_leaders(passes=EACH_KIND, kinds="1"), *false_leaders(passes=".*together")]),
        ("- `coverage-losers.csv`", [max(numbers("losers", *KINDS))]),
        ("- `coverage-advice.csv`", ends("advice", "3 %, of two setups", "3 %, of twelve", **NOT_SINGLE)),
        ("are said to meet 99 %", ends("deadlines-kinds", "runs: 3", "runs: 5", "runs: 10", "runs: 20", **LEVELS)),
        ("are said to meet 99 %", numbers("deadlines-kinds", "runs: 3", "runs: 20")[-2:]),
        (
            "| meets the deadline",
            [max(numbers("deadlines-kinds", "runs: 3", "runs: 5", "runs: 10", "runs: 20", **LEVELS))],
        ),
        ("`coverage-until.csv`", numbers("until", "stop", **{"runs vary by": "10 %|14 %"})),
    ],
)
def test_the_rates_of_the_pages_are_those_of_the_files(said, figures):
    paragraph = re.split(r"\n\n|\n- |\n\| ", PAGES[PAGES.rindex(said) :], maxsplit=1)[0]
    written = {float(number) for number in re.findall(r"\d+(?:\.\d+)?", paragraph)}
    assert all(figure in written or round(figure) in written for figure in figures), (figures, paragraph)
