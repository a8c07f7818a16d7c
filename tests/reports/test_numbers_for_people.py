import html
import json
import re
from dataclasses import replace
from functools import cache

import polars as pl
import pytest
from analyses import MS, Measured, make_analysis
from four_campaigns import CAMPAIGNS
from roundtrip_frames import in_runs, rows_by_group, steady
from visible_text import visible_text
from wording import comparison_as

from dds_trace.analyzer.verdicts.answers import find_answers
from dds_trace.analyzer.verdicts.job import Job
from dds_trace.base.units import format_duration
from dds_trace.extensions.campaigns.recommend import recommend_settings
from dds_trace.extensions.campaigns.recommendation import recommendation_info
from dds_trace.extensions.gates import document
from dds_trace.extensions.gates.compare import compare, compare_roundtrips
from dds_trace.extensions.gates.gate import parse_gate
from dds_trace.extensions.gates.gates import judge_gates
from dds_trace.extensions.gates.info import comparison_info
from dds_trace.extensions.gates.words import both_words, change_words
from dds_trace.extensions.live.notebook import MOST_CHARACTERS
from dds_trace.reports.blocks import plain_text
from dds_trace.reports.book.book import Book
from dds_trace.reports.book.groups import VENDORS, VendorLabels
from dds_trace.reports.book.sizes import size_block
from dds_trace.reports.reporters import load_reporter

TOO_MUCH = {
    "a percentage beyond 1000": re.compile(r"(?<![\d.])(?:\d{4,}|[\d,]*\d,\d{3})(?:\.\d+)? ?%"),
    "more points than there are": re.compile(r"\d{3,}\.\d+ points"),
    "a factor of one": re.compile(r"\b1 times\b"),
    "an exponent": re.compile(r"\d(?:\.\d+)?e[+-]?\d"),
    "no number": re.compile(r"\b(?:nan|inf|None)\b"),
}
WITH_UNIT = re.compile(r"(?<![\d.,:])(\d+\.\d+) ?(ns|µs|ms|s|%|Hz|times|points|ppm|periods)(?!\w)")


def faults(text):
    found = [f"{what}: {match[0]}" for what, pattern in TOO_MUCH.items() for match in pattern.finditer(text)]
    for number, unit in WITH_UNIT.findall(text):
        close_to_all = unit == "%" and 99 <= float(number) < 100
        if len(number.replace(".", "").lstrip("0")) > 3 and not close_to_all:
            found.append(f"more than three digits: {number} {unit}")
    return found


@pytest.mark.parametrize(
    "text",
    ["below 8,350,498 %", "drops from 108.37 points on", "takes 1 times as long", "at 163.513 ms", "12.345 %", "1e+03 %", "nan ms"],
)  # fmt: skip
def test_an_unreadable_number_is_found(text):
    assert faults(text)


@pytest.mark.parametrize("text", ["1.25 ms, 99.97 %", "12,300 messages, 12 times", "2.14.5, 0.0352 %", "-0.5 points"])
def test_a_readable_number_is_not_found(text):
    assert faults(text) == []


@pytest.mark.parametrize("kind", ["html", "md", "terminal"])
@pytest.mark.parametrize("name", CAMPAIGNS)
def test_reports_have_numbers_for_people(name, kind):
    assert faults(visible_text(load_reporter(kind).render(Book(CAMPAIGNS[name]())))) == []


@cache
def comparisons():
    """Few messages, wild runs, equal sides, losses, and a side that is a hundred times slower."""
    wild = [MS * (1 + n % 7) for n in range(120)]
    sides = {
        "wild": (in_runs(wild, spread=2.0), in_runs(wild, spread=3.0, run_id=2)),
        "short": (in_runs([MS] * 12, spread=0.5), in_runs([MS * 2] * 12, spread=0.5, run_id=2)),
        "equal": (in_runs(wild), in_runs(wild)),
        "a hairbreadth": (in_runs(wild, spread=1e-6), in_runs([ns + 2000 for ns in wild], spread=1e-6, run_id=2)),
        "slow": (in_runs(wild), in_runs([137 * ns for ns in wild], run_id=2)),
        "lossy": (in_runs(wild), in_runs([None if n % 9 == 0 else ns for n, ns in enumerate(wild)], run_id=2)),
        "one run": (steady(wild), steady(wild, run_id=2)),
    }
    gates = [
        parse_gate(text)
        for text in ("latency_p50 > +10%", "latency_p99 > +10%", "latency_p99 > 5ms", "received_ratio < -0.5 points")
    ]
    found = {}
    for name, (base, new) in sides.items():
        comparison = compare_roundtrips(base, new)
        found[name] = comparison, comparison_info(comparison, judge_gates(comparison, gates))
    return found


