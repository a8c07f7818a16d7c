"""A Dask cluster as an `Engine`: one worker reads a trace, one worker processes a batch.

Events stay with the workers that read them, and go to the worker that needs them for its batch; the scheduler recomputes what
is lost with a worker.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Protocol, TypeVar

from dds_trace.base.errors import BackendUnavailableError, TraceFormatError
from dds_trace.tracefile.format.events import EventColumns

from ..cache.event_index import EventIndex, EventKey, EventPart
from ..cache.loaded import LoadedTrace, load_trace
from ..cache.remote import find_anywhere
from ..groups.batch import Batch
from ..loading.campaign import Campaign, Place, Progress, campaign_of, skipped_source
from ..model.finding import Source
from .batches import keep_freed_memory
from .process import BatchOutput, process

_TIMEOUT_S = 30

_CHUNKS = 64
"""Chunks of mapped items: the scheduler needs some milliseconds for each."""

Result_co = TypeVar("Result_co", covariant=True)
Result = TypeVar("Result")
Item = TypeVar("Item")


class _Future(Protocol[Result_co]):
    def result(self) -> Result_co: ...


class _Client(Protocol):
    def submit(self, work: Callable[..., Result], *arguments: object, pure: bool) -> _Future[Result]: ...

    def run(self, function: Callable[..., Result], *arguments: object) -> Mapping[str, Result]: ...

    def close(self) -> None: ...


@dataclass(frozen=True, slots=True, eq=False)
class RemoteEvents:
    """Events of one key of the event index, in the memory of a worker."""

    client: _Client
    loaded: _Future[LoadedTrace | str]
    key: EventKey

    def load(self) -> EventColumns:
        return self.client.submit(_events, self.loaded, self.key, pure=False).result()


class ClusterEngine:
    """The workers of the Dask scheduler at an address such as `tcp://host:8786`.

    Raises:
        BackendUnavailableError: Dask is not installed, or no scheduler answers.
    """

    def __init__(self, address: str) -> None:
        try:
            distributed = import_module("distributed")
        except ImportError as err:
            raise BackendUnavailableError(
                "--cluster needs Dask: install the extra with pip install 'dds-trace[cluster]' (in a clone '.[cluster]')"
            ) from err
        try:
            # Rows come straight from the workers where possible.
            self._client: _Client = distributed.Client(
                address, timeout=_TIMEOUT_S, set_as_default=False, direct_to_workers=True
            )
        except (OSError, ValueError) as err:
            raise BackendUnavailableError(
                f"no Dask scheduler answers at {address} ({err}); start one with `dask scheduler`"
            ) from err
        self._loaded: list[_Future[LoadedTrace | str]] = []

    def load(self, location: Place, skip: Collection[Path], progress: Progress | None) -> Campaign:
        """Read every trace on a worker; only the descriptions come here."""
        folder, *roots = (
            path if ":" in os.fspath(path) else path.resolve() for path in (location.folder, *location.parts)
        )
        skipped_folders = [folder.resolve() for folder in skip]
        candidates = sorted({trace for root in roots for trace in find_anywhere(root, skipped_folders)})
        loads = [self._client.submit(_load, os.fspath(c), pure=False) for c in candidates]
        descriptions = [self._client.submit(_describe, load, pure=False) for load in loads]
        loaded: list[LoadedTrace] = []
        skipped: list[Source] = []
        for number, (candidate, load, pending) in enumerate(zip(candidates, loads, descriptions, strict=True)):
            if progress is not None:
                progress(number, len(candidates), candidate)
            described = pending.result()
            if isinstance(described, str):
                if candidates == [folder]:
                    raise TraceFormatError(candidate, described)
                skipped.append(skipped_source(candidate, folder, described))
                continue
            parts = {
                key: replace(part, trace=len(loaded), events=RemoteEvents(self._client, load, key))
                for key, part in described.parts.items()
            }
            loaded.append(LoadedTrace(described.trace, parts))
            self._loaded.append(load)
        return campaign_of(folder, loaded, skipped)

    def process(self, batches: Sequence[Batch], index: EventIndex) -> Iterator[BatchOutput]:
        pending = [self._submit(batch, index) for batch in batches]
        pending.reverse()
        while pending:
            yield pending.pop().result()

    def has_workers_with(self, file: Path) -> bool:
        try:
            seen = self._client.run(_size_and_time, os.fspath(file))
        except OSError:  # one was just lost
            return False
        return set(seen.values()) == {_size_and_time(os.fspath(file))}

    def map(self, function: Callable[[Item], Result], items: Sequence[Item]) -> Iterable[Result]:
        size = max(1, len(items) // _CHUNKS)
        chunks = [
            self._client.submit(_map, function, items[first : first + size], pure=False)
            for first in range(0, len(items), size)
        ]
        return [result for chunk in chunks for result in chunk.result()]

    def _submit(self, batch: Batch, index: EventIndex) -> _Future[BatchOutput]:
        keys_by_trace: dict[int, list[EventKey]] = {}
        for key in batch.event_keys():
            for part in index.get(key, ()):
                keys_by_trace.setdefault(part.trace, []).append(key)
        selected = [
            self._client.submit(_select, self._loaded[trace], trace, keys, pure=False)
            for trace, keys in keys_by_trace.items()
        ]
        return self._client.submit(_process, batch, selected, pure=False)

    def close(self) -> None:
        self._loaded.clear()
        self._client.close()


def _load(path: str) -> LoadedTrace | str:
    try:
        return load_trace(Path(path), 0)
    except TraceFormatError as err:
        return err.what


def _size_and_time(path: str) -> tuple[int, int] | None:
    try:
        status = Path(path).stat()
    except OSError:
        return None
    return status.st_size, status.st_mtime_ns


def _map(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    return [function(item) for item in items]


def _describe(loaded: LoadedTrace | str) -> LoadedTrace | str:
    if isinstance(loaded, str):
        return loaded
    none = EventColumns.empty()
    return replace(loaded, parts={key: replace(part, events=none) for key, part in loaded.parts.items()})


def _select(loaded: LoadedTrace, trace: int, keys: Sequence[EventKey]) -> Mapping[EventKey, EventPart]:
    return {key: replace(loaded.parts[key], trace=trace) for key in keys}


def _events(loaded: LoadedTrace, key: EventKey) -> EventColumns:
    return loaded.parts[key].load()


def _process(batch: Batch, selected: Sequence[Mapping[EventKey, EventPart]]) -> BatchOutput:
    parts: dict[EventKey, list[EventPart]] = {}
    for parts_of_trace in selected:
        for key, part in parts_of_trace.items():
            parts.setdefault(key, []).append(part)
    for parts_of_key in parts.values():
        parts_of_key.sort(key=lambda part: part.trace)
    keep_freed_memory()
    return process(batch, parts).packed(None)
