"""Every number of an answer, and of a comparison, is one of the frame: a row of `judgements` or another frame of the JSON report.

And no sentence denies what a row proves, or speaks in words of a rule's inside: a denial is a query whose rows, over all that the
sentence speaks of, are none.
"""

import json
import re
import tarfile
from collections import defaultdict
from functools import partial
from pathlib import Path

import polars as pl
import pytest
from analyses import EVERY_ANALYSIS, MS, ZENOH, Measured, around, make_analysis
from four_campaigns import CAMPAIGNS
from made_campaigns import drawn_campaign
from trace_files import SAMPLE_NAMES, SAMPLES

from dds_trace.analyzer.model.parameters import CONTENDER_COLUMNS
from dds_trace.analyzer.model.setting import CONDITIONS
from dds_trace.analyzer.pipeline import analyze
from dds_trace.analyzer.statistics.intervals import MIN_RUNS
from dds_trace.analyzer.statistics.power import POWER
from dds_trace.base.units import format_duration, format_number, format_rate, format_ratio, format_size
from dds_trace.extensions.campaigns.plan.cells import AXES
from dds_trace.extensions.gates.compare import CompareOptions, compare_roundtrips
from dds_trace.extensions.gates.gate import parse_gates
from dds_trace.extensions.gates.gates import judge_gates, options_for
from dds_trace.extensions.gates.info import comparison_info
from dds_trace.extensions.gates.report import ComparisonReport
from dds_trace.extensions.gates.words import change_words, gate_notes
from dds_trace.extensions.topics.report import topic_links
from dds_trace.reports import document
from dds_trace.reports.book.answer import PointKind
from dds_trace.reports.book.book import Book
from dds_trace.reports.book.fastest import fastest_words, places_alike, stretches
from dds_trace.reports.book.groups import VENDORS, VendorLabels, format_count, time_words
from dds_trace.reports.book.verdicts import conditions_label, contender_labels, place_of, setup_labels
from dds_trace.reports.reporters import load_reporter

RESULTS = Path(__file__).parents[3] / "docs" / "results"
STORED = sorted({path.parent.name for path in RESULTS.glob("*/*.tar.xz")} - {"drive"})


MADE = {f"made {name}": make for name, make in {**EVERY_ANALYSIS, **CAMPAIGNS}.items()}
DRAWN = {f"drawn by {seed}": partial(drawn_campaign, seed) for seed in range(20)}
TOKEN = re.compile(r"(?<![\w#-])\d+(?:,\d{3})*(?:\.\d+)?(?: (?:%|(?:ns|µs|ms|s|B|KB|MB|Hz)\b))?")


def named(groups):
    for group in groups:
        yield format_size(group["payload_bytes"])
        yield format_rate(group["rate_hz"])
        yield from (token for value in group.values() if isinstance(value, str) for token in TOKEN.findall(value))
        yield from TOKEN.findall(conditions_label(group["setting"]))
        yield str(group["depth"])


def losses(groups):
    due = sum(group["published"] + group["unsent"] for group in groups)
    lost = due - sum(group["received"] for group in groups)
    yield from (format_ratio(lost / due), format_count(lost), format_count(due))
    yield format_count(sum(group["unsent"] for group in groups))


def seen_with_losses(report):
    lost = [group["published"] - group["received"] for group in report["groups"]]
    yield format_count(sum(lost))
    seen = defaultdict(set)
    for finding in report["findings"]:
        seen[finding["code"]] |= {*finding["groups"]}
        seen["cured" if finding["cure"] else ""] |= {*finding["groups"]}
    for groups in seen.values():
        yield format_count(sum(lost[group] for group in groups))


def judged(report):
    for row in report["judgements"]:
        if row["claim"] == "lossy":
            yield from (format_ratio(row["value"]), format_count(row["lost"]), format_count(row["messages"]))
        if row["claim"].startswith(("leads", "takes longer", "differs ")):
            yield from (format_number(row["value"] or 0), str(row["needs"]))
            for end in ("value", "low", "high"):
                yield f"{100 * ((row[end] or 1) - 1):.3g} %"


