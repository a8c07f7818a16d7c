"""The traces of a folder, their sessions and runs, and the index of their events."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from dds_trace.base.errors import MissingEventsError, TraceFormatError
from dds_trace.base.extension import load
from dds_trace.base.files import PLAN_COPY, real_path
from dds_trace.base.units import counted, first_of
from dds_trace.tracefile.format.descriptions import Run, Session
from dds_trace.tracefile.reading.storage import find_traces
from dds_trace.tracefile.reading.trace import FOREIGN_HINT, Trace

from ..model.finding import Source
from .event_index import Copies, EventIndex, index_events
from .place import Place, is_remote
from .traces import LoadAll, LoadedTrace

Progress = Callable[[int, int, Path], None]
"""Called before each trace is read with the number done, the number of all, and its path."""


_FILES_OF_A_SWEEP = frozenset({PLAN_COPY, "state.json", "max_rate.json", "max_rate.csv", "max_rate.svg"})
"""Files of `dds-trace sweep` are not listed as skipped."""

_NAMED_AT_MOST = 5

_AGAIN = re.compile(r"record again|[Rr]epeat the runs?")
_OPTION = re.compile(r"--(depth|reliability|tuned)(?: (\d+|reliable))?")


def _as_axis(option: re.Match[str]) -> str:
    name, value = option.groups()
    values = {"reliable": ' = "reliable"', None: " = true" if name == "tuned" else ""}
    return f"{name}{values.get(value, f' = {value}')} in the plan's [axes]"


@dataclass(frozen=True, slots=True, eq=False)
class Campaign:
    """The traces of a folder; sessions and runs by id, their latest description, and the indices of their traces."""

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
        skipped = [source for source in self.sources if source.status == "skipped"]
        sources = [*_read_sources(self.folder, self.traces, self.event_counts, copies), *skipped]
        return replace(self, copies=copies, sources=tuple(sorted(sources, key=lambda source: source.path)))

    def name(self, trace: int) -> str:
        return _relative(self.traces[trace].path, self.folder)

    def remedy(self, text: str) -> str:
        """Return a remedy as a sweep takes it, which does not repeat what is complete and has options as axes."""
        plan = self.folder / PLAN_COPY
        if plan.is_file():
            text = _OPTION.sub(_as_axis, text)
            command = f"(dds-trace sweep {shlex.quote(str(plan))} --out again)"
            text = _AGAIN.sub(lambda words: f"{words[0]} {command}", text, 1)
        return text

    def names(self, traces: Iterable[int]) -> str:
        return ", ".join(self.name(trace) for trace in sorted(set(traces)))


def load_campaign(
    location: Place, load_all: LoadAll, *, skip: Collection[Path] = (), progress: Progress | None = None
) -> Campaign:
    """Read every trace of a location, at least one or an error; folders of results are in `skip`."""
    path = location.folder
    candidates = sorted({trace for part in location.parts for trace in _find(part, skip)})
    results = load_all(candidates)
    loaded: list[LoadedTrace] = []
    skipped: list[Source] = []
    for number, candidate in enumerate(candidates):
        if progress is not None:
            progress(number, len(candidates), candidate)
        trace = next(results)
        if not isinstance(trace, TraceFormatError):
            loaded.append(trace.at(len(loaded)))
        elif candidates == [path]:
            raise TraceFormatError(path, _archive_words(path)) if _is_archive(path) else trace
        else:
            skipped.append(skipped_source(candidate, path, trace.what))
    if candidates != [path]:
        skipped += [
            skipped_source(other, path, "neither an .mcap file nor a rosbag2 folder")
            for other in sorted({file for part in location.parts for file in _other_files(part, candidates, skip)})
        ]
    return campaign_of(path, loaded, skipped)


def skipped_source(candidate: Path, folder: Path, why: str) -> Source:
    return Source(_relative(candidate, folder), "skipped", why, 0)


def campaign_of(path: Path, loaded: Sequence[LoadedTrace], skipped: Sequence[Source]) -> Campaign:
    """Return the campaign of some traces, at least one, of `path`, a folder or the only file."""
    if not loaded:
        raise MissingEventsError(_nothing_found(path, skipped))
    sessions: dict[int, Session] = {}
    runs: dict[int, Run] = {}
    session_traces: dict[int, tuple[int, ...]] = {}
    run_traces: dict[int, tuple[int, ...]] = {}
    for position, trace in enumerate(loaded):
        for session in trace.trace.sessions:
            earlier = sessions.setdefault(session.session_id, session)
            sessions[session.session_id] = max(
                earlier, session, key=lambda s: (part_of(s), s.state == "closed", s.dropped_events)
            )
            session_traces[session.session_id] = (*session_traces.get(session.session_id, ()), position)
        for run in trace.trace.runs:
            runs[run.run_id] = max(
                runs.setdefault(run.run_id, run), run, key=lambda run: (run.state == "finished", run.published)
            )
            run_traces[run.run_id] = (*run_traces.get(run.run_id, ()), position)
    campaign = Campaign(
        folder=path,
        sources=tuple(skipped),
        traces=tuple(trace.trace for trace in loaded),
        sessions=sessions,
        runs=runs,
        session_traces=session_traces,
        run_traces=run_traces,
        events=index_events(trace.parts for trace in loaded),
        event_counts=tuple(trace.events for trace in loaded),
    )
    return campaign.with_copies(())


def part_of(session: Session) -> int:
    part = session.extra.get("part")
    return part if isinstance(part, int) else 1


def _read_sources(
    folder: Path, traces: Sequence[Trace], counts: Sequence[int], copies: Iterable[Copies]
) -> Iterator[Source]:
    copies_by_trace = {copy.trace: copy for copy in copies}
    for position, (trace, events) in enumerate(zip(traces, counts, strict=True)):
        name = _relative(trace.path, folder)
        status, detail = ("truncated", trace.truncated) if trace.truncated else ("read", "")
        copied = copies_by_trace[position].events if position in copies_by_trace else 0
        if copied:
            others = ", ".join(_relative(traces[other].path, folder) for other in copies_by_trace[position].others)
            remark = f"{copied} of its {counted(events, 'event')} {'is' if copied == 1 else 'are'} also in {others or 'itself'} and counted once"
            detail = f"{detail}; {remark}" if detail else remark
            status = "duplicate" if copied == events else status
        yield Source(name, status, detail, events - copied)


def _other_files(folder: Path, traces: Collection[Path], skip: Collection[Path]) -> Iterator[Path]:
    skipped = {real_path(entry) for entry in (*traces, *skip) if entry.is_dir()}
    stems = {os.fspath(entry) for entry in traces}
    lengths = {len(stem) for stem in stems}  # few, for thousands of stems
    for where, folders, files in os.walk(folder):
        folders[:] = sorted(
            name for name in folders if not name.startswith(".") and real_path(Path(where) / name) not in skipped
        )
        for name in sorted(files):
            path = Path(where) / name
            is_ours = name.startswith(".") or name in _FILES_OF_A_SWEEP
            if not is_ours and not any(os.fspath(path)[:length] in stems for length in lengths):
                yield path


def _relative(path: Path, folder: Path) -> str:
    depth = len(folder.parts)
    below = path.parts[depth:] if path.parts[:depth] == folder.parts else ()
    return "/".join(below) or path.name


def _is_archive(path: Path) -> bool:
    return path.name.endswith((".tar.xz", ".tar.gz", ".tgz", ".tar", ".zip"))


def _archive_words(path: Path) -> str:
    return f"an archive of traces, not a trace; mkdir opened && tar -xf {path} -C opened, and give opened"


def _nothing_found(path: Path, skipped: Sequence[Source]) -> str:
    foreign = any(source.detail.endswith(FOREIGN_HINT) for source in skipped)
    named_files = [f"{source.path} ({source.detail.removesuffix(FOREIGN_HINT)})" for source in skipped]
    listed = "; ".join(first_of(named_files, _NAMED_AT_MOST))
    listed += FOREIGN_HINT if foreign else ""
    archive = next((path / source.path for source in skipped if _is_archive(Path(source.path))), None)
    listed += "" if archive is None else f"; {archive} is {_archive_words(archive)}"
    return f"{path}: no trace here" + (
        f": looked at {listed}" if listed else ", the folder is empty; give the folder with the traces"
    )


def _find(path: Path, skip: Collection[Path]) -> list[Path]:
    found: list[Path] = load("parts", "find_remote")(path) if is_remote(path) else find_traces(path, skip=skip)
    return found
