"""What several tests of engines need."""

import pytest
from campaigns import write_runs


@pytest.fixture
def runs(tmp_path):
    """A folder of six runs of three groups, of 1000, 1001 and 1002 bytes in turn."""
    write_runs(tmp_path / "runs", range(6), groups=3)
    return tmp_path / "runs"
