"""`limits.toml`: what results have to meet, by result, and changes that are accepted; read for gates, and written from good runs."""

from __future__ import annotations

import glob
import json
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import polars as pl

from dds_trace.analyzer.exports.kinds import write_text_file
from dds_trace.analyzer.model.metrics import METRICS
from dds_trace.analyzer.model.names import group_words, varying_parameters
from dds_trace.analyzer.model.parameters import MATCH_COLUMNS
from dds_trace.analyzer.statistics.intervals import Interval
from dds_trace.base.errors import OptionError, OutputError
from dds_trace.base.files import read_settings
from dds_trace.base.limits import nearest, shown
from dds_trace.base.streams import say
from dds_trace.base.toml_table import TomlTable
from dds_trace.base.units import counted, format_duration, three_digits
from dds_trace.extensions.bags.card import OTHER_CLOCK_NS

from .compare import RECEIVED_RATIO, Comparison
from .gate import VALUES_OF_TOPICS, Against, Gate, parse_gates, parse_threshold
from .sections import TOPIC, Patterns, Sections, Threshold, read_thresholds

LEAST_ROOM, MOST_ROOM = 0.1, 9.0
LEAST_LOSS = 0.005
_NO_LIMIT = "# no limit of "


def read_limits(path: Path, *, of_recording: bool = False) -> list[Gate]:
    root = TomlTable.parse(read_settings(path, "a file of limits", "give --limits a file of limits"), str(path))
    root.allow("thresholds", "accepted")
    thresholds = list(read_thresholds(root.table("thresholds")))
    for table in root.tables("accepted"):
        why = [table.take(key, str, "") for key in ("reason", "commit")]
        if not all(why):
            raise OptionError(f"{table.where}: an accepted change has a reason and a commit")
        limits = {key: value for key, value in table.values.items() if key not in {"result", "reason", "commit"}}
        accepted = f"{why[0]} ({why[1]})"
        limits_table = replace(table, values=limits)
        result = table.take("result", str, "")
        thresholds += [replace(item, result=result, accepted=accepted) for item in read_thresholds(limits_table)]
    gates = gates_of(thresholds, str(path))
    if of_recording:
        topic_gates = gates_of((item for item in thresholds if _is_topic(item.result)), str(path))
        values = (*VALUES_OF_TOPICS, RECEIVED_RATIO)
        return [gate for gate in limits_of_one_side(topic_gates) if gate.name in values]
    return [gate for gate in gates if gate.metric not in VALUES_OF_TOPICS]


def gates_of(thresholds: Iterable[Threshold], where: str) -> list[Gate]:
    gates: list[Gate] = []
    sections = Sections()
    for threshold in thresholds:
        patterns = _patterns(threshold.result, where)
        for condition in threshold.conditions:
            gate = parse_threshold(threshold.metric, condition, patterns)
            sections.add(patterns, gate.kind, len(gates))
            by_result = replace(gate, results=patterns, sections=sections, order=len(gates))
            gates.append(replace(by_result, accepted=threshold.accepted))
    return gates


def _is_topic(result: str) -> bool:
    return result.startswith(("/", "topic="))


def _patterns(result: str, where: str) -> Patterns:
    if _is_topic(result):
        return ((TOPIC, result.removeprefix(f"{TOPIC}=")),)
    words = [word.partition("=") for word in re.split(r"(?<! ) +(?=\w+=)", result.strip(" ")) if word]
    for column, equals, _ in words:
        if not equals or column not in MATCH_COLUMNS:
            raise OptionError(
                f"{where}: {shown(result)} names no result: write COLUMN=PATTERN ..., or a topic; "
                f"{nearest(column, MATCH_COLUMNS)}"
            )
    return tuple((column, pattern) for column, _, pattern in words)


def limits_text(comparison: Comparison) -> str:
    names = varying_parameters(comparison.delivery, comparison.options.match)
    sections: dict[str, list[str]] = {}
    for row, change in zip(comparison.rows.iter_rows(named=True), comparison.changes, strict=True):
        if (row["metric"], row["statistic"]) in {("latency", "p50"), ("latency", "p99"), ("age", "p99")}:
            key = _section(group_words(_quoted(row), names))
            sections.setdefault(key, []).append(_limit_of_time(f"{row['metric']}_{row['statistic']}", change.new))
    for row, delivery in zip(comparison.delivery.iter_rows(named=True), comparison.deliveries, strict=True):
        share = delivery.new
        if share.value is not None and share.lower is not None:
            least = share.value - max(LEAST_LOSS, 2 * (share.value - share.lower))
            line = f'received_ratio = "> {math.floor(1000 * max(0.0, least)) / 10:g} %"'
            sections.setdefault(_section(group_words(_quoted(row), names)), []).append(line)
    return _text(sections)


