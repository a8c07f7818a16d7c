"""A Dask cluster as an engine (docs/how-to/analyze.md): what a lost worker had is read again by another."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from importlib import import_module
from pathlib import Path
from secrets import token_hex

from dds_trace.analyzer.engines.local import Engine
from dds_trace.analyzer.loading.event_index import EventKey
from dds_trace.analyzer.loading.place import is_remote
from dds_trace.analyzer.loading.spool import TemporaryFolder
from dds_trace.analyzer.loading.traces import LoadedTrace, load
from dds_trace.base.errors import BackendUnavailableError, TraceFormatError
from dds_trace.base.threads import in_turn
from dds_trace.tracefile.format.events import EventColumns

_TIMEOUT_S = 30

_MOST_TRACES = 64
"""Traces that a worker keeps in temporary files."""


class ClusterEngine(Engine):
    """The workers of the Dask scheduler at an address such as `tcp://host:8786`; a `BackendUnavailableError` without."""

    takes_large_batches = True

    def __init__(self, address: str) -> None:
        super().__init__()
        try:
            distributed = import_module("distributed")
        except ImportError as err:
            raise BackendUnavailableError(
                "--cluster needs Dask: install the extra with pip install 'dds-trace[cluster]' (in a clone '.[cluster]')"
            ) from err
        try:
            # Rows come straight from the workers where possible.
            client = distributed.Client(address, timeout=_TIMEOUT_S, set_as_default=False, direct_to_workers=True)
        except (OSError, ValueError) as err:
            raise BackendUnavailableError(
                f"no Dask scheduler answers at {address} ({err}); start one with `dask scheduler`"
            ) from err
        self.enter_context(closing(client))
        self._executor = client.get_executor()
        self._count = 2 * max(1, sum(client.nthreads().values()))

    def _load_new(self, paths: Sequence[Path]) -> Iterator[LoadedTrace | TraceFormatError]:
        assert self._executor is not None
        describe, anywhere = (
            partial(_describe, analysis=token_hex(8)),
            (p if is_remote(p) else p.absolute() for p in paths),
        )
        jobs = ((0, partial(self._executor.submit, describe, path)) for path in anywhere)
        return in_turn(jobs, 2 * self._count, 0)


@dataclass(frozen=True, slots=True)
class _EventsOfTrace:
    path: Path
    analysis: str
    key: EventKey

    def load(self) -> EventColumns:
        """Read the events; a `TraceFormatError` if the trace changed."""
        loaded, _ = _loaded(self.path, self.analysis)
        if isinstance(loaded, TraceFormatError) or self.key not in loaded.parts:
            raise TraceFormatError(self.path, "changed while it was analyzed; analyze again")
        return loaded.parts[self.key].load()


@lru_cache(maxsize=_MOST_TRACES)
def _loaded(path: Path, _analysis: str) -> tuple[LoadedTrace | TraceFormatError, TemporaryFolder]:
    folder = TemporaryFolder()
    return load(path, folder.path), folder


def _describe(path: Path, *, analysis: str) -> LoadedTrace | TraceFormatError:
    loaded, _ = _loaded(path, analysis)
    if isinstance(loaded, TraceFormatError):
        return loaded
    events = {key: _EventsOfTrace(path, analysis, key) for key in loaded.parts}
    return replace(loaded, parts={key: replace(part, events=events[key]) for key, part in loaded.parts.items()})
