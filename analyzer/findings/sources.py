"""Files that were skipped, cut, copied or recovered."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from ..model.finding import Severity, Subject
from .evidence import Evidence, Observation, check, some
from .rows import Rows, frame_of, named

if TYPE_CHECKING:
    import polars as pl


def _sources(evidence: Evidence) -> pl.DataFrame:
    sources = evidence.campaign.sources
    return frame_of([{"where": source.path, "status": source.status, "detail": source.detail} for source in sources])


SOURCES = Rows(Subject.FILE, _sources, named)


def _traces(evidence: Evidence) -> pl.DataFrame:
    return frame_of(
        [
            {
                "where": evidence.campaign.name(index),
                "truncated": trace.truncated,
                "unreadable_messages": trace.unreadable_messages,
                "ring_events": trace.ring_events,
                "notes": trace.notes,
            }
            for index, trace in enumerate(evidence.campaign.traces)
        ]
    )


TRACES = Rows(Subject.FILE, _traces, named)
NOTES_OF_READERS = Rows(Subject.FILE, lambda evidence: evidence.frame(_traces).explode("notes"), named)


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