def topic_limits_text(topics: pl.DataFrame) -> str:
    sections: dict[str, list[str]] = {}
    high = pl.col("missing_high")
    worst = topics.group_by("topic", maintain_order=True).agg(
        pl.col("rate_hz").min(),
        (high / (pl.col("messages") + high)).max().alias("missing"),
        pl.col("age_p99_ns").filter(pl.col("no_age").is_null()).max(),
    )
    for topic, rate_hz, missing, age_ns in worst.iter_rows():
        lines = sections.setdefault(_section(("" if topic.startswith("/") else "topic=") + glob.escape(topic)), [])
        if missing is not None and rate_hz:
            lines.append(f'rate = "> {three_digits((1 - LEAST_ROOM) * rate_hz)} Hz"')
            lines.append(f'missing = "< {math.ceil(1000 * max(LEAST_LOSS, 2 * missing)) / 10:g} %"')
        if age_ns is not None and 0 < age_ns < OTHER_CLOCK_NS:
            lines.append(f'age_p99 = "< {_time_above(1.5 * age_ns)}"')
    return _text({key: lines for key, lines in sections.items() if lines})


def _text(sections: Mapping[str, Sequence[str]]) -> str:
    head = "# Written by `--write-limits` from good runs; docs/how-to/ci.md says what may be in it.\n"
    return head + "".join(f"\n{key}\n" + "".join(f"{line}\n" for line in lines) for key, lines in sections.items())


def _quoted(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row with its texts as patterns of themselves; a blank that a section would be split at is a class."""
    texts = {name: glob.escape(value) for name, value in row.items() if isinstance(value, str)}
    return {**row, **{name: re.sub(r"^ | (?=\w+=|$)", "[ ]", text) for name, text in texts.items()}}


def _section(words: str) -> str:
    """Return the head of a table; TOML has no escapes of two halves, as JSON has, and no plain DEL."""
    key = json.dumps(words, ensure_ascii=False).replace("\x7f", "\\u007f")
    return f"[thresholds.{key}]"


def _limit_of_time(metric: str, new: Interval) -> str:
    if not new.value or not new.upper or math.isinf(new.upper):
        why = "too much was lost" if new.upper == math.inf else "too few messages or runs; record more"
        return f"{_NO_LIMIT}{metric}: {why}"
    # Of n runs the reach of the mean, times sqrt(n + 1), is that of a single further run.
    room = max(LEAST_ROOM, (new.upper / new.value) ** math.sqrt(new.units + 1) - 1)
    if room > MOST_ROOM:
        return f"{_NO_LIMIT}{metric}: the runs differ too much"
    return f'{metric} = ["< {_time_above(new.value * (1 + room))}", "< +{5 * math.ceil(20 * room):g} %"]'


def _time_above(limit_ns: float) -> str:
    digits = 10 ** (math.floor(math.log10(limit_ns)) - 1)
    return format_duration(math.ceil(limit_ns / digits) * digits).replace("µs", "us")


def write_limits(text: str, path: Path) -> None:
    if path.exists():
        raise OutputError(f"{path} exists already; give another --write-limits")
    say(f"Wrote {write_text_file(path, text)}")
    missing = Counter(line for line in text.splitlines() if line.startswith(_NO_LIMIT))
    for line, count in missing.items():
        say(f"{line.removeprefix('# ')} (in {counted(count, 'result')})")


def limits_of_one_side(gates: Sequence[Gate]) -> list[Gate]:
    return [gate for gate in gates if gate.against is Against.NEW]


def read_gates(
    texts: list[str], limits_file: Path | None, *, one_side: bool = False, needed: bool = False
) -> list[Gate]:
    gates = parse_gates(texts)
    if one_side and (limits_of_one_side(gates) != gates or (needed and not gates and limits_file is None)):
        raise OptionError("without NEW give limits of one side, such as --fail-if 'latency_p99 > 20ms', or name NEW")
    more = [] if limits_file is None else read_limits(limits_file)
    more = limits_of_one_side(more) if one_side else more
    if limits_file is not None and not more:
        side_words = " of one side" if one_side else ""
        raise OptionError(f"{limits_file}: has no limit{side_words} for results; write one, or leave out --limits")
    return [*gates, *more]


def topic_limits(texts: list[str]) -> list[Gate]:
    """Return the limits of `analyze`, of topics only; an `OptionError` for others."""
    gates = parse_gates(texts)
    if any(gate.against is not Against.NEW or gate.metric in METRICS for gate in gates):
        raise OptionError(
            "--fail-if takes limits of topics here, such as 'age_p99(/camera/image) > 50ms'; limits of latency: "
            "dds-trace compare RUNS --fail-if 'latency_p99 > 20ms'"
        )
    return gates
