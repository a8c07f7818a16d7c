"""Checks of the files: what was skipped, cut, copied or recovered."""

from __future__ import annotations

from collections.abc import Iterator

from dds_trace.base.units import counted
from dds_trace.tracefile.reading.trace import Trace

from ..model.finding import Severity, Subject
from .evidence import Evidence, Observation, check, some


@check(
    "skipped_file",
    Severity.WARNING,
    Subject.FILE,
    "If this should be a trace, look at it with `mcap doctor`; else move it elsewhere.",
)
def skipped_traces(evidence: Evidence) -> Iterator[Observation]:
    """An .mcap file was not used."""
    for source in evidence.campaign.sources:
        if source.status == "skipped" and source.path.endswith(".mcap"):
            yield Observation(source.path, f"Not used: {source.detail}.")


@check("skipped_file", Severity.INFO, Subject.FILE, "Nothing to do, unless one of them should be a trace.")
def skipped_files(evidence: Evidence) -> Iterator[Observation]:
    """Other files were not used."""
    others = [
        source.path
        for source in evidence.campaign.sources
        if source.status == "skipped" and not source.path.endswith(".mcap")
    ]
    if others:
        yield Observation(some(others, 10), f"{len(others)} of the files here are not traces and were not used.")


def _named_traces(evidence: Evidence) -> Iterator[tuple[str, Trace]]:
    return ((evidence.campaign.name(index), trace) for index, trace in enumerate(evidence.campaign.traces))


@check(
    "truncated_file",
    Severity.WARNING,
    Subject.FILE,
    "Messages near the end may count as lost though they were not: record again if that matters.",
)
def truncated_files(evidence: Evidence) -> Iterator[Observation]:
    """A file ends early."""
    for name, trace in _named_traces(evidence):
        if trace.truncated:
            yield Observation(name, f"The file ends early ({trace.truncated}); everything before that was used.")


@check("unreadable_messages", Severity.WARNING, Subject.FILE, "Compare what wrote the file with docs/trace-format.md.")
def unreadable_messages(evidence: Evidence) -> Iterator[Observation]:
    """Messages on event topics are not events."""
    for name, trace in _named_traces(evidence):
        if trace.unreadable_messages:
            what = counted(
                trace.unreadable_messages,
                "message on an event topic is not an event and was not used.",
                "messages on event topics are not events and were not used.",
            )
            yield Observation(name, what)


@check("ring_recovered", Severity.INFO, Subject.FILE, "Nothing to do; keep the ring file in the trace's folder.")
def recovered_events(evidence: Evidence) -> Iterator[Observation]:
    """Events were recovered from the ring of a killed recorder."""
    for name, trace in _named_traces(evidence):
        if trace.ring_events:
            events = counted(trace.ring_events, "event comes", "events come")
            yield Observation(name, f"{events} from the ring that a killed recorder left next to the file.")


@check("duplicate_file", Severity.INFO, Subject.FILE, "Nothing to do; remove the copy to save time.")
def copied_files(evidence: Evidence) -> Iterator[Observation]:
    """A file is a copy of another."""
    for source in evidence.campaign.sources:
        if source.status == "duplicate":
            yield Observation(source.path, f"Not counted again: {source.detail}.")


@check("overlapping_files", Severity.INFO, Subject.FILE, "Nothing to do; keep the more complete file to save time.")
def overlapping_files(evidence: Evidence) -> Iterator[Observation]:
    """Files share events."""
    read = {source.path for source in evidence.campaign.sources if source.status != "duplicate"}
    for copy in evidence.campaign.copies:
        name = evidence.campaign.name(copy.trace)
        if name in read:
            events = "is" if copy.events == 1 else "are"
            once = "it was" if copy.events == 1 else "they were"
            others = evidence.campaign.names(copy.others) or name
            yield Observation(name, f"{copy.events} of its events {events} also in {others}; {once} counted once.")


@check("reader_note", Severity.INFO, Subject.FILE, "Judge whether it affects the numbers.")
def reader_notes(evidence: Evidence) -> Iterator[Observation]:
    """The reader noticed something else."""
    for name, trace in _named_traces(evidence):
        for note in trace.notes:
            yield Observation(name, note)
