"""`dds-analyze`, and any command of `dds-trace`, called in this process."""

import pytest

from dds_trace.cli import dds_analyze, trace


def run_main(*arguments):
    return _code(dds_analyze.main, arguments)


def run_trace(*words):
    return _code(trace.main, words)


def _code(main, words):
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    return ended.value.code or 0
