"""The example job of `docs/how-to/ci.md`: its script is taken out of the page and run as CI runs it, on the socket backend."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from textwrap import dedent
from xml.etree import ElementTree as ET

import pytest
from warm_start import stand_ins

pytestmark = [pytest.mark.middleware, pytest.mark.timeout(300)]

PAGE = Path(__file__).parents[2] / "docs/how-to/ci.md"
PLAN = """
[run]
messages = 20
warmup = 2
settle_seconds = 0
domain = {domain}
[axes]
backend = "socket"
size = {sizes}
rate = 200
"""


def script_of_the_job():
    """The lines of the first `run: |` of the page, and the names of the files that its later steps take."""
    lines = PAGE.read_text().splitlines()
    first = next(number for number, line in enumerate(lines) if line.strip() == "- run: |") + 1
    depth = len(lines[first]) - len(lines[first].lstrip())
    last = next(
        n for n in range(first, len(lines)) if lines[n].strip() and not lines[n].startswith(" " * depth)
    )
    return dedent("\n".join(lines[first:last])) + "\n"


@pytest.fixture
def desk(tmp_path, domain_id):
    """A checkout as the job finds it: `plan.toml`, and `base/` with one recording of the cells that are asked for."""

    def prepare(base_sizes):
        environment = os.environ | {
            "PATH": f"{stand_ins()}:{Path(sys.executable).parent}:{os.environ['PATH']}",
            "GITHUB_STEP_SUMMARY": str(tmp_path / "summary.md"),
        }
        (tmp_path / "base.toml").write_text(PLAN.format(domain=domain_id, sizes=base_sizes))
        (tmp_path / "plan.toml").write_text(PLAN.format(domain=domain_id, sizes='["1KB"]'))
        subprocess.run(
            ["dds-sweep", "base.toml", "--out", "base"],
            cwd=tmp_path,
            env=environment,
            check=True,
            capture_output=True,
        )
        return subprocess.run(
            ["bash", "-e", "-c", script_of_the_job()],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )

    return prepare


def test_it_records_until_decided_and_lets_what_stays_undecided_pass_with_a_warning(desk, tmp_path):
    """The base has one run, which no number of new ones makes enough."""
    done = desk('["1KB"]')
    assert done.returncode == 0, done.stderr
    assert "::warning::inconclusive after five rounds" in done.stdout
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == ["1", "2", "3", "4", "5"]
    suites = ET.parse(tmp_path / "gates.xml").getroot()
    assert (suites.get("tests"), suites.get("skipped")) == ("3", "3")
    said = [skipped.get("message") for skipped in suites.iter("skipped")]
    assert all("it takes 3 runs a side, there are 1 and 5" in message for message in said)
    assert (tmp_path / "summary.md").read_text().startswith("# Comparison of latency\n")


def test_it_ends_with_the_first_decision_and_its_exit_code(desk, tmp_path):
    """The plan of the new side lacks a cell of the base: regressed, whatever else is measured."""
    done = desk('["1KB", "2KB"]')
    assert done.returncode == 20, done.stderr
    assert "::warning::" not in done.stdout
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["1"]
    suites = ET.parse(tmp_path / "gates.xml").getroot()
    (failure,) = suites.iter("failure")
    assert "missing on the new side" in failure.get("message")
