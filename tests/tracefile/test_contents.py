"""What a command's --help takes from this room loads nothing heavy."""

from __future__ import annotations

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
        "from dds_trace.tracefile import TraceError, OptionError, Session, Qos, __version__",
        "import dds_trace.tracefile.units.sizes, dds_trace.tracefile.units.durations",
        "import dds_trace.tracefile.units.rates, dds_trace.tracefile.units.counts",
        "import dds_trace.tracefile.visible, dds_trace.tracefile.files, dds_trace.tracefile.threads",
    ],
)
def test_light_names_load_nothing_heavy(statement):
    assert loaded_by(statement) == set()


def test_the_reader_does():
    assert "numpy" in loaded_by("from dds_trace.tracefile import read_trace")