@pytest.mark.parametrize("name", ["wild", "short", "equal", "a hairbreadth", "slow", "lossy", "one run"])
def test_comparisons_and_gates_have_numbers_for_people(name):
    comparison, info = comparisons()[name]
    said = json.loads(comparison_as("json", info, comparison))
    texts = [
        comparison_as("terminal", info, shows_all=True),
        html.unescape(comparison_as("md", info, shows_all=True)),
        visible_text(comparison_as("html", info, title="base → new")),
        html.unescape(document.render_junit(info)),
        "\n".join(
            [said["said"], said["seen"], *said["notes"], *said["rules"], *(gate["reason"] for gate in said["gates"])]
        ),
    ]
    assert [faults(text) for text in texts] == [[]] * len(texts)


def test_what_too_few_messages_cannot_show_is_not_a_number():
    _, info = comparisons()["wild"]
    assert "too few messages to judge p99" in info.seen
    reasons = [gated.result.reason for gated in info.gates if gated.result.gate.text == "latency_p99 > +10%"]
    assert reasons
    assert not [reason for reason in reasons if "%" in reason]
    assert "uncertain" in comparison_as("md", info)


def test_a_folder_compared_with_itself_is_named_as_such():
    analysis = CAMPAIGNS["demo"]()
    info = comparison_info(compare(analysis, analysis))
    assert info.said.startswith("Both sides are the same recordings")


def test_a_comparison_breaks_no_cell_of_numbers_at_80_columns():
    for _, info in comparisons().values():
        lines = comparison_as("terminal", info, shows_all=True).splitlines()
        assert max(map(len, lines)) <= 80
        at = next(at for at, line in enumerate(lines) if line.startswith("Binary") and "→" in line)
        rows = info.groups[0].shown()
        assert both_words(rows[0]) in lines[at]
        assert all(change_words(row["ratio"]) in lines[at + 1] for row in rows)


