"""Every number of an answer, and of a comparison, is one of the frame: a row of `judgements` or another frame of the JSON report."""

import json
import random
import re
import tarfile
from functools import partial
from pathlib import Path

import polars as pl
import pytest
from analyses import BRIDGED, EVERY_ANALYSIS, MS, ZENOH, Measured, around, make_analysis
from four_campaigns import CAMPAIGNS
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
from dds_trace.reports import document
from dds_trace.reports.book.answer import PointKind
from dds_trace.reports.book.book import Book
from dds_trace.reports.book.groups import VENDORS, VendorLabels, format_count, time_words
from dds_trace.reports.book.verdicts import conditions_label, setup_labels

RESULTS = Path(__file__).parents[3] / "docs" / "results"
STORED = sorted({path.parent.name for path in RESULTS.glob("*/*.tar.xz")} - {"drive"})


def drawn(seed):
    """Two or three setups at up to three sizes; some lose, and some send less than is due."""
    chance = random.Random(seed)

    def messages():
        typical_ns, lost = round(MS * chance.uniform(0.5, 5)), chance.choice((0, 0, 0.02, 0.2))
        return ["lost_return" if chance.random() < lost else ns for ns in 3 * around(typical_ns)]

    sides = chance.sample([{}, ZENOH, BRIDGED, {"setting": "queue_depth=1"}], chance.choice((2, 3)))
    return make_analysis(
        *(
            Measured(messages(), payload_bytes=size, unsent=chance.choice((0, 0, 3)), **side)
            for size in chance.sample([1000, 33_000, 502_000], chance.choice((1, 3)))
            for side in sides
        )
    )


MADE = {f"made {name}": make for name, make in {**EVERY_ANALYSIS, **CAMPAIGNS}.items()}
MADE |= {f"made by {seed}": partial(drawn, seed) for seed in range(9)}
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
    known |= {*losses(groups)} if groups else set()
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
        assert {*TOKEN.findall(sentence)} <= known, sentence


def campaign(name, folder):
    if name in SAMPLE_NAMES:
        return analyze(SAMPLES / name)
    for archive in (RESULTS / name).glob("*.tar.xz"):
        with tarfile.open(archive) as traces:
            traces.extractall(folder / archive.name, filter="data")
    return analyze(folder) if name in STORED else MADE[name]()


@pytest.mark.parametrize("name", [*STORED, *SAMPLE_NAMES, *MADE])
def test_every_number_of_an_answer_is_one_of_its_frames(tmp_path, name):
    analysis = campaign(name, tmp_path)
    check(Book(analysis))
    check_comparison(analysis.load_messages())


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
