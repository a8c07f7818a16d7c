"""Topics that taps heard."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import polars as pl

from dds_trace.analyzer.analysis import Analysis
from dds_trace.analyzer.model.metrics import TOPIC_METRICS
from dds_trace.base.printable import printable
from dds_trace.base.units import MISSING, counted, format_duration, format_rate, format_ratio, mean_size
from dds_trace.extensions.bags.bounds import SHOWN
from dds_trace.extensions.bags.chains import TOGETHER_NS, Link, Stamped, chain_lines, find_links
from dds_trace.reports.blocks import (
    MARKDOWN,
    PAGE,
    TERMINAL,
    Column,
    Heading,
    Row,
    Section,
    Sentence,
    Span,
    Stack,
    Table,
    Words,
)
from dds_trace.reports.book.groups import format_count

from .streams import lost_words

MOST_SENTENCES = 6
MOST_ROWS = 200

CLOCK_WORDS = {
    "same": "one clock",
    "fit": "clocks fitted",
    "assumed": "assumes that the publisher runs here",
    "unknown": "no common clock",
}

TOPIC_COLUMNS = (
    Column("Topic", least=13),
    *map(Column, ("Way", "Rate", "Size", "Received")),
    *(Column(f"{label} p50, p99", media=TERMINAL) for label in TOPIC_METRICS.values()),
    *(Column(name, media=MARKDOWN | PAGE) for label in TOPIC_METRICS.values() for name in (f"{label} p50", "p99")),
    *map(Column, ("Clock", "Interval")),
)
HOW_TO_READ_TOPICS = (
    "One way: from publishing to the tap. Age: from the stamp of the header to the tap. Clock: the largest error of both by "
    "the clocks. Interval: the median between two messages ± its robust deviation."
)
HOP_COLUMNS = [*map(Column, ("Chain", "Hop", "p50", "p99", "Clock error"))]


def topic_sentences(analysis: Analysis) -> list[str]:
    rows = sorted(analysis.topics.to_dicts(), key=lambda row: row["ping_device"] == row["relay_device"])
    sentences = [_sentence(row) for row in rows[:MOST_SENTENCES]]
    if more := len(rows) - len(sentences):
        sentences.append(f"{counted(more, 'more topic is', 'more topics are')} in the table.")
    return [*sentences, *map(printable, chain_lines(topic_links(analysis), SHOWN))]


def topic_links(analysis: Analysis) -> list[Link]:
    types = dict(analysis.topics.select("topic", "message_type").iter_rows())
    heard = analysis.topic_messages.drop_nulls(["header_ns", "relay_in_ns"]).sort("relay_device", "relay_in_ns")
    links = []
    by_device = heard.partition_by("relay_device", maintain_order=True, as_dict=True)
    for (device,), at_tap in by_device.items():
        ages = at_tap.select("data_type", ahead=pl.col("header_ns") + pl.col("age_ns") - pl.col("relay_in_ns"))
        clocks = dict(ages.group_by("data_type").agg(pl.col("ahead").median()).drop_nulls().iter_rows())
        ahead_ns = next(iter(clocks.values()), 0)  # of the clock that stamps, before that of the arrivals
        stamped = []
        for (topic,), messages in at_tap.partition_by("data_type", as_dict=True).items():
            arrivals_ns = messages["relay_in_ns"].to_numpy() + round(ahead_ns)
            is_one = abs(clocks.get(topic, np.inf) - ahead_ns) < TOGETHER_NS
            name = f"{topic} on {device}" if len(by_device) > 1 else topic
            stamped.append(Stamped(name, types[topic], arrivals_ns, messages["header_ns"].to_numpy(), is_one))
        links += find_links(stamped)
    return links


def _sentence(row: Mapping[str, Any]) -> str:
    times = [
        f"{label.lower()} {format_duration(row[f'{metric}_p50_ns'])}"
        + ("" if row[f"{metric}_p99_ns"] is None else f" (p99 {format_duration(row[f'{metric}_p99_ns'])})")
        for metric, label in TOPIC_METRICS.items()
        if row[f"{metric}_p50_ns"] is not None
    ]
    bound = f" (± {format_duration(row['bound_ns'])} by the clocks)" if times and row["bound_ns"] else ""
    parts = [", ".join(times) + bound if times else f"no latency: {_clock(row)}", _received(row)]
    if row["reordered"]:
        parts.append(f"{format_count(row['reordered'])} out of order")
    return f"{printable(row['topic'])}, {_way(row)}: {'; '.join(parts)}."


def _received(row: Mapping[str, Any]) -> str:
    lost = row["published"] - row["received"]
    if not lost:
        return f"all of {counted(row['published'], 'message')} received"
    words = lost_words(row["subscribed"], row["offered"])
    return f"{format_count(lost)} of {format_count(row['published'])} messages {words}"


def _way(row: Mapping[str, Any]) -> str:
    sender, receiver = printable(row["ping_device"]), printable(row["relay_device"])
    return f"on {receiver}" if sender == receiver else f"{sender} → {receiver}"


def _clock(row: Mapping[str, Any]) -> str:
    return ", ".join(CLOCK_WORDS.get(word, word) for word in row["clock"].split(", "))


def topic_sections(analysis: Analysis) -> tuple[Section, ...]:
    topics = [*map(_topic_row, analysis.topics.head(MOST_ROWS).iter_rows(named=True))]
    hops = [*_hop_rows(analysis.topic_hops.head(MOST_ROWS))]
    tables = (
        ("Topics", HOW_TO_READ_TOPICS, TOPIC_COLUMNS, topics),
        ("Chains of topics", "Messages that carry the same header stamp from topic to topic.", HOP_COLUMNS, hops),
    )
    return tuple(
        Section([Heading(title), Table(columns, [*map(Row, rows)], label=title), Sentence(how, "how soft")])
        for title, how, columns, rows in tables
        if rows
    )


def _topic_row(row: Mapping[str, Any]) -> tuple[Words, ...]:
    bound = _clock(row) if row["bound_ns"] is None else f"± {format_duration(row['bound_ns'])}, {_clock(row)}"
    interval = (
        MISSING
        if row["period_p50_ns"] is None
        else f"{format_duration(row['period_p50_ns'])} ± {format_duration(row['jitter_ns'])}"
    )
    times = [[format_duration(row[f"{metric}_{name}_ns"]) for name in ("p50", "p99")] for metric in TOPIC_METRICS]
    return (
        printable(row["topic"]),
        _way(row),
        MISSING if row["rate_hz"] is None else format_rate(float(f"{row['rate_hz']:.3g}")),
        MISSING if row["message_bytes"] is None else mean_size(row["message_bytes"]),
        format_ratio(row["received_ratio"]),
        *(Stack([[Span(time, "")] for time in pair]) for pair in times),
        *(time for pair in times for time in pair),
        bound,
        interval,
    )


def _hop_rows(hops: pl.DataFrame) -> Iterator[tuple[str, ...]]:
    for row in hops.iter_rows(named=True):
        sender, receiver = printable(row["ping_device"]), printable(row["relay_device"])
        topic, following = printable(row["topic"]), printable(row["next_topic"])
        words = {
            "stamp": f"stamp of {topic} to publishing, on {sender}",
            "publish": f"{topic} to its reception, {_way(row)}",
            "receive": f"reception of {topic} to publishing of {following}, on {receiver}",
        }[row["from_event"]]
        bound = MISSING if not row["bound_ns"] else f"± {format_duration(row['bound_ns'])}"
        yield str(row["chain"] + 1), words, *(format_duration(row[name]) for name in ("p50_ns", "p99_ns")), bound
