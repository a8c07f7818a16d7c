import html
import json
import math
import re
from dataclasses import replace
from functools import cache
from xml.etree import ElementTree as ET

import polars as pl
import pytest
from jsonschema import Draft202012Validator
from report_schemas import COMPARISON, closed
from roundtrip_frames import MS, in_runs, steady
from visible_text import Page
from wording import comparison_as, numbers

from dds_trace.extensions.gates import document, words
from dds_trace.extensions.gates.compare import CompareOptions, compare_roundtrips
from dds_trace.extensions.gates.comparison_rows import DISTRIBUTION_LEVELS
from dds_trace.extensions.gates.gate import GateOutcome, parse_gate
from dds_trace.extensions.gates.gates import judge_gates, result_of
from dds_trace.extensions.gates.ignoring import match_without
from dds_trace.extensions.gates.info import comparison_info, mean_change
from dds_trace.extensions.gates.report import SIGNATURE

HOSTILE = "<script>alert(1)</script>|`a`](http://x)\n# h @you\x1b[31m\x00"
GATES = [
    parse_gate(t) for t in ("latency_p50 > +10%", "latency_p50 > +2ms", "latency_p99 > 1ms", "received_ratio < 1%")
]


@pytest.mark.parametrize(
    ("gate", "low", "high", "said"),
    [
        ("latency_p50 > +10%", 0.95, 1.03, "-5 to +3 %"),
        ("latency_p50 > +10%", 0.5, 12, "0.5 to 12 times"),
        ("latency_p50 > +10%", 0, math.inf, "-100 % to lost"),
        ("latency_p50 > 1ms", 0.98 * MS, 1.02 * MS, "0.98 to 1.02 ms"),
    ],
)
def test_ends_share_a_unit_and_a_word_is_none(gate, low, high, said):
    assert words.gate_interval_words(result_of(parse_gate(gate), "", GateOutcome.PASSED, low, low, high)) == said


def compared(**parameters):
    options = CompareOptions(metrics=("latency",), statistics=("p50", "p99"))
    found = compare_roundtrips(
        in_runs([5 * MS] * 40, spread=1e-9, **parameters), in_runs([6 * MS] * 40, spread=1e-9, **parameters), options
    )
    return found, comparison_info(found, judge_gates(found, GATES))


@cache
def many():
    """Thirty groups, the last one twice as slow, one with losses, one on the base alone, bridged and not."""

    def side(last):
        return pl.concat(
            in_runs(
                [MS if n or place != 3 else None for n in range(20)] if place != 29 else [last] * 20,
                spread=0.02,
                payload_bytes=1000 * (place + 1),
                bridge="zenoh-bridge-ros2dds" if place % 2 else "none",
                domain_mode="different" if place % 2 else "same",
            )
            for place in range(30)
        )

    base = pl.concat([side(MS), in_runs([MS] * 20, payload_bytes=7)])
    found = compare_roundtrips(base, side(2 * MS), CompareOptions(metrics=("latency",), statistics=("p50", "p90")))
    return found, comparison_info(found, judge_gates(found, GATES[:1]))


def test_the_terminal_has_a_row_for_each_group_in_80_columns_worst_first(sentences):
    _, info = many()
    short, whole = comparison_as("terminal", info), comparison_as("terminal", info, shows_all=True)
    topic = replace(GATES[0], text="one_way_p99(/camera/front/left/image_raw/compressed) > +20%")
    gates = tuple(replace(gated, result=replace(gated.result, gate=topic)) for gated in info.gates)
    long = comparison_as("terminal", replace(info, gates=gates))
    assert re.search(r"Smallest\n.*change", long)
    for text in (short, whole, long):
        assert max(map(len, text.splitlines())) <= 80
    for text in (short, whole):
        assert " ".join(text.split()).startswith(info.said)
        assert text.index("✗  latency_p50 > +10%") < text.index("1 ms → 2 ms") < text.rindex("Binary 1 KB at")
        assert "+100 %" in text
        assert text.index("Geometric mean") > text.rindex("Binary 1 KB at")
        assert "in the base:\n  Binary 7 B" in text
    assert numbers(info.said)[:2] == [1, 30]
    sentences(info.said)
    assert whole.count("the same\n") == 29
    assert short.count("the same\n") == 9
    assert "20 results more (20 the same)" in short
    assert [short.count(f"\n{mark} ") for mark in "✓✗"] == [1, 2]
    assert [whole.count(f"\n{mark} ") for mark in "✓✗"] == [29, 2]