def jobs():
    wild = [MS * (1 + n % 7) for n in range(120)]
    frames = {
        "few": steady(wild[:30]),
        "one run": steady(wild * 4),
        "late": in_runs(wild * 4, spread=0.3),
        "lossy": in_runs([None if n % 13 == 0 else ns for n, ns in enumerate(wild * 3)]),
        "slow": in_runs(wild, period_ns=133_370_000),
        "guess": pl.concat(
            in_runs([ns * (1 + size // 10_000) for ns in wild], payload_bytes=size, run_id=1 + size)
            for size in (10_000, 50_000, 90_000)
        ),
        "not guessed": pl.concat(
            in_runs([None if n % 13 == 0 else ns for n, ns in enumerate(wild)], payload_bytes=size, run_id=1 + size)
            for size in (10_000, 90_000)
        ),
    }
    return [(name, frame, deadline) for name, frame in frames.items() for deadline in (3 * MS, 8 * MS, 50 * MS)]


@pytest.mark.parametrize(("frame", "deadline_ns"), [pytest.param(f, d, id=f"{n}-{d // MS}ms") for n, f, d in jobs()])
def test_recommendations_have_numbers_for_people(frame, deadline_ns):
    for reliability in (0.99, 0.999):
        job = Job("binary", 33_000, 10.0, deadline_ns, reliability, metric="latency")
        advice = recommendation_info(recommend_settings(frame, job), VendorLabels(VENDORS))
        text = " ".join([advice.job, advice.sentence, *(" ".join(row) for row in advice.rows)])
        assert faults(text.replace("99.9 %", "")) == []


@cache
def demo_like():
    """Three setups and a bridge, whose runs differ so that a typical run and all messages have different medians."""
    values = [MS * (10 + n * 37 % 101) // 20 for n in range(60)]
    lopsided = [value if n % 3 else 3 * value for n, value in enumerate(values)]
    groups = [
        Measured(
            [round(ns * factor) for ns in lopsided],
            vendor=vendor,
            relay_vendor=vendor,
            bridge=bridge,
            domain_mode="same" if bridge == "none" else "different",
            payload_bytes=size,
            runs=3,
        )
        for vendor, bridge, factor in (
            ("fastdds", "none", 1.0), ("cyclonedds", "none", 1.7), ("zenoh", "none", 0.6), ("fastdds", "builtin", 2.3),
        )
        for size in (33_000, 502_000)
    ]  # fmt: skip
    analysis = make_analysis(*groups, title="demo")
    typical = pl.concat(
        analysis.load_roundtrips().with_columns(
            (pl.col("latency_ns") * factor).round().cast(pl.Int64), run_id=pl.col("run_id") + (number << 32)
        )
        for number, factor in enumerate((1.0, 1.4, 1.1))
    )
    answers = find_answers(rows_by_group(typical))
    return replace(analysis, details=replace(analysis.details, answers=answers))


def labelled_medians(report, kind, book):
    """Label -> result -> median as text, of each table that a report has of results."""
    found = {}
    typical = {
        (row.size, choice): cell.p50
        for row in book.sizes.places[0].rows
        for choice, cell in zip(book.sizes.choices, row.cells, strict=True)
        if cell is not None
    }
    caption = plain_text(size_block(book.sizes).caption)
    found[caption.partition(" (")[0]] = typical
    assert caption in report, kind
    times = book.values.times_ns["latency"]["p50"]
    pooled = {}
    for group in book.groups.in_order:
        cell, series = book.groups.cell_of(group), book.groups.series_of(group)
        bridged = "" if series.bridge == "none" else " through our built-in bridge"
        size = f"Binary {cell.payload_bytes // 1000} KB"
        pooled[size, f"{series.vendor_label}{bridged}"] = format_duration(times[group.index])
    label = {"html": "Times are of all messages that were received"}.get(
        kind, "Latency of all messages that were received"
    )
    found[label] = pooled
    assert label in report, kind
    return found


@pytest.mark.parametrize("kind", ["html", "md", "terminal"])
def test_no_label_has_two_figures_of_one_result(kind):
    book = Book(demo_like(), shows_all=True)
    report = " ".join(visible_text(load_reporter(kind).render(book)).split())
    (one, typical), (other, pooled) = labelled_medians(report, kind, book).items()
    assert typical.keys() == pooled.keys()
    assert all(typical[result] != pooled[result] for result in typical), "the two are different figures"
    assert "typical run" in one
    assert "typical run" not in other
    # Every median in a sentence is of one of the two kinds, and says of which.
    for sentence in (book.answer.headline, *book.answer.points, *book.answer.remarks):
        for match in re.finditer(r"median (?:latency )?(of a typical run|of all messages)? ?[+\d]", sentence):
            assert match[1], sentence
    assert "a typical run (at 10 Hz)" in demo_like()._repr_html_()


OLD_WORDS = re.compile(
    r"\bcells?\b|via builtin|null for want|keeping an event|\brecorder\b|\blibrary\b|the way was full|waits in reader"
    r"|vendors against each other|per vendor\b|\bseries\b|\binconclusive\b|combinations?\b|\bcontenders?\b|\bstrat(?:um|a)\b"
    r"|\bsurvivors?\b|\b(?:told|tells?) apart\b|\bepisodes?\b|\bchoices?\b",
    re.IGNORECASE,
)
"""Words that newcomers did not understand on the page."""

SHAPES = {
    # name -> groups, devices and links, runs of each group, whether messages are lost
    "demo": (6, 1, 3, False),
    "lossy machine": (126, 1, 3, True),
    "study": (384, 6, 3, True),
    "500 groups": (520, 1, 1, True),
}


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_a_campaign_has_its_groups_places_runs_and_losses(name):
    analysis = CAMPAIGNS[name]()
    summary = analysis.summary
    places = summary.select("ping_device", "relay_device", "connectivity").unique().height
    loses = bool((summary["received"] < summary["published"]).any())
    (runs,) = summary["runs"].unique()
    assert (summary.height, places, runs, loses) == SHAPES[name]
    assert len(analysis.runs) == summary["runs"].sum()
    first = analysis._repr_html_()
    assert len(first) <= MOST_CHARACTERS
    assert ("color:#e5484d" in first) == SHAPES[name][3], "losses are red in a notebook, too"
    assert first.count("<tbody>") == places
    book = Book(analysis, shows_all=True)
    for kind in ("html", "md", "terminal"):
        shown = visible_text(load_reporter(kind).render(book))
        assert ("the paper's intermediate-process time" in shown) == (kind == "html")
        shown = re.sub(r"@software\{.*?\n\}", "", shown, flags=re.DOTALL)  # the title of the citation
        old = [shown[max(0, found.start() - 60) : found.end() + 30] for found in OLD_WORDS.finditer(shown)]
        assert old == [], f"{kind} of {name}"


def test_a_comparison_is_in_the_words_of_a_report():
    sides = [CAMPAIGNS[name]().load_roundtrips() for name in ("demo", "demo")]
    comparison = compare_roundtrips(*sides)
    info = comparison_info(comparison, judge_gates(comparison, [parse_gate("latency_p50 > +10%")]))
    texts = [
        comparison_as("terminal", info, shows_all=True),
        comparison_as("md", info, shows_all=True),
        visible_text(comparison_as("html", info, title="main → branch")),
        document.render_junit(info),
    ]
    assert not any(OLD_WORDS.search(html.unescape(text)) for text in texts)
