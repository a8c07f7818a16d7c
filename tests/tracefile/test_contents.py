import subprocess
import sys

import pytest

HEAVY = {"numpy", "polars", "pyarrow", "zstandard", "cramjam", "mcap"}


def loaded_by(statement):
    listed = subprocess.run(
        [sys.executable, "-c", f"{statement}\nimport sys; print(*sys.modules)"],
        capture_output=True,
        text=True,
        check=True,
    )
    return HEAVY & set(listed.stdout.split())


@pytest.mark.parametrize(
    "statement",
    [
        "from dds_trace.base.errors import TraceError; from dds_trace.tracefile.format.descriptions import Session, Qos",
        "import dds_trace.base.units, dds_trace.base.printable, dds_trace.base.files, dds_trace.base.threads",
    ],
)
def test_light_names_load_nothing_heavy(statement):
    assert loaded_by(statement) == set()


def test_the_reader_does():
    assert "numpy" in loaded_by("from dds_trace.tracefile.reading.reader import read_trace")