def test_markdown_says_the_answer_first_then_gates_then_groups(sentences):
    text = comparison_as("md", compared()[1], shows_all=True)
    signature, title, answer, gates, *_ = text.split("\n\n")
    assert (signature, title) == (SIGNATURE, "# Comparison of latency")
    assert answer.startswith("**❌ Regressed: Slower (median of")
    assert [line[:3] for line in gates.splitlines()[2:]] == ["| &", "| ?", "| &", "| &"]
    assert html.unescape(answer).count("Undecided: latency_p99 > 1ms (") == text.count("Undecided") == 1
    assert text.index("| Gate |") < text.index("| Latency median |") < text.index("Every statistic")
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in text.splitlines()
        if line.startswith("| Binary")
    ]
    label, median, p99, *others = (html.unescape(cell) for cell in rows[0])
    assert (label, others) == ("Binary 33 KB at 10 Hz", ["100 %", "slower"])
    assert (numbers(median), numbers(p99)) == ([5, 6, 20], [5, 6, 20])
    sentences(median, p99)
    assert rows[1][1:] == ["Latency median", "5 ms", "6 ms", "+20 %", "+20 %", "0 %", "3 and 3", "0 %", "slower"]
    assert rows[2][1:6] == ["Latency p99", "5 ms", "6 ms", "+20 %", "-"]
    assert rows[2][7:] == ["3 and 3, too short", "", "no clear change"]


@pytest.mark.parametrize("times", [1, 300])
def test_a_comment_has_one_table_of_ten_rows_and_60_000_characters_at_most(times):
    label = HOSTILE * 20
    for _, info in (many(), compared(bridge=label, vendor=label)):
        wide = replace(info, gates=info.gates * times, notes=(label[:4000],) * times, only_base=(label,) * times)
        text = comparison_as("md", wide)
        assert sum(line.startswith("| ") and "---" not in line for line in text.splitlines()) <= 1 + 10
        assert len(text) < 60_000
        assert ("--all" in text) == (times > 1 or len(info.groups) > 1 or len(info.gates) > 0)


def test_what_changed_is_worth_a_comment():
    equal = comparison_info(compare_roundtrips(in_runs([MS] * 40), in_runs([MS] * 40)))
    assert [info.is_changed for info in (many()[1], compared()[1], equal)] == [True, True, False]


def test_the_change_of_a_row_is_that_of_the_two_times_next_to_it():
    base = pl.concat([in_runs([MS] * 400, runs=4, spread=0.5), steady([None] * 400, run_id=9)])  # one run lost all
    _, info = _with_info(compare_roundtrips(base, in_runs([MS] * 400, runs=5, spread=0.5)))
    for row in info.groups[0].shown()[:1]:
        assert row["new_typical_ns"] / row["base_typical_ns"] == pytest.approx(row["ratio"])
        assert row["new_ns"] / row["base_ns"] != pytest.approx(row["ratio"], rel=0.05)


def test_markdown_of_nothing():
    nothing = compare_roundtrips(steady([MS]), steady([MS], vendor="zenoh"))
    text = comparison_as("md", comparison_info(nothing))
    assert "nothing to compare" in text
    assert "--ignore vendor compares them" in text
    assert "Only in the base" in text
    assert "Only in the new" in text


