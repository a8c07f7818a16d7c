"""Write the JSON Schemas of `report.json` and of comparisons from the records that they contain (`just schemas`).

Types come from the annotations of the records and the dtypes of the frames, descriptions from the docstrings of the records.
The tables below have what neither says: which columns are never null, what was added after the first version, ranges.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from inspect import getdoc
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import polars as pl

from dds_trace.analyzer.analysis import DETAIL_FRAMES, Details
from dds_trace.analyzer.details import details_not_requested
from dds_trace.analyzer.model.columns import SUMMARY_COLUMNS
from dds_trace.analyzer.model.detail_frames import COMPARISON_SCHEMA, HOP_SCHEMA, TOPIC_SCHEMA
from dds_trace.analyzer.model.finding import Finding, Source
from dds_trace.analyzer.model.metrics import METRICS
from dds_trace.analyzer.model.parameters import PARAMETER_COLUMNS, PARAMETER_NAMES
from dds_trace.analyzer.statistics.intervals import Basis, Interval
from dds_trace.analyzer.verdicts.answers import CaseAnswer
from dds_trace.analyzer.verdicts.cases import Contender
from dds_trace.analyzer.verdicts.job import Job
from dds_trace.analyzer.verdicts.judgements import Claim, Judgement, judgement_frame
from dds_trace.analyzer.verdicts.recommend import Recommendation
from dds_trace.extensions.gates import document as comparison_document
from dds_trace.extensions.gates.compare import MATCH_COLUMNS, CompareOptions
from dds_trace.extensions.gates.comparison_rows import DELIVERY_SCHEMA, WORST_FIRST
from dds_trace.extensions.gates.detectable import DetectableChange
from dds_trace.extensions.gates.gate import GateOutcome
from dds_trace.extensions.gates.gates import GateResult
from dds_trace.extensions.gates.ignoring import IGNORABLE_COLUMNS
from dds_trace.extensions.gates.info import ComparisonInfo, Unlike
from dds_trace.reports.book.answer import Conclusion
from dds_trace.reports.book.book import FORMAT_VERSION
from dds_trace.reports.book.overview import Fact
from dds_trace.reports.book.recording import OwnCost
from dds_trace.reports.book.verdicts import DataVerdict
from dds_trace.tracefile.format.descriptions import Qos, Run, Session

Schema = dict[str, Any]

ROOT = Path(__file__).parents[1]
DIALECT = "https://json-schema.org/draft/2020-12/schema"
HEX_ID = {"type": "string", "pattern": "^[0-9a-f]{16}$"}
TYPES: dict[object, str] = {str: "string", int: "integer", float: "number", bool: "boolean"}
TYPES |= {Mapping: "object", Qos: "object"}
NAMES = {one.__name__: one for one in (CaseAnswer, Contender, DataVerdict, Finding, Interval, Job, Recommendation)}
NAMES |= {"Judgement": Judgement, "Claim": Claim}
NAMES |= {"Setting": Mapping, "JsonObject": Mapping, "Mapping": Mapping, "Sequence": Sequence}
NAMES |= {"Gate": Mapping, "GateOutcome": GateOutcome}
SHARED = {Contender: "contender", Interval: "interval"}
"""Record -> its name under `$defs`; it occurs in several records."""

NEVER_NULL = {
    *("group", "run_id", "relay_id", "session_id", "metric", "percentile", "quantile", "messages", "runs", "units", "basis"),
    *("part", "order", "base_runs", "new_runs", "pairs", "complete", "kernel_drops", "total_bytes", "again_messages"),
    *("requests", "reassembly_failed", "udp_receive_buffer_full", "tcp_again_bytes", "shared_counts"),
    *("tcp_retransmitted_segments", "wire_class", "packets", "bytes", "repeats", "returned"),
}  # fmt: skip
"""Columns of the details that have a value in every row; so has `payload_bytes` of `wire`."""

NULL_PARAMETERS = {"rmw", "relay_vendor", "relay_backend", "ping_domain_id", "relay_domain_id", "depth", "relay_device"}
"""Parameters of a group that are null without a relay's trace, or where they do not apply."""

