"""Check that a release can be installed and does its part: `just release-check`, before a version is tagged.

1. The source archive and the wheel are built, and pass twine and check-wheel-contents.
2. Each extra alone, in a new environment of each Python, does what it is there for (`PARTS`).
3. Every dependency of every extra has a wheel, or is pure Python, on x86_64 and aarch64 for each Python (`WITHOUT_WHEELS` lists
   what has none, and fails when that is no longer so).
4. A bill of materials (CycloneDX) of the environment with all extras.

A Python that is not on this machine is said to be untried, and the exit code is 1 if a version of `PYTHONS` is.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from dds_trace.extensions.bridges.programs import program_environment

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

Result = TypeVar("Result")

TOP = Path(__file__).parents[1]
PYTHONS = ("3.10", "3.11", "3.12", "3.13", "3.14")
PLATFORMS = ("x86_64-manylinux_2_28", "aarch64-manylinux_2_28")
SAMPLES = TOP / "sample_traces/same_domain"
PATIENCE_S = 300.0
"""No check is about time; this ends one that hangs."""

FOREIGN = program_environment({}, foreign=True)
"""Variables of the programs: without those by which the ROS 2 wheels of this environment would be another's, too."""

NOT_INSTALLED, NO_LICENCE = 7, 7
"""Exit codes (docs/reference/exit-codes.md)."""

BAG = """
import sys
from pathlib import Path
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore
store = get_typestore(Stores.ROS2_JAZZY)
with Writer(Path(sys.argv[1]), version=9) as writer:
    topic = writer.add_connection("/said", "std_msgs/msg/String", typestore=store)
    String = store.types["std_msgs/msg/String"]
    for number in range(30):
        writer.write(topic, number * 10_000_000, store.serialize_cdr(String(data="hello"), "std_msgs/msg/String"))
"""
"""A program that writes a bag of 30 texts, 10 ms apart."""


class CheckError(Exception):
    """A check that failed, in words."""


def run(command: Sequence[str | Path], *, status: int = 0, says: str = "") -> str:
    """Run a command and return what it printed.

    Raises:
        CheckError: it ended with another status, or did not say `says`.
    """
    ran = subprocess.run(
        [str(word) for word in command], capture_output=True, text=True, timeout=PATIENCE_S, check=False, env=FOREIGN
    )
    said = str(ran.stdout) + str(ran.stderr)
    if ran.returncode != status or says not in said or "Traceback" in said:
        shown = " ".join(map(str, command))
        raise CheckError(f"{shown}: status {ran.returncode}, expected {status}: {said.strip()[-500:]}")
    return said