def test_annotations_are_commands_of_one_line_and_the_badge_is_an_endpoint():
    _, info = compared(bridge=HOSTILE)
    *lines, notice = document.render_annotations(info).splitlines()
    assert [line.partition(" ")[0] for line in lines] == ["::error", "::warning"]
    assert lines[0].startswith("::error title=latency_p50 > +10%25::")
    assert "+20 %25" in lines[0]
    assert notice == f"::notice title=latency::{info.said.replace('%', '%25')}"
    badge = json.loads(document.render_badge(info))
    assert badge == {"schemaVersion": 1, "label": "latency", "message": "regressed", "color": "red"}
    many_lines = document.render_annotations(replace(info, gates=info.gates * 30)).splitlines()
    assert len(many_lines) == document.MOST_ANNOTATIONS
    assert json.loads(document.render_badge(replace(info, outcome=None)))["color"] == "lightgrey"


def test_junit_counts_and_names(sentences):
    _, info = compared()
    root = ET.fromstring(document.render_junit(info))
    assert root.tag == "testsuites"
    assert [root.get(key) for key in ("tests", "failures", "errors", "skipped")] == ["4", "1", "0", "1"]
    cases = {case.get("name"): case for case in root.findall("testsuite/testcase")}
    assert set(cases) == {gate.text for gate in GATES}
    classes = {case.get("classname").partition(" payload_bytes")[0] for case in cases.values()}
    assert classes == {"vendor=fastdds bridge=none data_type=binary"}
    message = cases[GATES[0].text].find("failure").get("message")
    assert numbers(message) == [20, 20, 8, 10, 10]
    assert message.endswith(words.gate_rows(info.gates)[0][1][3])  # the same smallest change as in the table
    sentences(message)
    assert [len(cases[gate.text]) for gate in GATES] == [1, 0, 1, 0]
    assert "undecided" in cases[GATES[2].text].find("skipped").get("message")
    assert root.find("testsuite/system-out").text.startswith("Slower (median of")
    assert "Undecided: latency_p99" in root.find("testsuite/system-out").text
    assert ET.fromstring(document.render_junit(comparison_info(compared()[0]))).get("tests") == "0"


@pytest.mark.parametrize("case", ["many", "lost", "ignored", "nothing"])
def test_json_follows_its_schema_to_the_last_field(case):
    lossy = [5 * MS if n % 5 else None for n in range(200)]
    found, info = {
        "many": many,
        "lost": lambda: _with_info(compare_roundtrips(in_runs([5 * MS] * 200), in_runs(lossy))),
        "ignored": lambda: _with_info(
            compare_roundtrips(
                steady([MS]), steady([MS]), CompareOptions(match=match_without(["bridge", "domain_mode", "vendor"]))
            )
        ),
        "nothing": lambda: _with_info(compare_roundtrips(steady([MS]), steady([MS], vendor="zenoh"))),
    }[case]()
    Draft202012Validator.check_schema(COMPARISON)
    told = json.loads(comparison_as("json", info, found))
    Draft202012Validator(closed(COMPARISON)).validate(told)
    assert [group["label"] for group in told["groups"]] == [group.label for group in info.groups]
    if case == "lost":
        (group,) = told["groups"]
        lost = {row["statistic"] for row in group["changes"] if row["new_is_lost"] and row["new_ns"] is None}
        assert lost == {"mean", "p90", "p95", "p99"}
        base, new = (group["distributions"][0][side] for side in ("base", "new"))
        assert [one["level"] for one in base] == [level for level in DISTRIBUTION_LEVELS if level <= 1 - 1 / 600]
        assert max(one["level"] for one in new) == 0.8
    if case == "ignored":
        assert not {"bridge", "domain_mode", "vendor"} & set(told["groups"][0]["parameters"])
        assert told["groups"][0]["label"] == "Binary 33 KB at 10 Hz"
    if case == "nothing":
        assert told["ignore"] == ["vendor"]
        del told["said"]
        assert not Draft202012Validator(COMPARISON).is_valid(told)


def _with_info(found):
    return found, comparison_info(found)