ADDED = {
    Conclusion: {"points", "outcome", "kinds"},
    DataVerdict: {"place", "within_one_run"},
    CaseAnswer: {"leader_p50", "leader_p99", "repeats_p50", "repeats_p99", "interleaved", "drift_ratio", "judgements"},
    Finding: {"subject", "cure"},
    Contender: {"p50_ns", "p99_ns", "letters_p50", "letters_p99", "groups"},
}
"""Fields that were added to format 1: a report of an earlier version does not have them."""

NARROW: Schema = {
    "answer.metric": {"enum": ["latency", *(name for name in METRICS if name != "latency")]},
    "answers.percentile": {"enum": ["p50", "p99"]},
    "answers.basis": {"enum": [basis.value for basis in Basis]},
    "findings.count": {"minimum": 1},
    "findings.effect": {"minimum": 0, "maximum": 1},
    "findings.groups": {"items": {"type": "integer", "minimum": 0}},
    "groups.domain_mode": {"enum": ["same", "different"]},
    "groups.received_ratio": {"minimum": 0, "maximum": 1},
    "sessions.role": {"enum": ["ping", "relay", "tap"]},
    "sources.status": {"enum": ["read", "truncated", "duplicate", "skipped"]},
}
"""Field of a part of the report -> what narrows its type."""

COUNTS = {"cells", "inconclusive", "within_one_run", "events", "groups", "told", "payload_bytes", "base_messages"}
COUNTS |= {"new_messages", "base_published", "new_published", "base_runs", "new_runs", "base_episodes", "new_episodes"}
COUNTS |= {"pairs", "own_cost_ns", "own_share"}
"""Numbers of records that are never negative; so are columns of an unsigned dtype."""


def described(record: type) -> dict[str, str]:
    """Return field -> its text in the docstring of a record (Google style, `Attributes:`)."""
    _, _, text = (getdoc(record) or "").partition("Attributes:\n")
    entries = re.findall(r"^    (\w+): (.*?)(?=^    \w+: |\Z)", text, re.DOTALL | re.MULTILINE)
    return {name: " ".join(words.split()).rstrip(".") for name, words in entries}


def an_object(
    properties: Mapping[str, Schema], optional: set[str] | frozenset[str] = frozenset(), **rest: object
) -> Schema:
    """Return the schema of an object."""
    return {
        "type": "object",
        "required": [n for n in properties if n not in optional],
        "properties": properties,
        **rest,
    }


def a_list(items: Schema, description: str) -> Schema:
    """Return the schema of a list."""
    return {"type": "array", "items": items, "description": description}


def or_null(schema: Schema) -> Schema:
    """Return a schema that null follows, too."""
    return {**schema, "type": [schema["type"], "null"]}


def narrowed(name: str, schema: Schema) -> Schema:
    """Return the schema of a field with what `NARROW` has for it; a closed set stands for its type."""
    narrow = NARROW.get(name, {})
    return dict(narrow) if "enum" in narrow else {**schema, **narrow}


def of_hint(hint: Any) -> Schema:
    """Return the schema of a value with an annotation."""
    if get_origin(hint) in (Union, UnionType):
        (inner,) = (one for one in get_args(hint) if one is not NoneType)
        return or_null(of_hint(inner))
    if hint in SHARED:
        return {"$ref": f"#/$defs/{SHARED[hint]}"}
    if is_dataclass(hint) and hint not in TYPES:
        return of_record(hint)
    if isinstance(hint, type) and issubclass(hint, Enum):
        return {"enum": [one.value for one in hint if one is not GateOutcome.NOTHING_TO_COMPARE]}
    if get_origin(hint) is tuple:
        return {"type": "array", "items": of_hint(get_args(hint)[0])}
    return {"type": TYPES[get_origin(hint) or hint]}


def of_record(record: Any, key: str = "", only: Sequence[str] = ()) -> Schema:
    """Return the schema of a dataclass, or of some of its fields."""
    hints, words = get_type_hints(record, localns=NAMES), described(record)
    properties = {}
    for field in fields(record):
        name = field.name
        if only and name not in only:
            continue
        schema = of_hint(hints[name]) if name not in {"run_id", "session_id"} else dict(HEX_ID)
        if schema.get("type") in ("integer", ["integer", "null"]) and name in COUNTS:
            schema["minimum"] = 0
        properties[name] = narrowed(f"{key}.{name}", schema)
        if name in words:
            properties[name]["description"] = words[name]
    return an_object(properties, ADDED.get(record, set()))


