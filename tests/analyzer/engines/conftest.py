"""What several tests of engines need."""

import pytest
from campaigns import write_runs

from dds_trace.analyzer.cache import parquet_join as row_parts
from dds_trace.analyzer.cache.store import TraceCache
from dds_trace.analyzer.engines import cached_details
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
def joined(monkeypatch):
    """What the parts were that were joined into a file of rows, from now on: bytes, or the path of a file that has them."""
    contents = []
    real = row_parts.JoinedParts.add

    def add(self, part):
        contents.append(part.content)
        real(self, part)

    monkeypatch.setattr(row_parts.JoinedParts, "add", add)
    return contents


@pytest.fixture
def full_disk(monkeypatch):
    """From its call on, this method of the cache finds no room on the disk."""

    def full(*_arguments, **_options):
        raise OSError(28, "No space left on device")

    return lambda method: monkeypatch.setattr(TraceCache, method, full)


@pytest.fixture
def take_out_of_cached(cached):
    """From its call on, each file in the cache that has this ending is sealed without one of the files in it."""

    def take_out(ending, missing):
        cache = TraceCache.open()
        for path in cached(ending):
            files = cached_details._unpacked(cache.read(path.stem, ending, cached_details.MOST_BYTES))
            del files[missing]
            cache.write(path.stem, ending, *cached_details._packed(files))
        cache.close()

    return take_out


@pytest.fixture
def answer_elsewhere(monkeypatch):
    """From its call on, this process answers no kind of messages, but ends with "answered here"; others answer as ever."""

    def here(*_arguments, **_options):
        raise AssertionError("answered here")

    here.__module__, here.__qualname__ = answers.__name__, "_answer_case"  # sent by its name
    return lambda: monkeypatch.setattr(answers, "_answer_case", here)
