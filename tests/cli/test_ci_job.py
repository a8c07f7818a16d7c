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
size = "{size}"
rate = 200
"""


def script_of_the_job():
    """The lines of the first `run: |` of the page, and the names of the files that its later steps take."""
    lines = PAGE.read_text().splitlines()
    first = next(number for number, line in enumerate(lines) if line.strip() == "- run: |") + 1
    depth = len(lines[first]) - len(lines[first].lstrip())
    last = next(n for n in range(first, len(lines)) if lines[n].strip() and not lines[n].startswith(" " * depth))
    return dedent("\n".join(lines[first:last])) + "\n"


@pytest.fixture
def desk(tmp_path, domain_id):
    """Run the job in a checkout as it finds it: the base's plan in `main/`, the new side's next to it."""

    def run(base_size, new_size):
        environment = os.environ | {
            "PATH": f"{stand_ins()}:{Path(sys.executable).parent}:{os.environ['PATH']}",
            "GITHUB_STEP_SUMMARY": str(tmp_path / "summary.md"),
        }
        (tmp_path / "main").mkdir()
        for path, size in (("main/plan.toml", base_size), ("plan.toml", new_size)):
            (tmp_path / path).write_text(PLAN.format(domain=domain_id, size=size))
        return subprocess.run(
            ["bash", "-e", "-c", script_of_the_job()],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )

    return run


def rounds(tmp_path):
    return [sorted(path.name for path in (tmp_path / side).iterdir()) for side in ("base", "new")]


def test_both_sides_grow_until_five_rounds_leave_it_undecided(desk, tmp_path):
    """Runs of twenty messages never decide a gate on p99."""
    done = desk("1KB", "1KB")
    assert done.returncode == 21, done.stderr
    assert rounds(tmp_path) == [["1", "2", "3", "4", "5"]] * 2
    suites = ET.parse(tmp_path / "gates.xml").getroot()
    assert suites.get("failures") == "0"
    assert suites.get("skipped") != "0"
    assert (tmp_path / "summary.md").read_text().startswith("# Comparison of latency\n")


def test_it_ends_with_the_first_decision_and_its_exit_code(tmp_path):
    """Stand-ins for both programs: the third round decides."""
    programs = tmp_path / "programs"
    programs.mkdir()
    sweep = (
        'for a; do out=$last; last=$a; [ "$out" = --out ] && folder=$a; done; mkdir -p "$folder/base" "$folder/new"\n'
    )
    sweep += 'echo "{\\"base\\": \\"$folder/base\\", \\"new\\": \\"$folder/new\\"}"\n'
    analyze = 'echo . >> calls; [ "$(wc -l < calls)" -lt 3 ] && exit 21 || exit 20\n'
    for name, script in (("dds-sweep", sweep), ("dds-analyze", analyze)):
        (programs / name).write_text(f"#!/bin/sh\n{script}")
        (programs / name).chmod(0o755)
    path = f"{programs}:{Path(sys.executable).parent}:{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "GITHUB_STEP_SUMMARY": str(tmp_path / "summary.md")}
    job = ["bash", "-e", "-c", script_of_the_job()]
    done = subprocess.run(job, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 20, done.stderr
    assert rounds(tmp_path) == [["1", "2", "3"]] * 2
