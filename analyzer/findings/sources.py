"""Checks of the files: what was skipped, cut, copied or rescued."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dds_trace.base.units import counted

from ..model.finding import Finding, Severity
from .evidence import some

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .evidence import Evidence


def skipped_files(evidence: Evidence) -> Iterator[Finding]:
    """Report files that are not traces; a file whose name says that it is one weighs more."""
    skipped = [source for source in evidence.campaign.sources if source.status == "skipped"]
    for source in skipped:
        if source.path.endswith(".mcap"):
            yield Finding(
                Severity.WARNING,
                "skipped_file",
                source.path,
                f"Not used: {source.detail}.",
                "If this should be a trace, look at it with `mcap doctor`; else move it elsewhere.",
            )
    others = [source.path for source in skipped if not source.path.endswith(".mcap")]
    if others:
        yield Finding(
            Severity.INFO,
            "skipped_file",
            some(others, 10),
            f"No trace and not used: {len(others)} of the files here.",
            "Nothing to do, unless one of them should be a trace.",
        )


def truncated_files(evidence: Evidence) -> Iterator[Finding]:
    """Report files that end early."""
    for position, trace in enumerate(evidence.campaign.traces):
        if trace.truncated:
            yield Finding(
                Severity.WARNING,
                "truncated_file",
                evidence.campaign.name(position),
                f"The file ends early ({trace.truncated}); everything before that was used.",
                "Messages near the end may count as lost though they were not: record again if that matters.",
            )


def rescued_events(evidence: Evidence) -> Iterator[Finding]:
    """Report events from the ring of a recorder that was killed before it wrote them."""
    for position, trace in enumerate(evidence.campaign.traces):
        if trace.ring_events:
            yield Finding(
                Severity.INFO,
                "ring_recovered",
                evidence.campaign.name(position),
                f"{counted(trace.ring_events, 'event comes', 'events come')} from the ring that a killed recorder left beside the file.",
                "Nothing to do; keep the ring file beside its trace.",
            )


def unreadable_messages(evidence: Evidence) -> Iterator[Finding]:
    """Report messages on event topics that are not events."""
    for position, trace in enumerate(evidence.campaign.traces):
        if trace.unreadable_messages:
            yield Finding(
                Severity.WARNING,
                "unreadable_messages",
                evidence.campaign.name(position),
                counted(
                    trace.unreadable_messages,
                    "message on an event topic is no event and was not used.",
                    "messages on event topics are no events and were not used.",
                ),
                "Compare what wrote the file with docs/trace-format.md.",
            )


def reader_notes(evidence: Evidence) -> Iterator[Finding]:
    """Report what else the reader noticed."""
    for position, trace in enumerate(evidence.campaign.traces):
        for note in trace.notes:
            yield Finding(
                Severity.INFO,
                "reader_note",
                evidence.campaign.name(position),
                note,
                "Judge whether it touches the numbers.",
            )


def copied_files(evidence: Evidence) -> Iterator[Finding]:
    """Report files that share events with another one; each event counts once."""
    for source in evidence.campaign.sources:
        if source.status == "duplicate":
            yield Finding(
                Severity.INFO,
                "duplicate_file",
                source.path,
                f"Not counted again: {source.detail}.",
                "Nothing to do; remove the copy to save time.",
            )
    for copy in evidence.campaign.copies:
        name = evidence.campaign.name(copy.trace)
        if any(source.path == name and source.status != "duplicate" for source in evidence.campaign.sources):
            yield Finding(
                Severity.INFO,
                "overlapping_files",
                name,
                f"{copy.events} of its events {'is' if copy.events == 1 else 'are'} also in "
                f"{evidence.campaign.names(copy.others) or name}; "
                f"{'it was' if copy.events == 1 else 'they were'} counted once.",
                "Nothing to do; keep the more complete file to save time.",
            )
