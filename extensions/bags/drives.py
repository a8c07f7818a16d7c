"""Two recordings side by side, topic by topic, and limits of their changes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from dds_trace.base.errors import OptionError, TraceError
from dds_trace.base.printable import printable
from dds_trace.base.units import MISSING, SECOND_NS, counted, first_of, format_rate
from dds_trace.extensions.gates.gate import Against, Gate, GateOutcome, parse_topic_gate
from dds_trace.extensions.gates.gates import overall_outcome, result_of
from dds_trace.extensions.gates.limits_file import read_limits
from dds_trace.reports import blocks
from dds_trace.reports.blocks import MARKDOWN, Column, Heading, Points, Row, Section, Sentence, Table

from .analyze import TopicReport, analyze_topics
from .bounds import FEW, SHOWN, WINDOW
from .card import DAMAGED, EMPTY
from .limits import JudgedTopic, judge_topics
from .losses import quiet_ns
from .messages import find_recordings
from .recover import is_of_others
from .report import (
    TopicRow,
    age_words,
    ended_words,
    ends_ns,
    facts_words,
    gate_rows,
    judged_blocks,
    missing_words,
    rate_words,
    seconds_words,
    verdict_words,
)

Change: TypeAlias = tuple[float, str] | None
"""Its size, and words after the name of a topic."""
_SEEN = 0.0, ""

_COLUMNS = ("Topic", "Rate", "Missing", "Messages", "Age", "Type")
_IS_THERE = Gate("every topic of the base is there", "received_ratio", "", "<=", Against.NEW, 0.0)
_IS_WHOLE = Gate("the new recording is not damaged", "received_ratio", "", "<=", Against.NEW, 0.0)


def are_drives(*sides: Path) -> bool:
    """Return whether all of these are recordings of other tools, and no traces of ours."""
    try:
        files = [find_recordings(side) for side in sides]
        return all(files) and all(is_of_others(file) for side in files for file in side)
    except TraceError:
        return False


def compare_drives(
    base: Path, new: Path, texts: Sequence[str], limits_file: Path | None, *, allow_missing: bool
) -> DriveComparison:
    """Compare two recordings and judge what changed; an `OptionError` for several on a side or a limit that is none of topics."""
    gates = [parse_topic_gate(text, of_two=True) for text in texts]
    gates += [] if limits_file is None else read_limits(limits_file, of_recording=True)
    comparison = side_by_side(analyze_topics(base), analyze_topics(new))
    if gates:
        comparison.judge(gates, allow_missing=allow_missing)
    return comparison


def side_by_side(base: TopicReport, new: TopicReport) -> DriveComparison:
    for report in (base, new):
        if not isinstance(report, TopicReport):
            raise OptionError("compare takes two results of analyze, or two of analyze_topics")
        if len(report.recordings) != 1:
            where = report.recordings[0].path
            raise OptionError(f"{where}: one of {len(report.recordings)} recordings; name one of them to compare")
    return DriveComparison((Path(base.recordings[0].path), Path(new.recordings[0].path)), (base, new))


@dataclass(repr=False)
class DriveComparison(blocks.Report):
    paths: tuple[Path, Path]
    reports: tuple[TopicReport, TopicReport]
    judged: Sequence[JudgedTopic] = ()
    name = "comparison"
    title: str = "What changed between two bags?"
    kicker = "Two recordings"

    def __repr__(self) -> str:
        return f"<DriveComparison: {' → '.join(map(str, self.paths))}, {counted(len(self.topics), 'topic')}; .topics, .reports>"

    @property
    def topics(self) -> dict[str, tuple[TopicRow | None, ...]]:
        """Rows of the base and the new recording by topic; None where one lacks it."""
        sides = [{row["topic"]: row for row in report.topics.rows(named=True)} for report in self.reports]
        return {name: tuple(side.get(name) for side in sides) for name in sorted(sides[0] | sides[1])}

    @property
    def outcome(self) -> GateOutcome:
        if all(None in rows for rows in self.topics.values()):
            return GateOutcome.NOTHING_TO_COMPARE
        return overall_outcome([GateOutcome.PASSED, *(gated.result.outcome for gated in self.judged)])

    def judge(self, gates: Sequence[Gate], *, allow_missing: bool) -> None:
        gone = [] if allow_missing else [name for name, (_, after) in self.topics.items() if after is None]
        before, after = self.reports
        failed = [result_of(_IS_THERE, name, GateOutcome.REGRESSED, reason="missing on the new side") for name in gone]
        if after.verdict in (DAMAGED, EMPTY):  # limits see what can still be read
            failed.append(result_of(_IS_WHOLE, str(self.paths[1]), GateOutcome.REGRESSED, reason="it is damaged"))
        self.judged = [JudgedTopic(result.subject, result, "") for result in failed]
        self.judged += judge_topics(after.topics, after.holes, gates, before)

    @property
    def document(self) -> Mapping[str, Any]:
        topics = [{"topic": name, "base": before, "new": after} for name, (before, after) in self.topics.items()]
        return {"format": 1, "paths": [*map(str, self.paths)], "topics": topics, "gates": gate_rows(self.judged)}

    @property
    def sections(self) -> Sequence[Section]:
        topics, facts = self.topics, list[str]()
        common = sum(None not in rows for rows in topics.values())
        for path, report in zip(self.paths, self.reports, strict=True):
            (health,), rows = report.recordings, report.topics.rows(named=True)
            facts.append(
                f"{printable(str(path))}: {verdict_words(health, rows)}{ended_words(health, rows)} {facts_words(health, len(rows))}"
            )
        headline = " ".join(self._changes()) or "No topic is gone; no other rate, longer silence or more loss was seen."
        lengths = " → ".join(seconds_words(report.recordings[0].duration_ns / SECOND_NS) for report in self.reports)
        summary = (
            f"{counted(common, 'topic')} on both sides, {len(topics) - common} on one; base → new, {lengths} long."
        )
        columns = [Column(name, right=name not in ("Topic", "Type")) for name in _COLUMNS]
        drawn = [self._row(name, rows) for name, rows in topics.items()]
        table = Table(columns, drawn, label="Table of the topics", look="data cards")
        heading = Heading(self.title, 1, media=MARKDOWN)
        first = Section([heading, Sentence(headline, "headline"), Sentence(summary), Points(facts)])
        return [first, Section([table]), Section(judged_blocks(self.judged) if self.judged else [])]

    def _changes(self) -> Iterator[str]:
        if DAMAGED in (report.verdict for report in self.reports):
            yield "Only what can be read of a damaged recording is compared."
        for words, change_of in (*_CHANGES, ("Longest silence, also at start or end: {}.", self._silence)):
            changes = [(*change, name) for name, rows in self.topics.items() if (change := change_of(*rows))]
            changes.sort(key=lambda change: -change[0])
            topics = [f"{printable(name)}{how}" for _, how, name in changes]
            if topics:
                yield words.format(", ".join(first_of(topics, SHOWN)))

    def _silence(self, *rows: TopicRow | None) -> Change:
        sides = [(row, report.recordings[0]) for row, report in zip(rows, self.reports, strict=True) if row]
        silent_ns = [max(row["gap_max_ns"] or 0, *ends_ns(row, health)) for row, health in sides]
        rates_hz = [row["expected_rate_hz"] for row, _ in sides if row["expected_rate_hz"]]
        if len(sides) < 2 or not rates_hz or silent_ns[1] <= max(2 * silent_ns[0], quiet_ns(SECOND_NS / min(rates_hz))):
            return None
        return silent_ns[1], f" {' → '.join(seconds_words(ns / SECOND_NS) for ns in silent_ns)}"

    def _row(self, name: str, rows: Sequence[TopicRow | None]) -> Row:
        sides = [_cells(row) for row in rows]
        changed = [was if was == now else f"{was} → {now}" for was, now in zip(*sides, strict=True)]
        return Row([printable(name), *changed])


def _lacks_more(was: TopicRow | None, now: TopicRow | None) -> Change:
    if not was or not now or None in (was["missing"], now["missing"]):
        return None
    most, least = was["missing_high"], now["missing_low"]
    return _SEEN if least / (now["messages"] + least) > most / (was["messages"] + most) else None


def _rate(was: TopicRow | None, now: TopicRow | None) -> Change:
    """Compare rates and means, without what is lost for sure; of two unsteady ones mean and median have to change."""
    if not was or not now or min(was["messages"], now["messages"]) < WINDOW:
        return None
    steady_hz = was["expected_rate_hz"], now["expected_rate_hz"]
    mean_hz = tuple(row["rate_hz"] * (1 + (row["missing_low"] or 0) / row["messages"]) for row in (was, now))
    bound, medians_hz = 1 + FEW, tuple(1 / (row["period_p50_ns"] or math.inf) for row in (was, now))
    if not any(steady_hz):
        bound = 2
        if not all(medians_hz) or not _is_beyond(bound, *medians_hz):
            return None
    for before, after in (steady_hz, mean_hz):
        if before and after and _is_beyond(bound, before, after):
            return abs(
                math.log(after / before)
            ), f" {format_rate(before)} → {format_rate(after)} ({100 * (after / before - 1):+.3g} %)"
    return None


def _is_beyond(bound: float, before: float, after: float) -> bool:
    return not 1 / bound <= after / before <= bound


_CHANGES: tuple[tuple[str, Callable[[TopicRow | None, TopicRow | None], Change]], ...] = (
    ("Gone on the new side: {}.", lambda _, now: None if now else _SEEN),
    ("New there: {}.", lambda was, _: None if was else _SEEN),
    ("A larger share of messages is missing on {}.", _lacks_more),
    ("A smaller share of messages is missing on {}.", lambda was, now: _lacks_more(now, was)),
    ("Another rate: {}.", _rate),
)


def _cells(row: TopicRow | None) -> tuple[str, ...]:
    if row is None:
        return (MISSING,) * (len(_COLUMNS) - 1)
    return rate_words(row), missing_words(row), f"{row['messages']:,}", age_words(row), printable(row["message_type"])
