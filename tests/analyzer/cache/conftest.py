"""Which traces are read, for tests of the cache."""

import pytest
from campaigns import assert_same_results

import dds_trace.analyzer.cache.loaded
from dds_trace.analyzer.pipeline import analyze
from dds_trace.tracefile.reading.reader import read_trace, read_trace_in_pieces


@pytest.fixture
def files_read(monkeypatch):
    """Names of the traces that are read from here on."""
    names = []

    def noted(read):
        def reading(path, *args):
            names.append(path.name)
            return read(path, *args)

        return reading

    for read in (read_trace, read_trace_in_pieces):
        monkeypatch.setattr(dds_trace.analyzer.cache.loaded, read.__name__, noted(read))
    return names


@pytest.fixture
def assert_read_again(files_read):
    """Checks that an analysis reads both traces of a run again and has the results of the first."""

    def check(runs, first):
        files_read.clear()
        assert_same_results(analyze(runs, cache=True), first)
        assert set(files_read) == {"ping0.mcap", "relay0.mcap"}

    return check
