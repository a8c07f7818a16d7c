"""A campaign: the traces of a folder, their sessions and runs, and the index of their events."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.base.errors import MissingEventsError, TraceFormatError
from dds_trace.base.units import counted
from dds_trace.tracefile.reading.trace import FOREIGN_HINT

from ..cache.event_index import Copies, EventIndex, index_events
from ..cache.remote import find_anywhere
from ..cache.traces import TraceLoader
from ..model.finding import Source
from .place import Place

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence

    from dds_trace.tracefile.format.descriptions import Run, Session
    from dds_trace.tracefile.reading.trace import Trace

    from ..cache.loaded import LoadedTrace

    Progress = Callable[[int, int, Path], None]
    """Called before each trace is read with the number done, the number of all, and its path."""

    LoadAll = Callable[[Sequence[Path]], Iterator[LoadedTrace | TraceFormatError]]
    """Yields each trace at its position among those that are one, or why a file is none."""

_FILES_OF_A_SWEEP = frozenset({"state.json", "max_rate.json", "max_rate.csv", "max_rate.svg"})
"""Files that `dds-sweep` writes beside its traces; they are not listed as skipped."""

_NAMED_AT_MOST = 5
"""Files that an error message names."""


@dataclass(frozen=True, slots=True, eq=False)
class Campaign:
    """The content of the traces of a folder, events by their index.

    Attributes:
        folder: the folder, or the one file, that was looked at.
        sources: every file that was looked at; before `with_copies` without the copies of events.
        traces: the traces read, without their events; positions are those of `events`.
        sessions: session_id -> latest description.
        runs: run_id -> latest description.
        session_traces: session_id -> positions of the traces that name it.
        run_traces: run_id -> positions of the traces that describe it.
        events: the event index.
        event_counts: number of events in each trace.
        copies: the events of each trace that another trace holds as well.
    """

    folder: Path
    sources: tuple[Source, ...]
    traces: tuple[Trace, ...]
    sessions: Mapping[int, Session]
    runs: Mapping[int, Run]
    session_traces: Mapping[int, tuple[int, ...]]
    run_traces: Mapping[int, tuple[int, ...]]
    events: EventIndex
    event_counts: tuple[int, ...]
    copies: tuple[Copies, ...] = ()

    def with_copies(self, copies: tuple[Copies, ...]) -> Campaign:
        """Return the campaign with its copies, and with sources that tell them."""
        skipped = [source for source in self.sources if source.status == "skipped"]
        sources = [*_read_sources(self.folder, self.traces, self.event_counts, copies), *skipped]
        return replace(self, copies=copies, sources=tuple(sorted(sources, key=lambda source: source.path)))

    def name(self, trace: int) -> str:
        """Return the name of the trace at this position, as findings tell it."""
        return _relative(self.traces[trace].path, self.folder)

    def names(self, traces: Iterable[int]) -> str:
        """Join the names of several traces."""
        return ", ".join(self.name(trace) for trace in sorted(set(traces)))


def load_campaign(
    place: Path | Place,
    *,
    skip: Collection[Path] = (),
    progress: Progress | None = None,
    load_all: LoadAll | None = None,
) -> Campaign:
    """Read every trace of a place.

    Args:
        place: a folder, a trace file, or a rosbag2 folder; or several.
        skip: folders that are not looked into (where results are written).
        progress: called before each trace is read.
        load_all: reads the traces and keeps their events; by default in memory and in temporary files.

    Raises:
        MissingEventsError: there is nothing at a path, or no trace among it.
        TraceFormatError: `place` is one file or rosbag2 folder, and it is no trace.
    """
    place = place if isinstance(place, Place) else Place.of(place)
    path = place.folder
    candidates = sorted({trace for part in place.parts for trace in find_anywhere(part, skip)})
    found = (load_all or TraceLoader().load_all)(candidates)
    loaded: list[LoadedTrace] = []
    skipped: list[Source] = []
    for number, candidate in enumerate(candidates):
        if progress is not None:
            progress(number, len(candidates), candidate)
        one = next(found)
        if not isinstance(one, TraceFormatError):
            loaded.append(one)
        elif candidates == [path]:
            raise one
        else:
            skipped.append(skipped_source(candidate, path, one.what))
    if candidates != [path]:
        skipped += [
            skipped_source(other, path, "neither an .mcap file nor a rosbag2 folder")
            for other in sorted(
                {each for part in place.parts for each in _other_files(part, candidates, skip)}
            )
        ]
    return campaign_of(path, loaded, skipped)


def skipped_source(candidate: Path, folder: Path, why: str) -> Source:
    """Return the source of a file that is no trace."""
    return Source(_relative(candidate, folder), "skipped", why, 0)


def campaign_of(path: Path, loaded: Sequence[LoadedTrace], skipped: Sequence[Source]) -> Campaign:
    """Put the traces found at `path` together.

    Args:
        path: the folder, or the one file, that was looked at.
        loaded: the traces; the position of each is that in its index.
        skipped: files that are no trace.

    Raises:
        MissingEventsError: `loaded` is empty.
    """
    if not loaded:
        raise MissingEventsError(_nothing_found(path, skipped))
    sessions: dict[int, Session] = {}
    runs: dict[int, Run] = {}
    session_traces: dict[int, tuple[int, ...]] = {}
    run_traces: dict[int, tuple[int, ...]] = {}
    for position, held in enumerate(loaded):
        for session in held.trace.sessions:
            known = sessions.setdefault(session.session_id, session)
            sessions[session.session_id] = max(known, session, key=_session_age)
            session_traces[session.session_id] = (*session_traces.get(session.session_id, ()), position)
        for run in held.trace.runs:
            runs[run.run_id] = max(runs.setdefault(run.run_id, run), run, key=_run_age)
            run_traces[run.run_id] = (*run_traces.get(run.run_id, ()), position)
    campaign = Campaign(
        folder=path,
        sources=tuple(skipped),
        traces=tuple(held.trace for held in loaded),
        sessions=sessions,
        runs=runs,
        session_traces=session_traces,
        run_traces=run_traces,
        events=index_events(held.parts for held in loaded),
        event_counts=tuple(held.events for held in loaded),
    )
    return campaign.with_copies(())


def _session_age(session: Session) -> tuple[int, bool, int]:
    """Return a key that is greater of the later of two descriptions of one session: of a later file, then closed."""
    return part_of(session), session.state == "closed", session.dropped_events


def part_of(session: Session) -> int:
    """Return the number of a description's file among those of its recording (`--rotate`), 1 of an only one."""
    part = session.extra.get("part")
    return part if isinstance(part, int) else 1


