"""`dds-analyze RUNS`: `dds-trace analyze RUNS` by its first name."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from dds_trace.base.shortage import ANALYSIS
from dds_trace.base.threads import one_blas_thread, tune_gc

from .analyze import app
from .program import run_command
from .trace import main as dds_trace
from .trace import run_alias
from .vector_sorts import avoid_slow_sorts


def main(arguments: Sequence[str] | None = None) -> None:
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words[:1] in (["compare"], ["watch"]):
        dds_trace(words)
    tune_gc()
    avoid_slow_sorts()
    with one_blas_thread():
        run_command(lambda: run_alias("dds-analyze", app, ["analyze", *words]), room=ANALYSIS)


if __name__ == "__main__":
    main()
