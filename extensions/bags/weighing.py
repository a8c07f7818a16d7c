"""All evidence of one recording: what each topic's messages show, lowered by what its neighbours show."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np

from dds_trace.base.units import UNIT_NS, counted, format_duration
from dds_trace.tracefile.format.events import TOPIC_PREFIX

from .bounds import FEWEST, MOST
from .clocks import SIMULATED_BEFORE_NS, Clocks, Note, Stamps, count_history, of_realsense, read_clocks
from .losses import Losses, TopicTimes, agreed
from .neighbours import doubted, find_silent, moved_on, set_clocks, stood_still, without_stretches
from .periods import Int64
from .quantiles import median
from .recorded import NONE


@dataclass(frozen=True, slots=True)
class Source:
    """The topic of some messages; a volatile topic keeps no history for those who join later."""

    name: str
    is_volatile: bool = False

    @property
    def is_of_tap(self) -> bool:
        return self.name.startswith(TOPIC_PREFIX)


@dataclass(slots=True)
class Evidence:
    """By topic: its live messages, how many were sent earlier, and its losses; and the clocks. `readable` topics could have shown a loss."""

    times: list[TopicTimes]
    history: list[int]
    clocks: Clocks
    losses: list[Losses] = field(default_factory=list)
    readable: int = 0


def weigh(times: Sequence[TopicTimes], sources: Sequence[Source], logged: Int64) -> Evidence:
    """Read the evidence of the topics of one recording; `logged` are its log times, ascending, of one clock."""
    evidence = Evidence([*times], [0] * len(times), Clocks())
    start_ns, end_ns = int(logged[0]), int(logged[-1])
    stamped = _take_history(evidence, sources, start_ns)
    earlier_notes = evidence.clocks.notes
    unstamped = [topic.log_ns for number, topic in enumerate(times) if number not in stamped]
    live = {sources[n].name: topic for n, topic in stamped.items() if evidence.history[n] < len(times[n].log_ns)}
    clocks = read_clocks(live, unstamped, start_ns, _tick_ns(logged))
    clocks.notes = earlier_notes + clocks.notes
    evidence.clocks = clocks
    _name_writers(evidence, sources, stamped)
    copies = clocks.reasons.get("copy", [])
    is_named = "zero" in clocks.reasons or (copies and of_realsense(copies))
    if start_ns < SIMULATED_BEFORE_NS and not is_named:
        clocks.notes.append(Note("the log times are of a simulation's clock, or count from the start of a machine"))
    silent = find_silent(logged, len(times))
    by_topic = [
        [] if source.is_of_tap else topic.readings(end_ns - start_ns, silent)
        for source, topic in zip(sources, evidence.times, strict=True)
    ]
    unmoved = silent.at(~moved_on(evidence.times, silent)[1])
    set_over, notes = set_clocks(by_topic, unmoved, start_ns)
    clocks.notes += notes
    for stretches in (clocks.set_over, stood_still(evidence.times, silent), set_over):
        by_topic = [without_stretches(readings, stretches) for readings in by_topic]
    by_topic = doubted(by_topic, silent)
    pairs = [*zip(by_topic, evidence.times, strict=True)]
    evidence.losses = [agreed(readings, start_ns, end_ns, topic.log_ns) for readings, topic in pairs]
    evidence.readable = sum(
        not source.is_of_tap and bool(readings) for readings, source in zip(by_topic, sources, strict=True)
    )
    return evidence


def _take_history(evidence: Evidence, sources: Sequence[Source], start_ns: int) -> dict[int, Stamps]:
    """Take messages that were sent before the recording out of the times; return the stamps of the others."""
    stamped: dict[int, Stamps] = {}
    for number, topic in enumerate(evidence.times):
        has_stamp = topic.stamp_ns != NONE
        if has_stamp.any():
            keys = topic.frame ^ topic.publisher
            stamped[number] = Stamps(topic.log_ns[has_stamp], topic.stamp_ns[has_stamp], keys[has_stamp])
    ages_ns = [median(topic.age_ns) for topic in stamped.values() if len(topic.log_ns) >= FEWEST]
    usual_ns = median(ages_ns) if ages_ns else 0.0
    for number, stamps in stamped.items():
        count = 0 if sources[number].is_volatile else count_history(stamps, start_ns, usual_ns)
        if not count:
            continue
        evidence.history[number] = count
        live_ns = median(stamps.age_ns[count:]) if count < len(stamps.log_ns) else usual_ns
        oldest, was = format_duration(float(stamps.age_ns[:count].max()) - live_ns), "was" if count == 1 else "were"
        words = (
            f"{counted(count, 'message')} of {sources[number].name} {was} sent up to {oldest} earlier: history of transient-local topics "
            "of nodes that started earlier, not an age"
        )
        evidence.clocks.notes.append(Note(words, sources[number].name))
        if count < len(stamps.log_ns):
            stamped[number] = stamps.from_message(count)
            first = int(np.searchsorted(evidence.times[number].log_ns, stamps.log_ns[count]))
            evidence.times[number] = evidence.times[number].from_message(first)
    return stamped


def _name_writers(evidence: Evidence, sources: Sequence[Source], stamped: Collection[int]) -> None:
    clocks = evidence.clocks
    for number, (source, topic) in enumerate(zip(sources, evidence.times, strict=True)):
        if number not in stamped and _is_of_writer(topic):
            clocks.no_age[source.name] = ""
            words = f"publish times of {source.name} are at or after its log times: the writer's, not an age"
            clocks.notes.append(Note(words, source.name))
        elif evidence.history[number] >= len(topic.log_ns):
            clocks.no_age[source.name] = "latched"


def _is_of_writer(times: TopicTimes) -> bool:
    """Return whether publish times differ from log times, and nearly none is earlier: a writer took them after the log time."""
    published = times.publish_ns != NONE
    publish_ns, log_ns = times.publish_ns[published], times.log_ns[published]
    return bool((publish_ns != log_ns).any() and (publish_ns >= log_ns).sum() >= MOST * len(log_ns))


def _tick_ns(logged: Int64) -> int:
    """Return the ticks of log times that are multiples of one, with several messages each; 0 of finer clocks."""
    if len(logged) < FEWEST:
        return 0
    is_repeated = np.diff(logged) == 0
    tick_ns = int(np.gcd.reduce(logged))
    return tick_ns if tick_ns >= UNIT_NS["ms"] and 2 * 2 * is_repeated.sum() > len(logged) else 0
