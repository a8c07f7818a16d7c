"""Comparisons as Markdown and JUnit: what they say, and that strings of a trace stay strings."""

from __future__ import annotations

from xml.etree import ElementTree as ET

from roundtrip_frames import MS, in_runs, steady

from dds_trace.analyzer.verdicts.compare import CompareOptions, compare_roundtrips
from dds_trace.analyzer.verdicts.gate import parse_gate
from dds_trace.analyzer.verdicts.gates import judge_gates
from dds_trace.reports.comparison import comparison_junit, comparison_markdown, comparison_sentence

HOSTILE = "<script>alert(1)</script>|`a`](http://x)\n# h @you\x1b[31m\x00"
OPTIONS = CompareOptions(metrics=("latency",), statistics=("p50",))
GATES = [
    parse_gate(t)
    for t in ("latency_p50 > +10%", "latency_p50 > +2ms", "latency_p99 > 1ms", "received_ratio < 1%")
]


def compared(**parameters):
    options = CompareOptions(metrics=("latency",), statistics=("p50", "p99"))
    found = compare_roundtrips(
        in_runs([5 * MS] * 40, spread=1e-9, **parameters),
        in_runs([6 * MS] * 40, spread=1e-9, **parameters),
        options,
    )
    return found, judge_gates(found, GATES)


def test_markdown_says_the_outcome_first():
    text = comparison_markdown(*compared())
    assert text.index("**Regressed**") < text.index("| gate |") < text.index("| group |")
    row = next(line for line in text.splitlines() if "latency p50" in line)
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    assert cells[2:] == [
        "5.000 ms",
        "6.000 ms",
        "100.00% -> 100.00%",
        "+20.0%",
        "+20.0% to +20.0%",
        "0%",
        "3 and 3",
        "+0.0%",
        "worse",
    ]
    unknown = next(line for line in text.splitlines() if "latency p99" in line)
    assert unknown.endswith(
        "| +20.0% | unknown to unknown | 0% | 3 and 3, within one run |  | inconclusive |"
    )


def compared_at(new_ms, runs=in_runs, **parameters):
    options = CompareOptions(metrics=("latency",), statistics=("p50",))
    spread = {"spread": 1e-3} if runs is in_runs else {}
    return compare_roundtrips(
        runs([5 * MS] * 40, **spread, **parameters), runs([new_ms * MS] * 40, **spread, **parameters), options
    )


def test_the_first_line_says_what_became_slower():
    assert (
        comparison_sentence(compared_at(6)) == "Slower in 1 of 1 group, most the p50 of the latency: +20.0%."
    )


def test_the_first_line_says_which_changes_would_not_be_seen():
    found = compared_at(5)
    smallest = found.rows["smallest_ratio"][0] - 1
    assert comparison_sentence(found) == (
        f"Nothing is shown to be slower in 1 group; changes below {smallest:.1%} would not be seen."
    )


def test_the_first_line_of_too_few_runs_does_not_reassure():
    assert comparison_sentence(compared_at(5, runs=steady)) == (
        "What changed in 1 group cannot be told: it takes 3 runs a side."
    )


def test_losses_lead_the_first_line():
    lossy = [5 * MS if i % 2 else None for i in range(200)]
    found = compare_roundtrips(in_runs([5 * MS] * 200), in_runs(lossy), OPTIONS)
    assert comparison_sentence(found).startswith("More is lost in 1 of 1 group (100.00% -> 50.00%)")


def test_sides_without_a_common_group_are_told_apart_by_their_columns():
    nothing = compare_roundtrips(steady([MS]), steady([MS], vendor="zenoh", payload_bytes=1000), OPTIONS)
    assert comparison_sentence(nothing) == (
        "The two sides have no group in common: there is nothing to compare; they differ in vendor (fastdds against zenoh), "
        "payload_bytes (33000 against 1000)."
    )


def test_markdown_of_nothing():
    nothing = compare_roundtrips(steady([MS]), steady([MS], vendor="zenoh"), OPTIONS)
    text = comparison_markdown(nothing)
    assert "nothing to compare" in text
    assert "Only in the base" in text
    assert "Only in the new" in text


def test_junit_counts_and_names():
    _, results = compared()
    root = ET.fromstring(comparison_junit(results))
    assert root.tag == "testsuites"
    assert {k: root.get(k) for k in ("tests", "failures", "errors", "skipped")} == {
        "tests": "4",
        "failures": "1",
        "errors": "0",
        "skipped": "1",
    }
    cases = root.findall("testsuite/testcase")
    assert [c.get("name") for c in cases] == [g.text for g in GATES]
    assert cases[0].find("failure").get("message") == (
        "+20.0%, interval +20.0% to +20.0%; changes from +0.0% on are found at 80% power"
    )
    assert [len(c) for c in cases] == [1, 0, 1, 0]
    assert "inconclusive" in cases[2].find("skipped").get("message")
    assert ET.fromstring(comparison_junit([])).get("tests") == "0"


def test_hostile_strings_stay_strings():
    found, results = compared(bridge=HOSTILE)
    text = comparison_markdown(found, results)
    assert "<script" not in text
    assert "](http" not in text
    assert "\x1b" not in text
    assert "@you" not in text
    assert len([line for line in text.splitlines() if line.startswith("#")]) == 1
    widths = {
        line.count("|") for line in text.splitlines() if "latency p" in line or line.startswith("| group")
    }
    assert widths == {12}
    root = ET.fromstring(comparison_junit(results))
    assert "<script>alert(1)</script>" in root.find("testsuite/testcase").get("classname")
