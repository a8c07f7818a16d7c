"""A folder of traces becomes one `Campaign`: what was looked at, who recorded, and every event once."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from analyzer.analysis import Source
from analyzer.gather import EventsByKey, gather_events
from tracefile import MissingEventsError, TraceFormatError, find_traces, read_trace

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping

    from tracefile import Run, Session, Trace

    Progress = Callable[[int, int, Path], None]
    """Told before each trace is read: how many are done, how many there are, and which comes next."""

_NAMED_AT_MOST = 5
"""Files that an error message names."""


@dataclass(frozen=True, slots=True, eq=False)
class Campaign:
    """Everything that the traces of a folder hold.

    Attributes:
        folder: the folder, or the one file, that was looked at.
        sources: every file that was looked at.
        traces: the traces read, without their events; positions are those of `events`.
        sessions: session_id -> latest description.
        runs: run_id -> latest description.
        session_traces: session_id -> positions of the traces that name it.
        run_traces: run_id -> positions of the traces that describe it.
        events: the events by stage, run and relay.
    """

    folder: Path
    sources: tuple[Source, ...]
    traces: tuple[Trace, ...]
    sessions: Mapping[int, Session]
    runs: Mapping[int, Run]
    session_traces: Mapping[int, tuple[int, ...]]
    run_traces: Mapping[int, tuple[int, ...]]
    events: EventsByKey

    def name(self, trace: int) -> str:
        """What the trace at this position is called in findings."""
        return _relative(self.traces[trace].path, self.folder)

    def names(self, traces: Iterable[int]) -> str:
        """Names of several traces, in one string."""
        return ", ".join(self.name(trace) for trace in sorted(set(traces)))


def load_campaign(path: Path, *, skip: Collection[Path] = (), progress: Progress | None = None) -> Campaign:
    """Read every trace at or below `path`.

    Args:
        path: a folder, a trace file, or a rosbag2 folder.
        skip: folders that are not looked into (where results are written).
        progress: told of each trace before it is read.

    Raises:
        MissingEventsError: there is nothing at `path`, or no trace among it.
        TraceFormatError: `path` is one file or rosbag2 folder, and it is no trace.
    """
    candidates = find_traces(path, skip=skip)
    alone = candidates == [path]
    traces: list[Trace] = []
    skipped: list[Source] = []
    for position, candidate in enumerate(candidates):
        if progress is not None:
            progress(position, len(candidates), candidate)
        try:
            traces.append(_read(candidate))
        except TraceFormatError as err:
            if alone:
                raise
            skipped.append(Source(_relative(candidate, path), "skipped", err.what, 0))
    if not alone:
        skipped += [
            Source(_relative(other, path), "skipped", "neither an .mcap file nor a rosbag2 folder", 0)
            for other in _other_files(path, candidates, skip)
        ]
    if not traces:
        raise MissingEventsError(_nothing_found(path, skipped))
    return _campaign(path, traces, skipped)


def _read(path: Path) -> Trace:
    """The trace at `path`; a file in which nothing was ever written is none."""
    try:
        trace = read_trace(path)
    except OSError as err:
        raise TraceFormatError(path, f"cannot be read ({err.strerror})") from err
    if not (trace.sessions or trace.runs or trace.event_count):
        raise TraceFormatError(path, f"holds nothing of a trace ({trace.truncated or 'it is complete'})")
    return trace


def _campaign(path: Path, traces: list[Trace], skipped: list[Source]) -> Campaign:
    events = gather_events(traces)
    sessions: dict[int, Session] = {}
    runs: dict[int, Run] = {}
    session_traces: dict[int, tuple[int, ...]] = {}
    run_traces: dict[int, tuple[int, ...]] = {}
    for position, trace in enumerate(traces):
        for session in trace.sessions:
            known = sessions.setdefault(session.session_id, session)
            sessions[session.session_id] = max(known, session, key=_session_age)
            session_traces[session.session_id] = (*session_traces.get(session.session_id, ()), position)
        for run in trace.runs:
            runs[run.run_id] = max(runs.setdefault(run.run_id, run), run, key=_run_age)
            run_traces[run.run_id] = (*run_traces.get(run.run_id, ()), position)
    return Campaign(
        folder=path,
        sources=tuple(
            sorted([*_read_sources(path, traces, events), *skipped], key=lambda source: source.path)
        ),
        # The events live on in `events`; a trace is kept for what else it says.
        traces=tuple(replace(trace, events={}) for trace in traces),
        sessions=sessions,
        runs=runs,
        session_traces=session_traces,
        run_traces=run_traces,
        events=events,
    )


def _session_age(session: Session) -> tuple[bool, int]:
    """Of two descriptions of one session the closed one is the later."""
    return session.state == "closed", session.dropped_events


def _run_age(run: Run) -> tuple[bool, int]:
    return run.state == "finished", run.published


def _read_sources(folder: Path, traces: list[Trace], events: EventsByKey) -> Iterator[Source]:
    copies = {copy.trace: copy for copy in events.copies}
    for position, trace in enumerate(traces):
        name, held = _relative(trace.path, folder), trace.event_count
        status, detail = ("truncated", trace.truncated) if trace.truncated else ("read", "")
        copied = copies[position].events if position in copies else 0
        if copied:
            others = ", ".join(_relative(traces[other].path, folder) for other in copies[position].others)
            remark = f"{copied} of its {held} events are also in {others or 'itself'} and counted once"
            detail = f"{detail}; {remark}" if detail else remark
            status = "duplicate" if copied == held else status
        yield Source(name, status, detail, held - copied)


def _other_files(folder: Path, traces: Collection[Path], skip: Collection[Path]) -> Iterator[Path]:
    """Files that nobody took for a trace; what belongs to a trace (a ring beside it) or is hidden is left out."""
    closed = {entry.resolve() for entry in (*traces, *skip)}
    stems = tuple(os.fspath(entry) for entry in traces)
    for where, folders, files in os.walk(folder):
        folders[:] = sorted(
            name
            for name in folders
            if not name.startswith(".") and (Path(where) / name).resolve() not in closed
        )
        for name in sorted(files):
            path = Path(where) / name
            if not name.startswith(".") and not os.fspath(path).startswith(stems):
                yield path


def _relative(path: Path, folder: Path) -> str:
    """The path below `folder`, so that a report does not depend on where the folder is."""
    return (
        path.relative_to(folder).as_posix() if path != folder and path.is_relative_to(folder) else path.name
    )


def _nothing_found(path: Path, skipped: list[Source]) -> str:
    looked_at = [f"{source.path} ({source.detail})" for source in skipped[:_NAMED_AT_MOST]]
    more = len(skipped) - len(looked_at)
    named = "; ".join(looked_at) + (f"; and {more} more" if more > 0 else "")
    return f"{path}: no trace here" + (
        f": looked at {named}"
        if named
        else ", the folder is empty; give the folder that dds-record wrote into"
    )
