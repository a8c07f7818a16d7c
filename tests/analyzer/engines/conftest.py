"""What several tests of engines need."""

import pytest
from campaigns import write_runs

from dds_trace.analyzer.verdicts import answers


@pytest.fixture
def runs(tmp_path):
    """A folder of six runs of three groups, of 1000, 1001 and 1002 bytes in turn."""
    write_runs(tmp_path / "runs", range(6), groups=3)
    return tmp_path / "runs"


@pytest.fixture
def cached(own_base_folders):
    """Paths of the files in the cache that have this ending."""
    return lambda ending: sorted((own_base_folders / "cache/dds-trace/traces").glob(f"*.{ending}"))


@pytest.fixture
def answer_elsewhere(monkeypatch):
    """From its call on, this process answers no kind of messages, but ends with "answered here"; others answer as ever."""

    def here(*_arguments, **_options):
        raise AssertionError("answered here")

    here.__module__, here.__qualname__ = answers.__name__, "_measure_case"  # sent by its name
    return lambda: monkeypatch.setattr(answers, "_measure_case", here)
