"""A small disk that no other test and no other program writes to: a tmpfs in a mount namespace of its own."""

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

needs_root = pytest.mark.skipif(
    os.geteuid() != 0 or shutil.which("unshare") is None or shutil.which("nsenter") is None,
    reason="a disk of its own needs root, unshare and nsenter",
)


@dataclass(frozen=True)
class SmallDisk:
    """The disk, while the process that holds its namespace lives.

    Attributes:
        prefix: a command that becomes another one, which sees the disk.
        inside: its folder, as that other one names it.
        outside: the same, as we name it.
    """

    prefix: tuple[str, ...]
    inside: Path
    outside: Path

    @property
    def free_bytes(self) -> int:
        status = os.statvfs(self.outside)
        return status.f_bavail * status.f_frsize


@contextmanager
def small_disk(folder: Path, size_bytes: int) -> Iterator[SmallDisk]:
    """A disk mounted at `folder`, which is made; it is gone behind the block."""
    folder.mkdir()
    script = 'mount -t tmpfs -o "size=$1" none "$0" && echo ready && exec sleep infinity'
    holder = subprocess.Popen(
        ["unshare", "--mount", "--propagation", "private", "sh", "-c", script, folder, str(size_bytes)],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "ready\n"
        of_holder = Path(f"/proc/{holder.pid}/root")
        enter = ("nsenter", "--target", str(holder.pid), "--mount")
        yield SmallDisk(enter, folder, of_holder / folder.relative_to("/"))
    finally:
        holder.kill()
        holder.communicate()
