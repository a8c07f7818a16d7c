"""Which traces are read, for tests of the cache."""

import pytest

import dds_trace.analyzer.cache.loaded
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