def frames(report):
    yield from map(str, range(2 * len(report["answers"]) + 1))  # counts of comparisons
    yield from (format_duration(row["back_ns"] or 0) for row in report["recoveries"])
    yield from map(str, range(1 + max([group["runs"] for group in report["groups"]], default=0)))
    for group in report["groups"]:
        yield from (format_duration(group[f"{m}_p50_ns"] or 0) for m in ("latency", "rtt", "intermediate", "response"))
    yield from map(str, range(len(report["sessions"]) + 1))
    for row in report["intervals"] or []:
        yield format_duration(row["typical_ns"] or 0)
    for setup in (setup for answer in report["answers"] or [] for setup in answer["contenders"]):
        yield time_words(setup["p50_ns"])
    for row in report["interference"] or []:
        yield from (format_ratio(row[f"{side}_received_ratio"]) for side in ("base", "new"))
    for topic in report["topics"]:
        for value in (value for value in topic.values() if type(value) in (int, float)):
            yield from (format_duration(value), format_count(round(value)))


def check(book):
    report = json.loads(document.render(book))
    groups = report["groups"]
    known = {*named(groups), *judged(report), *frames(report)}
    known |= {*losses(groups), *seen_with_losses(report)} if groups else set()
    for link in topic_links(book.analysis):
        known |= {format_ratio(link.share), *(format_duration(ns) for ns in (link.p50_ns, link.p99_ns) if ns)}
    for kind, sentence in book.answer.sentences:
        cures = {token for finding in report["findings"] for token in TOKEN.findall(finding["cure"] + finding["what"])}
        assert {*TOKEN.findall(sentence.replace("1.01 times", ""))} <= known | cures, (kind, sentence)
    assert "no choice" not in " ".join(text for _, text in book.answer.sentences)
    kind, headline = book.answer.sentences[0]
    is_of_one_clause = ";" not in headline.replace("; 1 run", "")
    assert is_of_one_clause or kind is PointKind.TOPIC or any(";" in label for label in book.groups.labels)


def compared(report):
    yield from map(str, range(1 + len(report["groups"] + report["only_base"] + report["gates"])))
    for group in report["groups"] + report["only_base"]:
        yield from named([{"rate_hz": 0.0, "depth": 0, **group["parameters"]}])
    for delivery in (group["delivery"] for group in report["groups"]):
        yield from (format_ratio(delivery[f"{side}_received_ratio"]) for side in ("base", "new"))
        yield from (str(delivery[f"{side}_runs"]) for side in ("base", "new"))
    for row in report["judgements"]:
        yield from (*TOKEN.findall(change_words(row["value"]) + row["base"] + row["reason"]), str(row["needs"]))
        yield from (time_words(row["value"]), format_ratio(row["value"])) if row["claim"] == "keeps" else ()
    for sight in report["sights"]:
        yield from TOKEN.findall(change_words(sight["least_ratio"]) + change_words(sight["smallest_ratio"]))
        yield from map(str, (100, round(100 * POWER), MIN_RUNS, sight["groups"], sight["groups"] - sight["told"]))


def check_comparison(messages):
    """Compare every other run of a campaign with the others."""
    gates = parse_gates(["default", "latency_p50 > +2ms", "latency_p50 > 1us"])
    is_base = pl.col("run_id").is_in(messages["run_id"].unique().sort()[::2].to_list())
    sides = messages.filter(is_base), messages.filter(~is_base)
    found = compare_roundtrips(*sides, options_for(gates, CompareOptions()))
    info = comparison_info(found, judge_gates(found, gates))
    report = json.loads(document.render(ComparisonReport(info, found, "halves")))
    known = {*compared(report)}
    for sentence in (info.said, info.seen if info.groups else "", *gate_notes(info.gates)):
        assert {*TOKEN.findall(re.sub(r"Such runs decide .*\)\.", "", sentence))} <= known, sentence
    rows = [*(row for group in info.groups for row in group.times()), *(one for one in found.delivery["verdict"])]
    verdicts = {getattr(row, "verdict", row) for row in rows}
    denied = {"No regression": {"worse"}, "No change": {"better", "worse"}, "No result": {"better", "worse"}}
    assert not any(words in info.said and changes & verdicts for words, changes in denied.items()), info.said


