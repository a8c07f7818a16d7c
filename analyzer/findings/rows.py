"""Findings of one filter and one sentence: rules over the rows of a frame.

A sentence names columns. Besides Python's formats it takes `{late_ns:duration}`, `{busy:digits}`,
`{gaps:share of {received}}`, a number with its noun `{received:# reply|replies}` and a word without it `{missing:has|have}`.
A part in brackets is left out where one of its values is null or 0.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partialmethod
from string import Formatter
from typing import Any

import polars as pl

from dds_trace.base.units import counted, format_duration, three_digits

from ..model.finding import Severity, Subject
from .evidence import Check, Evidence, Observation, percent

Row = dict[str, Any]
Place = Callable[[Evidence, Row], tuple[str, tuple[int, ...]]]
"""Returns the `where` and the groups of a row."""


@dataclass(frozen=True, slots=True)
class Rows:
    subject: Subject
    frame: Callable[[Evidence], pl.DataFrame]
    place: Place

    def _rule(
        self,
        severity: Severity,
        code: str,
        title: str,
        when: pl.Expr,
        what: str,
        action: str,
        effect: pl.Expr | float = 1.0,
    ) -> Check:
        def observe(evidence: Evidence) -> Iterator[Observation]:
            frame = evidence.frame(self.frame)
            if frame.is_empty():
                return  # it may have no columns
            effect_column = (effect if isinstance(effect, pl.Expr) else pl.lit(effect)).alias("effect")
            for row in frame.filter(when).with_columns(effect_column).iter_rows(named=True):
                where, groups = self.place(evidence, row)
                yield Observation(where, sentence(what, row), groups, row["effect"], row)

        return Check(code, severity, title, action, self.subject, observe)

    error = partialmethod(_rule, Severity.ERROR)
    warning = partialmethod(_rule, Severity.WARNING)
    note = partialmethod(_rule, Severity.INFO)


class _Sentence(Formatter):
    def format_field(self, value: Any, format_spec: str) -> str:
        if format_spec in _FORMATS:
            return _FORMATS[format_spec](value)
        if format_spec.startswith("share of "):
            return percent(value, float(format_spec.removeprefix("share of ").replace(",", "")))
        if format_spec.startswith("# "):
            return counted(value, *format_spec[2:].split("|"))
        if "|" in format_spec:
            singular, many = format_spec.split("|")
            return singular if value == 1 else many
        if type(value) is int and not format_spec:
            return f"{value:,}"
        return str(super().format_field(value, format_spec))


_FORMATS: Mapping[str, Callable[[float], str]] = {"duration": format_duration, "digits": three_digits}
_SENTENCE = _Sentence()
_OPTIONAL = re.compile(r"\[([^][]*)\]")


def sentence(template: str, row: Row) -> str:
    def optional(part: re.Match[str]) -> str:
        names = (name for _, name, _, _ in _SENTENCE.parse(part[1]) if name)
        return part[1] if all(row[name] for name in names) else ""

    return _SENTENCE.vformat(_OPTIONAL.sub(optional, template), (), row)


def frame_of(records: Iterable[Row]) -> pl.DataFrame:
    rows = [*records]
    ids = ("run_id", "session_id", "relay_id")
    for row in rows:
        texts = {name: value for name, value in row.items() if isinstance(value, str) and not value.isascii()}
        row.update({name: text.encode("utf-8", "backslashreplace").decode() for name, text in texts.items()})
    overrides = dict.fromkeys([name for name in ids if rows and name in rows[0]], pl.UInt64)
    return pl.DataFrame(rows, schema_overrides=overrides, infer_schema_length=None)


def named(_evidence: Evidence, row: Row) -> tuple[str, tuple[int, ...]]:
    return row["where"], ()


def in_result(evidence: Evidence, row: Row) -> tuple[str, tuple[int, ...]]:
    return evidence.group_names[row["group"]], (row["group"],)


def in_recording(evidence: Evidence, row: Row) -> tuple[str, tuple[int, ...]]:
    session = evidence.campaign.sessions[row["session_id"]]
    return evidence.session_name(session), evidence.groups_of_sessions.get(session.session_id, ())


def in_run(evidence: Evidence, row: Row) -> tuple[str, tuple[int, ...]]:
    return evidence.run_name(row["run_id"]), ()


RESULTS = Rows(Subject.RESULT, lambda evidence: evidence.summary.frame.with_row_index("group"), in_result)