def exchange(backend: str, programs: Path, folder: Path, *data: str) -> None:
    """Let a ping and a relay of a backend exchange thirty messages.

    Raises:
        CheckError: the ping failed.
    """
    common = ("--backend", backend, "--discovery", "localhost", "--domain", "97")
    relay = subprocess.Popen(
        [programs / "dds-record", "--role", "relay", *common, "--out", folder / "relay.mcap"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env=FOREIGN,
    )
    try:
        if not any("serves" in line for line in relay.stderr or ()):
            raise CheckError(f"the relay over {backend} ended before it served")
        ping = ("--role", "ping", *common, *data, "--wait", "60", "--out", folder / "ping.mcap")
        rate = () if data else ("--messages", "30", "--warmup", "0", "--rate", "50")
        run([programs / "dds-record", *ping, *rate])
        relay.send_signal(signal.SIGINT)
        if relay.wait(PATIENCE_S) != 0:
            raise CheckError(f"the relay over {backend} ended with status {relay.returncode}")
    finally:
        relay.kill()
        relay.wait()


def core(programs: Path, folder: Path) -> None:
    """Record over plain sockets, and say what analyzing takes."""
    exchange("socket", programs, folder)
    run([programs / "dds-analyze", folder], status=NOT_INSTALLED, says="pip install 'dds-trace[analyze]'")


def analyze(programs: Path, folder: Path) -> None:
    """Analyze a sample into every report."""
    reports = [word for kind in ("html", "md", "json", "terminal") for word in ("--report", kind)]
    run([programs / "dds-analyze", SAMPLES, "--out", folder, *reports])


def connext(programs: Path, folder: Path) -> None:
    """Exchange messages with a licence; without one, say so."""
    if "RTI_LICENSE_FILE" in os.environ:
        exchange("connext", programs, folder)
        return
    line = [programs / "dds-record", "--role", "relay", "--backend", "connext", "--out", folder / "relay.mcap"]
    run(line, status=NO_LICENCE, says="RTI_LICENSE_FILE")


def cluster(programs: Path, folder: Path) -> None:
    """Analyze a sample with the workers of a scheduler."""
    python = programs / "python"
    run([python, "-c", _ON_A_CLUSTER, SAMPLES, folder])


_ON_A_CLUSTER = """
import sys
from distributed import LocalCluster
from dds_trace import analyze
if __name__ == "__main__":
    with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None) as workers:
        assert len(analyze(sys.argv[1], out=sys.argv[2], cluster=workers.scheduler_address).summary)
"""


def bags(programs: Path, folder: Path) -> None:
    """Replay a recorded bag."""
    run([programs / "python", "-c", BAG, folder / "bag"])
    exchange("socket", programs, folder, "--data", f"bag:{folder / 'bag'}#/said")


PARTS: Mapping[str, Callable[[Path, Path], None]] = {
    "": core,
    "ros2": partial(exchange, "ros2"),
    "cyclonedds": partial(exchange, "cyclonedds"),
    "zenoh": partial(exchange, "zenoh"),
    "connext": connext,
    "analyze": analyze,
    "cluster": cluster,
    "bags": bags,
}
"""Extra, or nothing -> what it must do when it is installed alone."""

WITHOUT_WHEELS = {
    ("ros2", "x86_64-manylinux_2_28"): "empy, pure Python, comes as source",
    ("ros2", "aarch64-manylinux_2_28"): "ROS 2's wheels are x86_64's; a board takes it from apt",
}
"""(extra, platform) -> why it has no wheels alone."""
NOT_FOR = {("cyclonedds", "3.14"): "cyclonedds 11.0.1 has wheels up to Python 3.13"}
"""(extra, Python) -> why the extra brings nothing there."""


def build(folder: Path) -> Path:
    """Build and check the source archive and the wheel; return the wheel.

    Raises:
        CheckError: one of the checks found something.
    """
    for earlier in folder.glob("dds_trace-*"):  # of another version, perhaps
        earlier.unlink()
    run(["uv", "build", "--quiet", "--out-dir", folder, TOP])
    built = sorted(folder.glob("dds_trace-*"))
    run(["uv", "tool", "run", "--quiet", "twine", "check", "--strict", *built])
    (wheel,) = folder.glob("*.whl")
    run(["uv", "tool", "run", "--quiet", "check-wheel-contents", wheel])
    return wheel


def check_part(wheel: Path, python: str, extra: str) -> None:
    """Install the wheel with one extra into a new environment and let it do its part.

    Raises:
        CheckError: it cannot be installed or does not do it.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run(["uv", "venv", "--quiet", "--python", python, folder / "environment"])
        programs = folder / "environment/bin"
        asked = f"dds-trace[{extra}] @ {wheel.as_uri()}" if extra else f"dds-trace @ {wheel.as_uri()}"
        run(["uv", "pip", "install", "--quiet", "--python", programs / "python", asked])
        (folder / "out").mkdir()
        PARTS[extra](programs, folder / "out")


def check_wheels(version: str, platform: str, extra: str) -> None:
    """Resolve the dependencies of an extra from wheels alone.

    Raises:
        CheckError: one has none, and is not listed; or is listed, and all have.
    """
    command = ["uv", "pip", "compile", "--quiet", "--python-platform", platform, "--python-version", version]
    command += ["--only-binary", ":all:", *(["--extra", extra] if extra else []), str(TOP / "pyproject.toml")]
    try:
        run(command)
    except CheckError:
        if (extra, platform) not in WITHOUT_WHEELS:
            raise
    else:
        if (extra, platform) in WITHOUT_WHEELS:
            raise CheckError("has wheels by now: take it out of WITHOUT_WHEELS")


class Checks:
    """Checks one after another, a line each; `failed` holds the names of those that failed."""

    def __init__(self) -> None:
        self.failed: list[str] = []

    def do(self, name: str, check: Callable[[], Result]) -> Result | None:
        """Do one check and print its line; return what it returned, None if it failed."""
        try:
            result = check()
        except (CheckError, subprocess.TimeoutExpired) as err:
            self.fail(name, str(err))
            return None
        print(f"ok       {name}", flush=True)
        return result

    def fail(self, name: str, why: str) -> None:
        """Print the line of a check that failed."""
        self.failed.append(name)
        print(f"FAILED   {name}: {why}", flush=True)


def main() -> int:
    """Run every check; return 1 if one failed or a Python is missing."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", nargs="*", default=list(PYTHONS), help="versions; all by default")
    parser.add_argument("--extra", nargs="*", default=list(PARTS), help="extras; all by default, '' is none")
    parser.add_argument("--dist", type=Path, default=TOP / "out/dist", help="folder of the archives")
    asked = parser.parse_args()
    checks = Checks()
    wheel = checks.do("archives", partial(build, asked.dist))
    if wheel is None:
        return 1
    for version in asked.python:
        extras = [extra for extra in asked.extra if (extra, version) not in NOT_FOR]
        for extra in extras:
            for platform in PLATFORMS:
                name = f"wheels of [{extra}] for Python {version} on {platform}"
                checks.do(name, partial(check_wheels, version, platform, extra))
        find = ["uv", "python", "find", "--no-python-downloads", version]
        found = subprocess.run(find, capture_output=True, text=True, check=False)
        if found.returncode:
            checks.fail(f"Python {version}", "not on this machine, so nothing was tried on it")
            continue
        for extra in extras:
            part = partial(check_part, wheel, found.stdout.strip(), extra)
            checks.do(f"[{extra}] alone on Python {version}", part)
    bill = ["uv", "tool", "run", "--quiet", "--from", "cyclonedx-bom", "cyclonedx-py", "environment"]
    bill += ["--output-file", asked.dist / "sbom.json", sys.executable]
    checks.do("bill of materials", partial(run, bill))
    print(f"{len(checks.failed)} failed" if checks.failed else "all passed")
    return bool(checks.failed)


if __name__ == "__main__":
    sys.exit(main())