def campaign(name, folder):
    if name in SAMPLE_NAMES:
        return analyze(SAMPLES / name)
    for archive in (RESULTS / name).glob("*.tar.xz"):
        with tarfile.open(archive) as traces:
            traces.extractall(folder / archive.name, filter="data")
    return analyze(folder) if name in STORED else MADE[name]()


@pytest.mark.keeps(6)
@pytest.mark.parametrize("name", [*STORED, *SAMPLE_NAMES, *MADE])
def test_every_number_of_an_answer_is_one_of_its_frames(tmp_path, name):
    analysis = campaign(name, tmp_path)
    check(Book(analysis))
    check_comparison(analysis.load_messages())


def test_answers_of_drawn_campaigns_are_those_that_were_read(sentences):
    answers = [Book(make()).answer for make in DRAWN.values()]
    sentences(*(said for one in answers for said in (one.outcome, one.headline, *one.points, *one.remarks)))


def test_a_setup_is_not_compared_with_one_that_was_measured_with_another_message():
    sides = [({}, 33_000, 10), (ZENOH, 33_000, 10), ({}, 33_100, 1), (ZENOH, 33_100, 1)]
    measured = [
        Measured(around(MS if side else 2 * MS), payload_bytes=size, setting=f"queue_depth={depth}", **side)
        for side, size, depth in sides
    ]
    headline, *points = [text for _, text in Book(make_analysis(*measured)).answer.sentences]
    assert "with queue_depth=10: Zenoh (" in headline
    assert "with queue_depth=1: Zenoh (" in points[0]


def settings():
    """A setup, and others of which each differs in one axis, setting or column."""
    plain = dict.fromkeys(CONTENDER_COLUMNS, "x") | {"vendor": "fastdds", "relay_vendor": "fastdds", "bridge": "none"}
    plain |= {"depth": 10, "setting": ""}
    yield plain
    yield from ({**plain, name: 1 if name == "depth" else "other"} for name in CONTENDER_COLUMNS)
    for name, axis in AXES.items():
        values = axis.choices or ["true" if axis.kind is bool else "7"]
        yield from ({**plain, "setting": f"{name}={value}"} for value in values if name not in CONDITIONS)
    for file in ("p.xml#0123abcd", "q.xml#0123abcd", "q.xml#4567abcd"):
        yield from ({**plain, "setting": f"{variable}={file}"} for variable in ("PROFILES", "OTHER"))


def test_no_two_setups_of_any_axis_or_setting_have_one_name():
    every = dict(enumerate(settings()))
    labels = setup_labels(every, VendorLabels(VENDORS))
    assert len({*labels.values()}) == len(every) > 40
    for key, setting in every.items():
        pair = setup_labels({0: every[0], key: setting}, VendorLabels(VENDORS)) if key else {}
        assert len({*pair.values()}) == len(pair), setting
    one_file = {0: every[0], 1: {**every[0], "setting": "PROFILES=p.xml#0123abcd"}}
    assert [*setup_labels(one_file, VendorLabels(VENDORS)).values()] == ["Fast DDS", "Fast DDS, p.xml"]


OF_SETUPS = ("leads", "takes longer")


def proven(book, *claims, **columns):
    rows = book.analysis.judgements.filter(pl.col("claim").is_in(list(claims)), verdict="proven", **columns)
    return rows.height


def lost(book):
    rows = book.analysis.summary
    due = int(rows["published"].sum() + rows["unsent"].fill_null(0).sum())
    return due - int(rows["received"].sum())


def vendors(book):
    series = [book.groups.series_of(group) for group in book.groups.groups]
    others = [one for one in series if one.backend != "socket"] or series
    return len({one.vendor_label for one in others})


def slowed(book, sentence):
    flow = re.search(r"slow ([\w ]+?)\.", sentence)[1]
    others = "+".join(re.split(", | and ", re.split(" do(?:es)? not ", sentence)[0]))
    rows = {"base": "" if flow == "a message" else flow, "subject": others}
    worse = book.analysis.details.interference.filter(flow=rows["base"], with_flows=others, received_verdict="worse")
    return proven(book, "differs with", **rows) + worse.height


