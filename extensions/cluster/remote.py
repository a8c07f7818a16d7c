"""Traces in object storage (any scheme of fsspec): found there, copied here to be read.

`pathlib` turns `s3://bucket/runs` into `s3:/bucket/runs`; `_url` undoes that.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path, PurePosixPath
from typing import Protocol

from dds_trace.analyzer.loading.place import REMOTE
from dds_trace.base.errors import BackendUnavailableError, MissingEventsError, TraceError, TraceFormatError
from dds_trace.base.printable import printable


class _Storage(Protocol):
    """The part of `fsspec.AbstractFileSystem` used here; names have no scheme."""

    def isdir(self, path: str) -> bool: ...

    def find(self, path: str) -> list[str]: ...

    def ls(self, path: str, *, detail: bool) -> list[str]: ...

    def get_file(self, remote: str, local: str) -> None: ...


def find_remote(path: Path) -> list[Path]:
    """Find every trace at or below `path` in object storage; a `TraceError` without one, or where it does not answer."""
    with _storage(path) as (files, root):
        names = [PurePosixPath(name) for name in files.find(root)]
    if not names:
        raise MissingEventsError(f"{_url(path)}: nothing there")
    bags = {name.parent for name in names if name.name == "metadata.yaml"}
    files_only = {name for name in names if name.suffix == ".mcap" and not bags.intersection(name.parents)}
    start = PurePosixPath(root)
    return sorted(path if name == start else path / name.relative_to(start) for name in bags | files_only)


@contextmanager
def local_copy(path: Path) -> Iterator[Path]:
    """Yield a temporary copy of the trace on this machine; a `TraceFormatError` if it cannot be read."""
    with tempfile.TemporaryDirectory(prefix="dds-analyze-") as name:
        with _storage(path) as (files, root):
            for remote in _files_of(files, root):
                local = Path(name) / path.name / PurePosixPath(remote).relative_to(root)
                if not files.isdir(root):
                    local = Path(name) / PurePosixPath(remote).name
                local.parent.mkdir(parents=True, exist_ok=True)
                files.get_file(remote, os.fspath(local))
        yield Path(name) / path.name


def _files_of(files: _Storage, root: str) -> list[str]:
    if files.isdir(root):
        return sorted(files.find(root))
    names = files.ls(os.fspath(PurePosixPath(root).parent), detail=False)
    return sorted(name for name in names if name.startswith(root))


@contextmanager
def _storage(path: Path) -> Iterator[tuple[_Storage, str]]:
    try:
        fsspec = import_module("fsspec")  # an extra: needed only for a scheme
        files, root = fsspec.core.url_to_fs(_url(path))
        files.invalidate_cache()
        yield files, root.rstrip("/")
    except ImportError as err:
        raise BackendUnavailableError(
            f"{_url(path)}: {err}; install the extra with pip install 'dds-trace[cluster]' (in a clone '.[cluster]')"
        ) from err
    except FileNotFoundError as err:
        raise MissingEventsError(f"{_url(path)}: no such object or folder") from err
    except TraceError:
        raise
    except Exception as err:  # each storage has its own errors
        raise TraceFormatError(_url(path), f"cannot be read ({printable(err)})") from err


def _url(path: Path) -> str:
    return REMOTE.sub(r"\1://", os.fspath(path))