def of_dtype(dtype: pl.DataType | type[pl.DataType]) -> Schema:
    """Return the schema of a value of a column."""
    if dtype.is_integer():
        return {"type": "integer", **({"minimum": 0} if dtype.is_unsigned_integer() else {})}
    return {"type": "number" if dtype.is_float() else {pl.String: "string", pl.Boolean: "boolean"}[type(dtype)]}


def of_frame(name: str, frame: pl.DataFrame, text: str = "") -> Schema:
    """Return the schema of the rows of a frame of `Details`."""
    columns = {}
    for column, dtype in frame.schema.items():
        schema = dict(HEX_ID) if column in {"run_id", "session_id"} else of_dtype(dtype)
        is_full = (column in NEVER_NULL and name != "judgements") or (name, column) == ("wire", "payload_bytes")
        columns[column] = schema if is_full else or_null(schema)
        if column == "basis" and name != "judgements":
            columns[column] = NARROW["answers.basis"]
    rows = a_list(an_object(columns), text or described(Details)[name])
    return or_null({**rows, "description": f"{rows['description']}. Null where the analysis was made without details"})


MEANINGS = {
    "metric": "metric that is compared",
    "statistic": "mean or a percentile such as p99_9",
    "base_messages": "messages of the base that have the metric",
    "base_ns": "the statistic with lost messages infinitely late, ns",
    "base_typical_ns": "the statistic of the base's typical run, ns; the change is of the typical runs",
    "difference_ns": "new - base, ns",
    "ratio": "new / base",
    "superiority": "probability that a message of the new side takes less than one of the base",
    "cliffs_delta": "2 * superiority - 1",
    "verdict": "better, worse, same or inconclusive, adjusted over the groups",
    "base_published": "messages that were sent",
    "base_received_ratio": "share of the messages that were received",
    "difference": "new - base of the received ratio",
    "base_survivors_ns": "the statistic of the received messages, ns",
    "base_episodes": "bursts that the tail rests on",
    "basis": "between runs, or within one run",
    "is_dead": "whether messages were received on the base and none on the new side",
    "environment": "same, unknown (no fingerprint), or unlike: with the fields that differ",
    "pairs": "repeats that were compared one by one; 0 without",
    "p_value": "of no difference; null within one run",
    "p_adjusted": "adjusted over the groups, of times over metrics and statistics, too",
    "smallest_ratio": "change that this group by itself would have shown with a probability of 80 %",
    "smallest_drop": "loss of share that would have been shown with a probability of 80 %",
}
"""Of both frames; `new_*` is of the new side what `base_*` is of the base."""


def of_comparison(columns: Mapping[str, type[pl.DataType]]) -> Schema:
    """Return the schema of a row of a comparison's frame: numbers that are not counts may be null, and so are bursts."""
    properties = {}
    for name, dtype in columns.items():
        schema = of_dtype(dtype())
        properties[name] = or_null(schema) if dtype.is_float() or name.endswith("_episodes") else schema
        if name in MEANINGS:
            properties[name]["description"] = MEANINGS[name]
    return an_object(properties, {"base_typical_ns", "new_typical_ns"} & properties.keys())


def of_groups() -> Schema:
    """Return the schema of the rows of `summary.parquet`."""
    columns = {}
    for column in SUMMARY_COLUMNS:
        dtype = column.dtype if isinstance(column.dtype, pl.DataType) else column.dtype()
        name, schema = column.name, of_dtype(dtype)
        is_parameter = name in PARAMETER_NAMES
        is_full = name not in NULL_PARAMETERS if is_parameter else not dtype.is_float()
        columns[name] = {**(schema if is_full else or_null(schema)), **({"minimum": 0} if name in COUNTS else {})}
        columns[name] = narrowed(f"groups.{name}", columns[name])
        columns[name]["description"] = column.meaning
    return a_list(an_object(columns), "one for each combination of parameters: the rows of summary.parquet")