DENIALS = {
    r"No difference between setups at p99 is proven": lambda book, _: proven(book, *OF_SETUPS, statistic="latency_p99"),
    r"Too few messages to compare setups at p99": lambda book, _: proven(book, *OF_SETUPS, statistic="latency_p99"),
    r"No proven winner": lambda book, _: proven(book, *OF_SETUPS),
    r"shows no setup to be faster than the others": lambda book, _: proven(book, *OF_SETUPS),
    r"there is no ranking": lambda book, _: sum(len(a.contenders) > 1 for a in book.analysis.details.answers),
    r"No other middleware was measured": lambda book, _: vendors(book) - 1,
    r"Every message was received": lambda book, _: lost(book),
    r"No message was received": lambda book, _: int(book.analysis.summary["received"].sum()),
    r"do(?:es)? not measurably slow": slowed,
    r"Nothing doubtful was found": lambda book, _: len(book.analysis.findings),
}
"""A denial -> the number of rows against it."""

LOOKS_LIKE_ONE = re.compile(
    r"\b(no (?:clear|proven|difference|setup|change)|nothing|none|nobody|not judged)\b", re.IGNORECASE
)
COUNTED = re.compile(
    r"no (?:clear|proven) difference in \d+|where no setup is proven to be the fastest|no proven winner"
)
INSIDE = re.compile(
    r"\b(hochberg|holm|p_adjusted|letters|barred|contenders?|inconclusive|tiers?|stretch|margin_ns|None|nan|inf|null)\b"
)


def check_denials(book):
    for _, sentence in [*book.answer.sentences, *((None, remark) for remark in book.answer.remarks)]:
        rest = COUNTED.sub("", sentence)
        for words, rows in DENIALS.items():
            if re.search(words, sentence):
                assert not rows(book, sentence), (sentence, rows(book, sentence))
                rest = re.sub(words, "", rest)
        assert not LOOKS_LIKE_ONE.search(rest), f"a denial without a query: {sentence}"
        assert not INSIDE.search(sentence), sentence


def check_undecided_clauses(book):
    """Where a clause says that there is no proven winner, it says what else is proven of these sizes and places."""
    answers = book.analysis.details.answers
    labels = contender_labels(answers, book.groups.vendors)
    by_place = {}
    for answer in answers:
        by_place.setdefault((answer.domain_mode, answer.data_type), {}).setdefault(place_of(answer), []).append(answer)
    for places in by_place.values():
        for sites in places_alike(places):
            for stretch in stretches(case for site in sites for case in places[site]):
                words = fastest_words(stretch, labels)
                rows = [row for case in stretch.cases for row in case.judgements]
                leads = [row for row in rows if row.claim.value in OF_SETUPS and row.verdict == "proven"]
                is_denied = re.search(r"no proven winner(?!, but )", words) is not None
                assert is_denied is not bool(leads), (words, leads)


MEDIAN = re.compile(r"\d (?:ns|µs|ms|s)\b|the median message is lost|median latency of [a-z ]+ lost")


def check_medians(book):
    """The answer has a median wherever a message was received and described, in each medium."""
    timed = [row["latency_p50_ns"] for row in book.analysis.summary.to_dicts()]
    if any(timed) and book.answer.metric == "latency" and book.analysis.details.requested:
        said = " ".join([*(text for _, text in book.answer.sentences), *book.answer.remarks])
        assert MEDIAN.search(said), said


def check_media(book):
    for name in ("md", "terminal", "html"):
        text = re.sub(r"\W+", " ", load_reporter(name).render(book))
        for kind, sentence in book.answer.sentences[:1]:
            assert re.sub(r"\W+", " ", sentence).strip()[:40] in text, (name, kind, sentence)


@pytest.mark.keeps(6)
@pytest.mark.parametrize("name", [*STORED, *SAMPLE_NAMES, *DRAWN])
def test_no_sentence_denies_a_proven_row(tmp_path, name):
    analysis = DRAWN[name]() if name in DRAWN else campaign(name, tmp_path)
    book = Book(analysis, shows_all=True)
    check_denials(book)
    check_undecided_clauses(book)
    check_medians(book)
    if name in DRAWN:
        check(book)
        check_comparison(analysis.load_messages())
        check_media(book)
