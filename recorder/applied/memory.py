"""Shared memory of one process: what of `/dev/shm` it maps, whose it is, and whether it is this namespace's."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from .vendors import PORT, SEGMENT, memory_owner, vendor_facts

if TYPE_CHECKING:
    from collections.abc import Iterator

SHM = Path("/dev/shm")  # noqa: S108 - POSIX shared memory of Linux, shm_overview(7)

# Address range, permissions, offset, device, inode, path; proc_pid_maps(5).
_MAPPING = re.compile(r"^(\w+)-(\w+) \S+ \w+ (\w+):(\w+) (\d+) +(?:/dev/shm/|/(?=SYSV))(.+)$", re.MULTILINE)
_DELETED = " (deleted)"
_LOCK = "_el"
"""Suffix of the file by whose lock Fast DDS tells the others that a segment or a port is in use."""


@dataclass(frozen=True, slots=True)
class SharedMemory:
    """One shared-memory file of a middleware that the process maps.

    Attributes:
        name: file name in `/dev/shm`.
        middleware: vendor whose naming it follows.
        role: `segment` (payloads) or `port` (queue of one receiver).
        size_bytes: size of the file; of the mapping where the file is gone.
        owner_uid: user who owns the file, None where it is gone.
        is_own: this process made it, None where the middleware leaves no sign of that.
        is_served: some process holds it in use, None where the middleware leaves no sign of that.
        is_deleted: its file was removed; the memory is a remainder of a participant that has ended.
        is_here: the file of that name in this namespace's `/dev/shm` is the one that is mapped.
    """

    name: str
    middleware: str
    role: str
    size_bytes: int
    owner_uid: int | None = None
    is_own: bool | None = None
    is_served: bool | None = None
    is_deleted: bool = False
    is_here: bool = True

    @property
    def is_in_use(self) -> bool:
        """Whether it can carry messages: everything but remainders of participants that have ended."""
        return not self.is_deleted

    @property
    def is_foreign_segment(self) -> bool:
        """Whether it is the segment of another process, from which this one has received."""
        return self.is_in_use and self.role == SEGMENT and self.is_own is False

    @property
    def is_unserved_port(self) -> bool:
        """Whether it is the queue of a receiver that is not in this namespace, or not any more."""
        return self.is_in_use and self.role == PORT and self.is_served is False


@dataclass(frozen=True, slots=True)
class _Mapped:
    device: int
    inode: int
    size_bytes: int
    is_deleted: bool


def read_memory(pid: int | None = None, folder: Path = SHM) -> tuple[SharedMemory, ...] | None:
    """Return the middlewares' shared memory that a process maps, by name.

    Args:
        pid: a process of the caller's mount namespace, the calling one by default.
        folder: where this namespace has its shared memory.

    Returns:
        None where the process cannot be looked at: nothing is known.
    """
    process = Path("/proc") / str(os.getpid() if pid is None else pid)
    try:
        mapped = parse_maps((process / "maps").read_text(errors="replace"))
    except OSError:
        return None
    opened = set(_opened_names(process))
    return tuple(
        _shared_memory(name, owner, found, opened, folder)
        for name, found in sorted(mapped.items())
        if (owner := memory_owner(name)) is not None
    )


def parse_maps(text: str) -> dict[str, _Mapped]:
    """Return the shared memory in the text of `/proc/PID/maps`: name -> its mappings as one."""
    mapped: dict[str, _Mapped] = {}
    for begin, end, major, minor, inode, path in _MAPPING.findall(text):
        name = path.removesuffix(_DELETED)
        size_bytes = int(end, 16) - int(begin, 16)
        before = mapped[name].size_bytes if name in mapped else 0
        # The kernel calls every System V segment deleted.
        is_deleted = path.endswith(_DELETED) and not path.startswith("SYSV")
        device = os.makedev(int(major, 16), int(minor, 16))
        mapped[name] = _Mapped(device, int(inode), before + size_bytes, is_deleted)
    return mapped


def _opened_names(process: Path) -> Iterator[str]:
    with suppress(OSError):
        for descriptor in (process / "fd").iterdir():
            with suppress(OSError):  # closed meanwhile
                target = descriptor.readlink()
                if target.parent == SHM:
                    yield target.name


def _shared_memory(
    name: str, owner: tuple[str, str], mapped: _Mapped, opened: set[str], folder: Path
) -> SharedMemory:
    vendor, role = owner
    try:
        file = (folder / name).stat()
    except OSError:
        file = None
    is_the_file = file is not None and (file.st_dev, file.st_ino) == (mapped.device, mapped.inode)
    has_locks = vendor_facts(vendor).locks_own_files
    return SharedMemory(
        name,
        vendor,
        role,
        size_bytes=file.st_size if file is not None and is_the_file else mapped.size_bytes,
        owner_uid=file.st_uid if file is not None and is_the_file else None,
        is_own=name + _LOCK in opened if has_locks else None,
        is_served=(folder / (name + _LOCK)).exists() if has_locks else None,
        is_deleted=mapped.is_deleted,
        is_here=is_the_file or mapped.is_deleted or name.startswith("SYSV"),
    )
