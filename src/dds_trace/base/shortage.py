"""Descriptors, address space and threads that a command needs: tried before it starts, and named where they run out."""

from __future__ import annotations

import errno
import mmap
import os
import resource
import threading
from collections.abc import Iterator
from dataclasses import dataclass

from .errors import TraceError

LEAST_FILES = 64
"""Middlewares end a process that cannot open their sockets."""
MEMORY = "not enough memory; request smaller or fewer messages, or give a part of the traces"
_FILES = "too many open files; raise `ulimit -n` (LimitNOFILE= of a service)"
_THREADS = (
    "no further thread can be started; raise `ulimit -u` or -v (--pids-limit of a container, TasksMax= of a service)"
)
_KINDS = {errno.EMFILE: _FILES, errno.ENFILE: _FILES, errno.ENOMEM: MEMORY}
_WORDS = {
    "Too many open files": _FILES,
    "can't start new thread": _THREADS,
    "Resource temporarily unavailable": _THREADS,  # of Rust, when it starts a thread
    "failed to map segment": MEMORY,
    "Cannot allocate memory": MEMORY,
}


@dataclass(frozen=True, slots=True)
class Room:
    address_bytes: int
    threads: int

    def check(self) -> None:
        """Raise a `TraceError` where this process cannot have it: libraries end a process without a word, or with many."""
        files, most_files = resource.getrlimit(resource.RLIMIT_NOFILE)
        if 0 <= files < LEAST_FILES <= most_files:
            resource.setrlimit(resource.RLIMIT_NOFILE, (LEAST_FILES, most_files))
        elif 0 <= files < LEAST_FILES:
            raise TraceError(f"this process may open {files} files and needs {LEAST_FILES}; raise `ulimit -n`")
        if resource.getrlimit(resource.RLIMIT_AS)[0] != resource.RLIM_INFINITY:
            self._try_memory()
        self._try_threads()

    def _try_memory(self) -> None:
        try:
            mmap.mmap(-1, self.address_bytes, prot=0).close()
        except OSError:
            needed = f"{self.address_bytes >> 20:,} MB of address space"
            raise TraceError(f"this process needs {needed}, more than it may have; raise `ulimit -v`") from None

    def _try_threads(self) -> None:
        enough, tried = threading.Event(), list[threading.Thread]()
        try:
            for _ in range(self.threads):
                thread = threading.Thread(target=enough.wait, daemon=True)
                thread.start()
                tried.append(thread)
        except RuntimeError:
            raise TraceError(f"this command needs {self.threads} threads; {_THREADS}") from None
        finally:
            enough.set()
            for thread in tried:
                thread.join()


_CORES = os.cpu_count() or 1
RECORDING = Room(address_bytes=1024 << 20, threads=8 + 2 * _CORES)
ANALYSIS = Room(address_bytes=(2048 << 20) + (256 << 20) * _CORES, threads=12 + 4 * _CORES)


def shortage(error: BaseException) -> str:
    """Return what a command was short of, in words, if that is why it failed."""
    for cause in _causes(error):
        if isinstance(cause, MemoryError):
            return MEMORY
        if isinstance(cause, OSError) and cause.errno in _KINDS:
            return _KINDS[cause.errno]
        if isinstance(cause, (RuntimeError, ImportError)) or type(cause).__name__ == "PanicException":
            for words, kind in _WORDS.items():
                if words in str(cause):
                    return kind
    return ""


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    seen = set[int]()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        yield error
        error = error.__cause__ or error.__context__