def of_topics(columns: Mapping[str, type[pl.DataType]], words: str) -> Schema:
    """Return the schema of the rows of a frame of topics."""
    typed = {name: of_dtype(dtype()) for name, dtype in columns.items()}
    return a_list(
        an_object(
            {name: or_null(one) if columns[name] in (pl.Float64, pl.Int64) else one for name, one in typed.items()}
        ),
        words,
    )


def parameters() -> Schema:
    """Return the schema of the parameters of a compared group."""
    columns = {}
    for column in PARAMETER_COLUMNS:
        if column.name in MATCH_COLUMNS:
            dtype = column.dtype if isinstance(column.dtype, pl.DataType) else column.dtype()
            columns[column.name] = {**or_null({"type": of_dtype(dtype)["type"]}), "description": column.meaning}
    words = "columns that were matched; one that was ignored is left out"
    return an_object(columns, set(columns), description=words)


def report_schema() -> Schema:
    """Return the schema of `report.json`."""
    details = details_not_requested()
    words = described(Details)
    without = "Null where the analysis was made without details"
    properties: Schema = {
        "format": {"const": FORMAT_VERSION},
        "title": {"type": "string", "description": "name of the analyzed folder"},
        "measured": a_list(of_record(Fact), "what was measured, in words"),
        "answer": of_record(Conclusion, "answer"),
        "findings": a_list(of_record(Finding, "findings"), "worst first: by severity, then by effect"),
        "sources": a_list(of_record(Source, "sources"), "the files that were looked at"),
        "sessions": a_list(of_record(Session, "sessions", SESSION_FIELDS), "as docs/trace-format.md has them"),
        "runs": a_list(of_record(Run, "runs", RUN_FIELDS), "as docs/trace-format.md has them"),
        "groups": of_groups(),
        "topics": of_topics(TOPIC_SCHEMA, "topics that taps heard, one for each pair of devices"),
        "topic_hops": of_topics(HOP_SCHEMA, "what each hop of a chain of topics takes"),
        **{name: of_frame(name, getattr(details, name)) for name in DETAIL_FRAMES},
        "judgements": of_frame(
            "judgements",
            judgement_frame(()),
            "what is said of setups, links, devices, bridges, flows and a job, a row each",
        ),
        "answers": or_null(a_list(of_record(CaseAnswer, "answers"), f"{words['answers']}. {without}")),
        "deadline_ns": {"type": ["integer", "null"], "description": words["deadline_ns"]},
        "deadline_metric": {"type": "string", "description": words["deadline_metric"]},
        "recommendation": {
            **or_null(of_record(Recommendation)),
            "description": "the ranking that `dds-trace choose` asked for, best first; null without it",
        },
        "parquet_encodings": {
            "type": "object",
            "additionalProperties": {"type": "string"},
            "description": "encoding of the columns of roundtrips.parquet; docs/how-to/tables.md says which readers are right",
        },
        "own_cost": a_list(of_record(OwnCost), " ".join((getdoc(OwnCost) or "").partition("\n")[0].split())),
    }
    added = {
        name
        for name in properties
        if name in (*DETAIL_FRAMES, "judgements", "topics", "topic_hops", "answers", "deadline_ns", "deadline_metric")
    }
    return {
        "$schema": DIALECT,
        "title": f"dds-trace report, format {FORMAT_VERSION}",
        "description": (
            "What `dds-trace analyze --report json` writes. Times are in ns, sizes in bytes; `group` is an index of `groups`; null "
            "means that there is no such number, never 0. A later version of the same format may add fields."
        ),
        **an_object(properties, added | {"recommendation", "own_cost", "parquet_encodings"}),
        "$defs": {name: of_record(record) for record, name in SHARED.items()},
    }


SESSION_FIELDS = (
    "session_id",
    "role",
    "device",
    "backend",
    "vendor",
    "rmw",
    "domain_id",
    "dropped_events",
    "state",
    "host",
)
RUN_FIELDS = (
    "run_id",
    "data_type",
    "payload_bytes",
    "rate_hz",
    "planned_messages",
    "warmup_messages",
    "bridge",
    "qos",
    "labels",
)
"""Fields that a report promises; `docs/trace-format.md` has all that a session and a run may have."""