def test_the_page_draws_both_sides_of_every_group_and_loads_nothing():
    _, info = many()
    text = comparison_as("html", info)
    read = Page(text)
    assert read.values("href") | read.values("src") == {"data:,", "#answer"}
    assert "default-src 'none'; script-src 'sha256-" in html.unescape(text)
    assert read.tags.count("script") == 1
    assert read.tags.count("svg") == 30 * 2  # a strip and a curve for each group
    drawn = [text.count(f'class="{name}"') for name in ("base range", "new range", "drawn")]
    assert drawn == [30, 30, 31]  # and a heading
    assert read.text.index(info.answer[0][:20]) < read.text.index("Gates") < read.text.index("Results, worst first")
    assert "Binary 7\N{NO-BREAK SPACE}B at 10\N{NO-BREAK SPACE}Hz" in read.text
    assert comparison_as("html", info) == text


@pytest.mark.browser
def test_a_long_page_shows_50_results_then_more_and_paper_gets_all(show, new_tab):
    _, info = many()
    longer = replace(info, groups=info.groups * 4)
    complaints = []
    new_tab.on("pageerror", lambda error: complaints.append(str(error)))
    new_tab.goto(show(comparison_as("html", longer)))
    shown = "[...document.querySelectorAll('.groups > tbody > tr')].filter(row => !row.hidden).length / 2"
    button = new_tab.locator("#more")
    assert (new_tab.evaluate(shown), button.inner_text()) == (50, "Show 50 more of 70")
    button.click()
    assert (new_tab.evaluate(shown), button.inner_text()) == (100, "Show 20 more of 20")
    new_tab.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert new_tab.evaluate(shown) == 120
    new_tab.evaluate("dispatchEvent(new Event('afterprint'))")
    button.click()
    assert (new_tab.evaluate(shown), button.is_visible(), complaints) == (120, False, [])


def test_hostile_strings_stay_strings():
    _, info = compared(bridge=HOSTILE, vendor=HOSTILE)
    text = comparison_as("md", info, shows_all=True)
    assert [syntax for syntax in ("<script", "](http", "\x1b", "@you") if syntax in text] == []
    assert len([line for line in text.splitlines() if line.startswith("#")]) == 1
    for start, bars in (("| Result | Latency median", 6), ("| Result | Time", 11), ("|  | Gate", 6)):
        table = text[text.index(start) :].partition("\n\n")[0]
        assert {line.count("|") for line in table.splitlines()} == {bars}
    assert "\x1b" not in comparison_as("terminal", info)
    assert Page(comparison_as("html", info, title=HOSTILE)).tags.count("script") == 1
    root = ET.fromstring(document.render_junit(info))
    assert "<script>" in root.find("testsuite/testcase").get("classname")


OPTIONS = CompareOptions(metrics=("latency",), statistics=("p50",))
BRIDGED = {"bridge": "builtin", "domain_mode": "different"}


def compared_at(new_ms, runs=in_runs, **parameters):
    spread = {"spread": 1e-3} if runs is in_runs else {}
    return compare_roundtrips(
        runs([5 * MS] * 40, **spread, **parameters), runs([new_ms * MS] * 40, **spread, **parameters), OPTIONS
    )


def several(new_ms):
    """Groups of growing size: 5 ms on the base, and a time of the new side for each; None is lost half of the time."""
    sides = [
        pl.concat(
            in_runs(times(ms), spread=1e-2, payload_bytes=1000 * (place + 1), **BRIDGED)
            for place, ms in enumerate(each)
        )
        for each in ([5] * len(new_ms), new_ms)
    ]
    return compare_roundtrips(*sides, CompareOptions(metrics=("latency",), statistics=("p50", "p90")))


def times(ms):
    return [5 * MS if n % 2 else None for n in range(100)] if ms is None else [round(ms * MS)] * 100


@cache
def mixed():
    return comparison_info(several([5, 6, None, 4, 7]))


def test_the_answer_says_what_is_lost_and_what_became_slower_and_most_where(sentences):
    sentences(mixed().said)
    assert numbers(mixed().said) == [1, 5, 2, 1, 100, 50, 3, 10, 40, 5, 10, -20, 4, 10]


