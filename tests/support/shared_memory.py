"""Shared-memory files that killed middleware processes leave in /dev/shm, where nobody else would remove them.

Tests that SIGKILL a recorder are about our traces; that Fast DDS and zenoh cannot clean up then is no fault of
theirs, and the machine is left as it was found.
"""

import os
import shutil
from contextlib import suppress
from pathlib import Path

import pytest

SHM = Path("/dev/shm")
PATTERNS = ("fastrtps_*", "sem.fastrtps_*", "fastdds_*", "sem.fastdds_*", "*.zenoh")


OWN_SHM = (
    *("unshare", "--mount", "--propagation", "private", "sh", "-c"),
    *('mount -t tmpfs -o mode=1777 tmpfs /dev/shm && exec "$@"', "sh"),
)
"""Becomes the command behind it with a /dev/shm of its own, as a container has one."""

needs_root = pytest.mark.skipif(
    os.geteuid() != 0 or shutil.which("unshare") is None, reason="a /dev/shm of its own needs root and unshare"
)


def middleware_files() -> set[Path]:
    return {path for pattern in PATTERNS for path in SHM.glob(pattern)}


def files_in_use() -> set[str]:
    used: set[str] = set()
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has ended meanwhile
            for descriptor in (process / "fd").iterdir():  # first: a file is opened, then mapped, then closed
                with suppress(OSError):
                    used.add(str(descriptor.readlink()))
            lines = (process / "maps").read_text().splitlines()
            used.update(line[line.index("/dev/shm/") :] for line in lines if "/dev/shm/" in line)
    return used


def remove_orphans(found_before: set[Path]) -> list[Path]:
    """Remove what came since `found_before` and no process uses any more; what was removed."""
    came = middleware_files() - found_before  # first: what another test makes during the look is in use
    used = files_in_use()
    orphans = [path for path in came if str(path) not in used]
    for path in orphans:
        path.unlink(missing_ok=True)
    return orphans
