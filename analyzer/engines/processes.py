"""Worker processes of this machine: of many small traces, Python is most of the work, and threads share one core for it."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import wait

from dds_trace.base.errors import TraceError
from dds_trace.base.threads import one_blas_thread, tune_gc

from .batches import keep_freed_memory


def can_start_processes() -> bool:
    return not multiprocessing.current_process().daemon


@contextmanager
def processes(count: int) -> Iterator[ProcessPoolExecutor]:
    """Yield processes that end with this one whatever ends it; a `TraceError` where one of them was killed."""
    # A fork would copy locks that other threads, also in polars, have taken.
    pool = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), _begin)
    with _as_spawned(), one_blas_thread():
        for _ in range(count):
            pool.submit(os.getpid)  # each starts one
    try:
        yield pool
    except BrokenProcessPool as err:
        raise TraceError(
            "a worker process of the analysis was killed, perhaps because memory ran out; analyze fewer recordings at once"
        ) from err
    finally:
        pool.shutdown(cancel_futures=True)


def _begin() -> None:
    keep_freed_memory()
    tune_gc()
    threading.Thread(target=_end_with_caller, daemon=True).start()


def _end_with_caller() -> None:
    """End with a killed caller: other workers keep its end of the pipe open."""
    caller = multiprocessing.parent_process()
    assert caller is not None
    wait([caller.sentinel])
    os._exit(1)


@contextmanager
def _as_spawned() -> Iterator[None]:
    """Hide the calling program, which a spawned process would run again; block Ctrl-C, which the caller gets."""
    main = sys.modules["__main__"]
    hidden = {name: getattr(main, name, None) for name in ("__file__", "__spec__")}
    previous = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        for name in hidden:
            setattr(main, name, None)
        yield
    finally:
        for name, value in hidden.items():
            setattr(main, name, value)
        signal.pthread_sigmask(signal.SIG_SETMASK, previous)
