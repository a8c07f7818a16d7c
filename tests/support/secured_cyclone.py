"""An environment with the Python package of Cyclone DDS built against a library with security plugins, as Debian has it."""

import os
import shutil
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

import pytest
from kept import VARIABLE as KEPT
from kept import kept

REPOSITORY = Path(__file__).parents[2]
VERSION = "0.10.2"
VARIABLE = "DDS_TRACE_SECURED_ENVIRONMENT"
"""Folder of an environment that is there already."""


@cache
def _multiarch() -> str:
    done = subprocess.run(["gcc", "-print-multiarch"], capture_output=True, text=True, check=False)
    return done.stdout.strip()


def _reason_to_skip() -> str | None:
    if os.environ.get(VARIABLE):
        return None
    if shutil.which("gcc") is None:
        return "gcc is not installed"
    library = Path("/usr/lib") / _multiarch()
    header = Path("/usr/include/dds/version.h")
    if not (library / "libddsc0debian").exists() or not header.exists() or VERSION not in header.read_text():
        return f"cyclonedds-dev {VERSION} with its security plugins, as Debian 12 has, is not installed"
    return None


needs_secured_cyclone = pytest.mark.skipif(_reason_to_skip() is not None, reason=str(_reason_to_skip()))


def secured_environment() -> Path:
    given = os.environ.get(VARIABLE)
    made = given or kept(_make, f"secured cyclonedds {VERSION}")()
    if not made:
        pytest.skip(f"the package cyclonedds {VERSION} cannot be built here")
    return Path(made)


def _make() -> str:
    folder = Path(os.environ.get(KEPT) or tempfile.mkdtemp(prefix="dds-trace-tests-"))
    home, environment = folder / "cyclonedds-home", folder / f"cyclonedds-{VERSION}"
    home.mkdir()
    for name, target in (("include", "/usr/include"), ("bin", "/usr/bin"), ("lib", f"/usr/lib/{_multiarch()}")):
        (home / name).symlink_to(target)
    variables = {**os.environ, "CYCLONEDDS_HOME": str(home), "CPATH": f"/usr/include/{_multiarch()}"}
    pip = [str(environment / "bin" / "pip"), "install", "--quiet"]
    commands = (
        [sys.executable, "-m", "venv", str(environment)],
        [*pip, f"cyclonedds=={VERSION}"],
        [*pip, "-e", f"{REPOSITORY}[security]"],
    )
    built = all(subprocess.run(command, env=variables, check=False).returncode == 0 for command in commands)
    return str(environment) if built else ""
