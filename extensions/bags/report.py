"""The report of the health of recordings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeAlias

from markupsafe import Markup

from dds_trace.base.printable import printable
from dds_trace.base.units import (
    SECOND_NS,
    clock_words,
    counted,
    first_of,
    format_duration,
    format_rate,
    format_ratio,
    mean_size,
    utc_words,
)
from dds_trace.reports import blocks
from dds_trace.reports.blocks import (
    EVERYWHERE,
    MARKDOWN,
    PAGE,
    TERMINAL,
    Block,
    Column,
    Heading,
    Points,
    Row,
    Section,
    Sentence,
    Span,
    Table,
)
from dds_trace.tracefile.format.events import TOPIC_PREFIX

from .analyze import TopicReport
from .bounds import FEWEST, NOTICED_NS, SHOWN
from .card import STRIP_PARTS, WHOLE, RecordingHealth
from .chains import chain_lines
from .losses import quiet_ns
from .observations import READ_BY
from .read import UNCOUNTED

if TYPE_CHECKING:
    from .limits import JudgedTopic

TopicRow = Mapping[str, Any]

COLUMNS = ("Topic", "Messages", "Rate", "Missing", "Gap", "Covered", "Jitter", "Size", "Age")
HOW_TO_READ = (
    "Rate: the mean, holes included. Missing: messages that should be there, by stamps, numbers or the usual rate; a range where these "
    "disagree, - where none of them can show it. Gap: the longest interval. A hole begins when its first message was due, a period after its "
    "gap does. Covered: the share of the recording's time without holes. Jitter: typical deviation of an interval; a hole does not change it. Age: median from the header's stamp, or (publish) from publishing, to the recording; between two "
    "machines it includes the difference of their clocks."
)


def seconds_words(seconds: float) -> str:
    if seconds < 120:
        return format_duration(seconds * 1e9)
    return f"{int(seconds) // 60} min {int(seconds) % 60} s"


def _share_words(share: float) -> str:
    return format_ratio(round(share, 3))


def verdict_words(health: RecordingHealth, rows: Sequence[TopicRow]) -> str:
    rows = [row for row in rows if not row["topic"].startswith(TOPIC_PREFIX)]
    lacking = [row for row in rows if row["missing_low"]]
    missing = sum(row["missing"] for row in lacking)
    sentence = f"{missing:,} {'message is' if missing == 1 else 'messages are'} missing on {len(lacking)} of {counted(len(rows), 'topic')}"
    if health.verdict == "damaged":
        words = "Damaged: `dds-trace recover` copies what can be read."
        return f"{words} {sentence}, in the damage or lost before." if lacking else words
    if health.verdict == "empty":
        return "No message was recorded."
    if health.verdict == "holes":
        more = f", and {health.gone:,} of topics that have none here" if health.gone else ""
        return f"Holes: {sentence}{more}."
    if not rows:
        return "Only topics of dds-trace itself: `dds-trace analyze` reads them."
    topics, unseen = counted(len(rows), "topic"), len(rows) - health.readable
    blind = f"{counted(unseen, 'topic has', 'topics have')} no steady rate"
    if not health.readable:
        return f"No loss can be seen: {blind}."
    readable = f"{health.readable} of " if unseen else ""
    what = " of what was recovered" if is_uncounted(health) else ""
    words = f"No loss found on {readable}{topics} in {seconds_words(health.duration_ns / SECOND_NS)}{what}."
    if most := [row["missing_high"] for row in rows if row["missing_high"]]:
        words = f"No loss is proven: up to {counted(sum(most), 'message')} may be missing on {len(most)} of {topics}."
    return words + (f" {blind}, so losses there cannot be seen." if unseen else "")


def is_uncounted(health: RecordingHealth) -> bool:
    return any(note.endswith(UNCOUNTED) for note in health.notes)


def ends_ns(row: TopicRow, health: RecordingHealth) -> tuple[int, int]:
    before_ns = row["start_ns"] - health.start_ns
    return before_ns, health.duration_ns - before_ns - row["duration_ns"]


def ended_words(health: RecordingHealth, rows: Sequence[TopicRow]) -> str:
    steady = [row for row in rows if row["expected_rate_hz"]]
    ends = [(ends_ns(row, health), row["topic"], quiet_ns(SECOND_NS / row["expected_rate_hz"])) for row in steady]
    words = " W" + UNCOUNTED[1:] + "." if is_uncounted(health) else ""
    for side, (verb, when, how) in enumerate((("begin", "after", "late"), ("end", "before", "early"))):
        silences = [(silent_ns[side], topic) for silent_ns, topic, usual_ns in ends if silent_ns[side] > usual_ns]
        if silences:
            (silent_ns, topic), more = max(silences), len(silences) - 1
            others = f", and {counted(more, f'more topic {verb}s', f'more topics {verb}')} {how}" if more else ""
            words += f" {printable(topic)} {verb}s {seconds_words(silent_ns / SECOND_NS)} {when} the recording{others}."
    return words


def facts_words(health: RecordingHealth, topics: int) -> str:
    chunks = f", {counted(health.chunks, 'chunk')}" if health.chunks else ""
    if not health.messages:
        return f"0 messages{chunks}"
    return (
        f"{seconds_words(health.duration_ns / SECOND_NS)} from {utc_words(health.start_ns)}, {counted(health.messages, 'message')}, "
        f"{counted(topics, 'topic')}{chunks}"
    )


def pause_lines(health: RecordingHealth) -> Iterator[str]:
    longest = sorted(zip(health.pauses, health.doubtful, strict=True), key=lambda pause: -pause[0][1])
    for (start_s, duration_s), is_doubtful in sorted(longest[:SHOWN]):
        why = (
            "the publishers or the recorder were paused, or messages were lost"
            if is_doubtful
            else "lost in the recorder or on the way to it, or it was paused"
        )
        why = f"in the damage, {why}" if health.verdict == "damaged" else why
        yield f"all topics: nothing for {seconds_words(duration_s)} at {clock_words(start_s)}: {why}"
    others = longest[SHOWN:]
    if others:
        yield f"and {counted(len(others), 'more pause')} of all topics, of up to {seconds_words(others[0][0][1])}"


def hole_lines(row: TopicRow, holes: Sequence[TopicRow], health: RecordingHealth) -> Iterator[str]:
    period_s = 1 / row["expected_rate_hz"] if row["expected_rate_hz"] else 0.0
    end_s = health.duration_ns / SECOND_NS
    before_ns, after_ns = ends_ns(row, health)
    if holes and holes[0]["start_s"] == 0 and not holes[0]["missing"]:
        yield f"begins at {clock_words(before_ns / SECOND_NS)}, not with the recording"
        holes = holes[1:]
    if holes and abs(holes[-1]["start_s"] + holes[-1]["duration_s"] - end_s) < period_s and not holes[-1]["missing"]:
        yield f"ends at {clock_words(end_s - after_ns / SECOND_NS)}, {seconds_words(after_ns / SECOND_NS)} before the recording"
        holes = holes[:-1]
    is_unsure = row["missing_low"] == 0 < row["missing_high"]
    least_s = max((1 + 1 / 2) * period_s, is_unsure)  # shorter ones are single messages
    large = sorted((hole for hole in holes if hole["duration_s"] > least_s), key=lambda hole: -hole["duration_s"])
    shown = sorted(large[:SHOWN], key=lambda hole: hole["start_s"])
    for hole in shown:
        inside = ", as of all topics" if hole["inside"] else ""
        count = counted(hole["missing"], "message") if hole["missing"] else "none was sent"
        low = 0 if is_unsure else hole["missing_low"]
        if low < hole["missing"]:
            count = f"{low:,} to {counted(hole['missing'], 'message')}"
        yield f"{_hole_words(hole)} ({count}{inside})"
    elsewhere = (row["missing"] or 0) - sum(hole["missing"] for hole in shown)
    is_counted = row["missing_from"] == "original" or (row["missing_from"] in {"tap", "recorder"} and not shown)
    if elsewhere > 0 and not is_unsure and not is_counted:
        lengths_s = [hole["duration_s"] for hole in holes if hole not in shown]
        where = f", in holes of up to {seconds_words(max(lengths_s))}" if lengths_s else ""
        yield f"{elsewhere:,} {'more ' if shown else ''}{'message is' if elsewhere == 1 else 'messages are'} missing{where}"


def _hole_words(hole: TopicRow) -> str:
    what = "missing" if hole["missing_low"] else "nothing"
    return f"{what} for {seconds_words(hole['duration_s'])} at {clock_words(hole['start_s'])}"


def missing_words(row: TopicRow) -> str:
    missing, low, high = row["missing"], row["missing_low"], row["missing_high"]
    if missing is None:
        return "-"
    share = f" ({_share_words(missing / (row['messages'] + missing))})" if missing and low else ""
    return f"{missing:,}{share}" if low == high else f"{low:,} to {high:,}{share}"


def age_words(row: TopicRow) -> str:
    median_ns, resolution_ns = row["age_p50_ns"], row["age_resolution_ns"] or 0
    if row["no_age"] is not None or median_ns is None:
        return row["no_age"] or ""
    start_ns, end_ns = row["age_start_ns"], row["age_end_ns"]
    if 0 <= median_ns < resolution_ns:
        age = f"below {format_duration(resolution_ns)}"
    elif abs(end_ns - start_ns) > max(NOTICED_NS, min(abs(start_ns), abs(end_ns))):
        age = f"{format_duration(start_ns)} to {format_duration(end_ns)}"
    else:
        age = format_duration(median_ns)
    if row["age_bound_ns"] is not None:
        return f"{age} ± {format_duration(row['age_bound_ns'])}"
    return age if row["age_from"] == "header" else f"{age} ({row['age_from']})"


def rate_words(row: TopicRow) -> str:
    return "" if row["rate_hz"] is None else format_rate(row["rate_hz"])


def cells(row: TopicRow, strip: Sequence[float]) -> tuple[str, ...]:
    return (
        printable(row["topic"]),
        f"{row['messages']:,}",
        rate_words(row),
        missing_words(row),
        "" if row["gap_max_ns"] is None else format_duration(row["gap_max_ns"]),
        _share_words(sum(strip) / len(strip)) if row["expected_rate_hz"] else "",
        "" if row["jitter_ns"] is None else format_duration(row["jitter_ns"]),
        mean_size(row["payload_mean_bytes"]),
        age_words(row),
    )


def topic_notes(row: TopicRow, health: RecordingHealth) -> Iterator[str]:
    if row["missing_low"] and row["expected_rate_hz"]:
        yield f"{format_rate(row['expected_rate_hz'])} while no message is missing"
    if row["missing_low"] and row["missing_from"] != "period":
        yield f"{counted(row['missing'], 'message')} missing {READ_BY[row['missing_from']]}"
    if row["missing_inside"] and row["missing_low"] and not row["lost_in_recorder"]:
        yield f"{row['missing_inside']:,} of them while nothing of any topic came"
    if row["lost_in_transport"] or row["lost_in_recorder"]:
        who = "the tap" if row["missing_from"] == "tap" else "rosbag2"
        yield f"{who} counted {row['lost_in_transport']:,} lost on the way to it and {row['lost_in_recorder']:,} inside"
    if row["burst_messages"]:
        burst, pause = format_duration(row["burst_ns"]), format_duration(row["burst_pause_ns"])
        yield f"comes in bursts: {row['burst_messages']:,} messages in {burst}, then {pause} of nothing"
    if row["age_p50_ns"] is not None and row["no_age"] is None:
        yield from _age_notes(row, health)
    if row["stamps_backwards"]:
        yield f"{counted(row['stamps_backwards'], 'header stamp')} {'runs' if row['stamps_backwards'] == 1 else 'run'} backwards"


def _age_notes(row: TopicRow, health: RecordingHealth) -> Iterator[str]:
    unit_ns = row["age_resolution_ns"] or 0
    if row["age_p50_ns"] < FEWEST * unit_ns:
        unit = format_duration(unit_ns)
        is_below = row["age_p50_ns"] < unit_ns
        unsure = "an age below that is unknown" if is_below else f"its ages are up to {unit} too long, or too short"
        yield f"its stamps are in units of {unit}: {unsure}"
    if row["age_max_ns"] > 2 * max(row["age_p50_ns"], NOTICED_NS):
        first, last, most = (format_duration(row[f"age_{name}_ns"]) for name in ("start", "end", "max"))
        at = clock_words((row["age_max_at_ns"] - health.start_ns) / SECOND_NS)
        yield f"its age is {first} at the start, {last} at the end, {most} at most, at {at}"
    if row["age_negative"] and -row["age_min_ns"] > unit_ns:
        stamped = "the header's stamp" if row["age_from"] == "header" else "they were published"
        yield f"{counted(row['age_negative'], 'message')} logged before {stamped}: two clocks, or a stamp of the future"


_Topic: TypeAlias = tuple[TopicRow, Sequence[TopicRow], Sequence[float]]


_RENAMED = {"topic": "name", "stamps_backwards": "backward_stamps"}
_OF_HOLE = ("start_s", "duration_s", "missing", "missing_low", "inside")
_TONES = {"whole": "decided", "unknown": "open", "holes": "lossy", "empty": "lossy", "damaged": "lossy"}
_LEVELS = "·▁▂▃▄▅▆▇█"


@dataclass(frozen=True)
class BagReport(blocks.Report):
    report: TopicReport
    judged: Sequence[JudgedTopic] = ()
    name = "topics"
    title: str = "Is this bag whole?"
    kicker = "Topics of recordings"

    @cached_property
    def _topics(self) -> dict[str, list[_Topic]]:
        report, holes = self.report, dict[tuple[str, str], list[TopicRow]]()
        for hole in report.holes.iter_rows(named=True):
            holes.setdefault((hole["recording"], hole["topic"]), []).append(hole)
        topics: dict[str, list[_Topic]] = {health.path: [] for health in report.recordings}
        for row, strip in zip(report.topics.iter_rows(named=True), report.strips, strict=True):
            topics[row["recording"]].append((row, holes.get((row["recording"], row["topic"]), []), strip))
        return topics

    @property
    def document(self) -> Mapping[str, Any]:
        report = self.report
        return {
            "format": 1,
            "verdict": report.verdict,
            "recordings": [
                {
                    **asdict(health),
                    "pauses": [{"start_s": start, "duration_s": length} for start, length in health.pauses],
                }
                for health in report.recordings
            ],
            "topics": [
                {
                    **{_RENAMED.get(name, name): value for name, value in row.items()},
                    "holes": [{name: hole[name] for name in _OF_HOLE} for hole in holes],
                    "strip": [round(share, 4) for share in strip],
                }
                for health in report.recordings
                for row, holes, strip in self._topics[health.path]
            ],
            "observations": report.observations.rows(named=True),
            "chains": [{"recording": path} | asdict(link) for path, link in report.links],
            "syncs": [{"recording": path} | asdict(sync) for path, sync in report.syncs],
            "gates": gate_rows(self.judged),
            "sources": report.sources,
        }

    @property
    def sections(self) -> Sequence[Section]:
        recordings = enumerate(self.report.recordings, 1)
        parts = [Section([*self._recording(health)], f"recording-{number}") for number, health in recordings]
        gates = judged_blocks(self.judged) if self.judged else []
        limits = Section([Heading("Limits"), *gates] if gates else [], "gates", media=PAGE)
        title = Section([Heading("Are these recordings whole?", 1, media=MARKDOWN)])
        how = Section([Sentence(HOW_TO_READ, "soft")] if self.report.topics.height else [])
        return [title, *parts, limits, Section(gates, media=TERMINAL | MARKDOWN), how]

    def _recording(self, health: RecordingHealth) -> Iterator[Block]:
        topics = sorted(self._topics[health.path], key=lambda topic: topic[0]["topic"].startswith(TOPIC_PREFIX))
        rows = [row for row, _, _ in topics]
        ended = ended_words(health, rows)
        yield Heading(printable(health.path))
        yield Sentence(
            verdict_words(health, rows) + ended,
            f"headline {'open' if ended and health.verdict == WHOLE else _TONES[health.verdict]}",
        )
        yield Sentence(facts_words(health, len(rows)), "facts")
        chains = chain_lines([link for path, link in self.report.links if path == health.path], SHOWN)
        syncs = [sync.words for path, sync in self.report.syncs if path == health.path]
        damages = first_of(health.damages, SHOWN, "more like these")
        lines = [*pause_lines(health), *damages, *health.notes, *chains, *syncs]
        yield Points([*map(printable, lines)])
        if not rows:
            return
        topic, *numbers = COLUMNS
        least = min(28, max((len(row["topic"]) for row in rows), default=0))
        names = [Column(topic, least=least, media=TERMINAL | MARKDOWN), Column(topic, media=PAGE)]
        columns = [*names, *(Column(name, right=True) for name in numbers)]
        drawn = [_row(health, *topic) for topic in topics]
        yield Table(columns, drawn, label="Table of the topics", look="groups cards", parted=EVERYWHERE)
        colors = [("there", "messages"), ("hole", "missing"), ("inside", "missing on all topics at once")]
        colors += [("gap", "nothing came, not counted"), ("some", "not periodic")]
        yield blocks.Key([("", f"00:00 to {_end(health)}"), *colors], media=PAGE)


def _end(health: RecordingHealth) -> str:
    return clock_words(health.duration_ns / SECOND_NS)


def _row(health: RecordingHealth, row: TopicRow, holes: Sequence[TopicRow], strip: Sequence[float]) -> Row:
    lines = [*hole_lines(row, holes, health), *topic_notes(row, health)]
    first, *others = cells(row, strip)
    words = f"{first}: time from 00:00 to {_end(health)}, {'; '.join(lines) or 'without holes'}"
    is_periodic = row["missing_from"] != ""
    text = "".join(_LEVELS[int(share * 8)] if is_periodic else "▪" if share else " " for share in strip)
    short = "".join(map(min if is_periodic else max, text[::2], text[1::2]))
    figure = blocks.Figure(text, _strip_svg(words, strip_parts(health, row, holes, strip)), short)
    with_qos = blocks.stack(Span(first, ""), Span(printable(row["qos"]), "soft"))
    part = "Of dds-trace itself: `dds-trace analyze` reads them" if row["topic"].startswith(TOPIC_PREFIX) else ""
    return Row([first, with_qos, *others], part=part, figure=figure, notes=lines)


def _strip_svg(words: str, parts: Sequence[tuple[float, float, str, str]]) -> Markup:
    block = Markup('<rect class="{}" x="{}" width="{}" height="18">{}</rect>')
    drawn = [
        block.format(kind, x, width, Markup("<title>{}</title>").format(title) if title else "")
        for x, width, kind, title in parts
    ]
    return Markup(
        '<svg class="time" viewBox="0 0 {0} 18" preserveAspectRatio="none" role="img" aria-label="{1}">'
        '<rect class="track" width="{0}" height="18"/>{2}</svg>'
    ).format(STRIP_PARTS, words, Markup().join(drawn))


def strip_parts(
    health: RecordingHealth, row: TopicRow, holes: Sequence[TopicRow], strip: Sequence[float]
) -> list[tuple[float, float, str, str]]:
    scale = STRIP_PARTS / max(health.duration_ns / SECOND_NS, 1e-9)
    if not row["missing_from"]:
        return [(at, 1, "some", "") for at, share in enumerate(strip) if share]
    start = (row["start_ns"] - health.start_ns) / 1e9 * scale
    width = row["duration_ns"] / 1e9 * scale
    drawn = [(round(start, 2), round(width, 2), "there", "")]
    for hole in holes:
        if not row["missing_low"] and hole["duration_s"] <= 1:
            continue
        counted_as = "inside" if hole["inside"] else "hole"
        kind, width = counted_as if hole["missing_low"] else "gap", round(max(hole["duration_s"] * scale, 0.1), 2)
        drawn.append((round(hole["start_s"] * scale, 2), width, kind, _hole_words(hole)))
    return drawn


def gate_rows(judged: Sequence[JudgedTopic]) -> list[dict[str, str]]:
    return [
        {
            "gate": gated.result.gate.text,
            "recording": gated.recording,
            "topic": gated.result.subject,
            "outcome": gated.result.outcome.value,
        }
        for gated in judged
    ]


def judged_blocks(judged: Sequence[JudgedTopic]) -> list[Block]:
    from dds_trace.extensions.gates.report import gate_blocks  # noqa: PLC0415 - only with limits

    return [*gate_blocks(judged, None)]
