"""An arm64 Python on this machine: Debian's packages unpacked into a folder, aarch64 wheels beside them, run by qemu-user."""

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from zipfile import ZipFile

import pytest
from processes import executed

from dds_trace.base.version import __version__

REPOSITORY = Path(__file__).parents[2]
QEMU = shutil.which("qemu-aarch64-static") or shutil.which("qemu-aarch64")
PACKAGES = ("python3", "libexpat1", "libstdc++6")
WHEELS = ("cramjam", "eclipse-zenoh", "mcap", "numpy", "psutil", "rich", "tomli", "typer>=0.26,<0.29", "zstandard")
PIPS = ((sys.executable, "-m", "pip"), ("pip3",), ("pip",))
PLATFORMS = ("manylinux2014_aarch64", "manylinux_2_17_aarch64", "manylinux_2_28_aarch64", "linux_aarch64")

needs_arm = pytest.mark.skipif(
    QEMU is None or shutil.which("apt-get") is None or shutil.which("dpkg-deb") is None,
    reason="qemu-user-static (or qemu-user), apt-get or dpkg-deb is not installed",
)


@dataclass(frozen=True)
class ArmPython:
    root: Path
    wheels: Path

    @property
    def words(self) -> list[str]:
        (program,) = self.root.glob("usr/bin/python3.[0-9]*[0-9]")
        return [str(QEMU), "-L", str(self.root), str(program)]

    @property
    def environment(self) -> dict[str, str]:
        paths = (self.wheels, REPOSITORY / "src")
        return {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, paths)), "PYTHONDONTWRITEBYTECODE": "1"}

    def run(self, *arguments: object) -> str:
        done = executed([*self.words, *arguments], env=self.environment)
        assert done.returncode == 0, done.stderr
        return done.stdout


def unpack(folder: Path) -> ArmPython:
    """Download and unpack everything (two minutes); skips by name where the archive cannot be reached."""
    root, wheels = folder / "root", folder / "wheels"
    archives = _download_packages(folder / "apt")
    for archive in archives:
        subprocess.run(["dpkg-deb", "-x", str(archive), str(root)], check=True)
    for name in ("lib", "bin"):  # merged into /usr
        if not (root / name).exists():
            (root / name).symlink_to(f"usr/{name}")
    (program,) = root.glob("usr/bin/python3.[0-9]*[0-9]")
    _download_wheels(folder / "downloads", program.name.removeprefix("python"))
    for wheel in (folder / "downloads").glob("*.whl"):
        with ZipFile(wheel) as file:
            file.extractall(wheels)
    _describe_ourselves(wheels)
    return ArmPython(root, wheels)


def _download_packages(folder: Path) -> list[Path]:
    """The packages of Python with all that they depend on, by an apt of its own: the system's stays as it is."""
    for part in ("state/lists/partial", "cache/archives/partial"):
        (folder / part).mkdir(parents=True)
    (folder / "status").touch()
    options = {
        "APT::Architecture": "arm64",
        "APT::Architectures": "arm64",
        "APT::Install-Recommends": "false",
        "APT::Sandbox::User": "root",
        "Dir::State": f"{folder}/state",
        "Dir::State::status": f"{folder}/status",
        "Dir::Cache": f"{folder}/cache",
    }
    words = [word for name, value in options.items() for word in ("-o", f"{name}={value}")]
    for action in (["update"], ["install", "--download-only", "--yes", *PACKAGES]):
        done = subprocess.run(["apt-get", *words, *action], capture_output=True, text=True, check=False)
        if done.returncode:
            pytest.skip(f"Debian's arm64 packages cannot be had here: {done.stderr.strip()[-200:]}")
    return sorted((folder / "cache" / "archives").glob("*.deb"))


def _runs(*command: str) -> bool:
    try:
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        return False


def _download_wheels(folder: Path, version: str) -> None:
    pip = next((pip for pip in PIPS if _runs(*pip, "--version")), None)
    if pip is None:
        pytest.skip("pip is not installed")
    platforms = [word for platform in PLATFORMS for word in ("--platform", platform)]
    command = [*pip, "download", "--quiet", "--dest", str(folder), "--only-binary", ":all:", *platforms]
    done = subprocess.run([*command, "--python-version", version, *WHEELS], capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"aarch64 wheels cannot be had here: {done.stderr.strip()[-200:]}")


def _describe_ourselves(wheels: Path) -> None:
    folder = wheels / f"dds_trace-{__version__}.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: dds-trace\nVersion: {__version__}\n")