def comparison_schema() -> Schema:
    """Return the schema of `dds-trace compare --report json`."""
    words, text = described(ComparisonInfo), {"type": "string"}
    level = {"type": "number", "minimum": 0, "maximum": 1, "description": "share of the messages that were due"}
    time = {"type": "number", "description": "time within which that share was received, ns"}
    side = a_list(
        an_object({"level": level, "ns": time}), "ascending; it ends where messages were lost, or are too few"
    )
    changes = of_comparison(COMPARISON_SCHEMA)["properties"] | {
        f"{side}_is_lost": {
            "type": "boolean",
            "description": f"whether {side}_ns is null because so many messages were lost",
        }
        for side in ("base", "new")
    }
    number = {"type": ["number", "null"]}
    group = {
        "label": {
            **text,
            "description": "its name in words; it follows what else was compared, so match by parameters",
        },
        "parameters": {"$ref": "#/$defs/parameters"},
        "verdict": {"enum": list(WORST_FIRST), "description": "what is said of the result"},
        "where": {**text, "description": "statistics or metrics of the verdict; empty if it holds for all"},
        "delivery": {**of_comparison(DELIVERY_SCHEMA), "description": "messages of both sides"},
        "changes": a_list(
            an_object(changes, {"base_typical_ns", "new_typical_ns"}), "one for each metric and statistic"
        ),
        "distributions": a_list(an_object({"metric": text, "base": side, "new": side}), "times at fixed shares"),
    }
    result = of_record(GateResult)["properties"]
    gate = {
        "gate": {**text, "description": "the gate as it was given"},
        "group": {**text, "description": "name of its result"},
    }
    gate |= {name: result[column] for name, column in comparison_document.FRAME_COLUMNS.items()}
    gate |= {"outcome": of_hint(GateOutcome), "smallest_ratio": number, "smallest_drop": number}
    ignored = [name for name in PARAMETER_NAMES if name in IGNORABLE_COLUMNS]
    options = of_record(CompareOptions)
    options["properties"]["match"]["items"] = {"enum": list(PARAMETER_NAMES)}
    alone = {"$ref": "#/$defs/alone"}
    properties: Schema = {
        "format": {"const": comparison_document.FORMAT_VERSION},
        "said": {**text, "description": words["answer"]},
        "seen": {**text, "description": words["seen"]},
        "changed": {
            "type": "boolean",
            "description": "whether a gate failed, or a result is faster, slower, lost or of one side only",
        },
        "outcome": {"enum": [*of_hint(GateOutcome)["enum"], None], "description": words["outcome"]},
        "options": {**options, "description": "how the sides were compared"},
        "sights": a_list(of_record(DetectableChange), words["sights"]),
        "groups": a_list(an_object(group), words["groups"]),
        "only_base": a_list(alone, words["only_base"]),
        "only_new": a_list(alone, words["only_new"]),
        "gates": a_list(an_object(gate), words["gates"]),
        "judgements": a_list(
            of_frame("judgements", judgement_frame(()), "rows")["items"],
            "what is said of each result, and the outcome of each gate, a row each; `group` counts the results in the order of their "
            "parameters",
        ),
        "unlike": a_list(of_record(Unlike), words["unlike"]),
        "ignore": a_list({"enum": ignored}, words["ignore"]),
        "notes": a_list(text, words["notes"]),
        "rules": a_list(text, words["rules"]),
    }
    return {
        "$schema": DIALECT,
        "title": f"dds-trace comparison, format {comparison_document.FORMAT_VERSION}",
        "description": (
            "What `dds-trace compare --report json` writes. A field may be added within a format; none is renamed or removed, "
            "and none changes its meaning."
        ),
        **an_object(properties, {"changed", "judgements"}),
        "$defs": {"parameters": parameters(), "alone": an_object({"label": text, "parameters": group["parameters"]})},
    }


SCHEMAS = {"reports/report.schema.json": report_schema, "extensions/gates/comparison.schema.json": comparison_schema}
"""File -> what makes it."""


def schema_text(schema: Schema) -> str:
    """Return a schema as it is in its file."""
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    for file, make in SCHEMAS.items():
        (ROOT / file).write_text(schema_text(make()), encoding="utf-8")
        print(f"Wrote {ROOT / file}")