def _run_age(run: Run) -> tuple[bool, int]:
    return run.state == "finished", run.published


def _read_sources(
    folder: Path, traces: Sequence[Trace], counts: Sequence[int], copies: Iterable[Copies]
) -> Iterator[Source]:
    of_trace = {copy.trace: copy for copy in copies}
    for position, (trace, held) in enumerate(zip(traces, counts, strict=True)):
        name = _relative(trace.path, folder)
        status, detail = ("truncated", trace.truncated) if trace.truncated else ("read", "")
        copied = of_trace[position].events if position in of_trace else 0
        if copied:
            others = ", ".join(_relative(traces[other].path, folder) for other in of_trace[position].others)
            remark = f"{copied} of its {counted(held, 'event')} {'is' if copied == 1 else 'are'} also in {others or 'itself'} and counted once"
            detail = f"{detail}; {remark}" if detail else remark
            status = "duplicate" if copied == held else status
        yield Source(name, status, detail, held - copied)


def _other_files(folder: Path, traces: Collection[Path], skip: Collection[Path]) -> Iterator[Path]:
    """Yield files that are no trace; files that belong to a trace or a sweep, and hidden ones, are left out."""
    closed = {entry.resolve() for entry in (*traces, *skip) if entry.is_dir()}
    stems = {os.fspath(entry) for entry in traces}
    lengths = {len(stem) for stem in stems}  # few, where one look at each of thousands of stems would be many
    for where, folders, files in os.walk(folder):
        folders[:] = sorted(
            name
            for name in folders
            if not name.startswith(".") and (Path(where) / name).resolve() not in closed
        )
        for name in sorted(files):
            path = Path(where) / name
            known = name.startswith(".") or name in _FILES_OF_A_SWEEP
            if not known and not any(os.fspath(path)[:length] in stems for length in lengths):
                yield path


def _relative(path: Path, folder: Path) -> str:
    """Return the path below `folder`, so that a report does not depend on where the folder is."""
    depth = len(folder.parts)
    below = path.parts[depth:] if path.parts[:depth] == folder.parts else ()
    return "/".join(below) or path.name


def _nothing_found(path: Path, skipped: Sequence[Source]) -> str:
    foreign = any(source.detail.endswith(FOREIGN_HINT) for source in skipped)
    looked_at = [
        f"{source.path} ({source.detail.removesuffix(FOREIGN_HINT)})" for source in skipped[:_NAMED_AT_MOST]
    ]
    more = len(skipped) - len(looked_at)
    named = "; ".join(looked_at) + (f"; and {more} more" if more > 0 else "")
    named += FOREIGN_HINT if foreign else ""
    return f"{path}: no trace here" + (
        f": looked at {named}"
        if named
        else ", the folder is empty; give the folder that dds-record wrote into"
    )