@pytest.mark.parametrize(("before", "after", "said"), [(None, 5, [50, 100]), (5, 4, [-20]), (5, 5, [])])
def test_what_became_better_is_the_answer(before, after, said, sentences):
    sides = [in_runs(times(ms), spread=1e-2) for ms in (before, after)]
    found = compare_roundtrips(*sides, CompareOptions(metrics=("latency",), statistics=("p50",)))
    answers = [
        comparison_info(found).said,
        comparison_info(found, judge_gates(found, [parse_gate("latency_p50 > 1us")])).said,
    ]
    sentences(*answers)
    assert [numbers(answer) for answer in answers] == [said, [*said, 1, 1, 1, after]]
    assert ["No regression" in answer for answer in answers] == [bool(said), False]  # a gate failed


def test_groups_come_worst_first_by_the_names_of_the_report():
    assert [(group.label, group.verdict) for group in mixed().groups] == [
        ("Binary 3 KB at 10 Hz", "loses more"),
        ("Binary 5 KB at 10 Hz", "slower"),
        ("Binary 2 KB at 10 Hz", "slower"),
        ("Binary 1 KB at 10 Hz", "the same"),
        ("Binary 4 KB at 10 Hz", "faster"),
    ]
    alone = comparison_info(compared_at(5, **BRIDGED))
    assert alone.groups[0].label == "Binary 33 KB at 10 Hz"
    both = pl.concat([in_runs([MS] * 9), in_runs([MS] * 9, **BRIDGED)])
    labels = [group.label for group in comparison_info(compare_roundtrips(both, both, OPTIONS)).groups]
    message = alone.groups[0].label
    assert sorted(labels) == [f"{message}, same domain", f"{message}, through our built-in bridge"]


def test_the_second_sentence_says_which_changes_would_not_be_seen(sentences):
    info, slower = comparison_info(compared_at(5)), comparison_info(compared_at(6))
    # The runs agree to 0.1 %, yet a change within 5 % is called the same.
    assert numbers(info.seen) == [80, 100, 4.84]
    assert numbers(slower.said) == [20]
    sentences(info.said, info.seen, slower.said)
    assert [group.verdict for group in slower.groups] == ["slower"]
    assert "median" not in slower.seen  # what is slower everywhere needs no smallest change
    assert mean_change(slower.groups, "p50") == pytest.approx(1.2, abs=0.01)


def test_too_few_runs_do_not_reassure(sentences):
    info = comparison_info(compared_at(5, runs=steady))
    assert (numbers(info.said), info.seen) == ([3], "")
    sentences(info.said)
    assert [group.verdict for group in info.groups] == ["too few runs"]


def test_sides_without_a_common_result_say_how_to_compare_them(sentences):
    info = comparison_info(compare_roundtrips(steady([MS]), steady([MS], **BRIDGED), OPTIONS))
    assert info.ignore == ("bridge", "domain_mode")
    unlike = comparison_info(
        compare_roundtrips(steady([MS]), steady([MS], vendor="zenoh", payload_bytes=1000), OPTIONS)
    )
    assert numbers(unlike.seen) == [33_000, 1000]
    sentences(info.said, info.seen, unlike.seen)


@pytest.mark.parametrize("new_ms", [5, 6])
def test_gates_are_named_as_the_groups_are_and_missing_ones_too(new_ms):
    found = several([new_ms, 5])
    info = comparison_info(found, judge_gates(found, GATES[:1]))
    names = {group.label for group in info.groups}
    assert {gate.where for gate in info.gates} == names
    assert info.outcome.value == {5: "passed", 6: "regressed"}[new_ms]
    base = pl.concat([in_runs([MS] * 9), in_runs([MS] * 9, payload_bytes=7)])
    found = compare_roundtrips(base, in_runs([MS] * 9), OPTIONS)
    info = comparison_info(found, judge_gates(found, GATES[:1]))
    assert info.only_base == ("Binary 7 B at 10 Hz",)
    assert [gate.where for gate in info.gates if gate.result.outcome.value == "regressed"] == ["Binary 7 B at 10 Hz"]
