"""Shared memory of one process: what of `/dev/shm` it maps, whose it is, and whether it is this namespace's."""

from __future__ import annotations

import fcntl
import os
import re
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

from .vendors import PORT, SEGMENT, memory_owner, vendor_facts

if TYPE_CHECKING:
    from collections.abc import Iterator

SHM = Path("/dev/shm")  # noqa: S108 - POSIX shared memory of Linux, shm_overview(7)

# Address range, permissions, offset, device, inode, path; proc_pid_maps(5).
_MAPPING = re.compile(r"^(\w+)-(\w+) \S+ \w+ (\w+):(\w+) (\d+) +(?:/dev/shm/|/(?=SYSV))(.+)$", re.MULTILINE)
_DELETED = " (deleted)"
_LOOKS = 3
"""Looks until a file that is mapped and not here is believed: one that is removed between maps and folder is a remainder."""
_PORT_NUMBER = re.compile(r"\d+$")
_LOCK = "_el"
"""Suffix of the file by whose lock Fast DDS tells the others that a segment, or the port of one receiver, is in use."""
_LOCK_TESTS = {_LOCK: fcntl.LOCK_SH, "_sl": fcntl.LOCK_EX}
"""Suffix of a lock file -> lock that nobody gets while it is held: `_el` is held exclusively, `_sl` (the port of a multicast
group) by each of its receivers at once."""


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
        is_served: some process holds its lock, None where the middleware has none or it cannot be looked at.
        is_abandoned: its lock is there and nobody holds it: the process that served it was killed.
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
    is_abandoned: bool = False
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
        """Whether it is the queue of a receiver that is not in this namespace; one that was killed here is another matter."""
        return self.is_in_use and self.role == PORT and self.is_served is False and not self.is_abandoned

    @property
    def port_number(self) -> int | None:
        """RTPS port of a receiver's queue, as its name tells it; None for a segment."""
        number = _PORT_NUMBER.search(self.name) if self.role == PORT else None
        return int(number[0]) if number else None


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
    memory: tuple[SharedMemory, ...] = ()
    for _ in range(_LOOKS):
        try:
            mapped = parse_maps((process / "maps").read_text(errors="replace"))
        except OSError:
            return None
        opened = set(_opened_names(process))
        memory = tuple(
            _shared_memory(name, owner, found, opened, folder)
            for name, found in sorted(mapped.items())
            if (owner := memory_owner(name)) is not None
        )
        if all(each.is_here for each in memory):
            break
    return memory


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
    locks = {
        _look_at_lock(folder / (name + suffix), lock)
        for suffix, lock in (_LOCK_TESTS.items() if has_locks else ())
    }
    return SharedMemory(
        name,
        vendor,
        role,
        size_bytes=file.st_size if file is not None and is_the_file else mapped.size_bytes,
        owner_uid=file.st_uid if file is not None and is_the_file else None,
        is_own=name + _LOCK in opened if has_locks else None,
        is_served=_Lock.HELD in locks or (None if _Lock.UNKNOWN in locks or not locks else False),
        is_abandoned=_Lock.FREE in locks and _Lock.HELD not in locks,
        is_deleted=mapped.is_deleted,
        is_here=is_the_file or mapped.is_deleted or name.startswith("SYSV"),
    )


class _Lock(Enum):
    """State of a lock file."""

    HELD = "held"
    FREE = "free"
    ABSENT = "absent"
    UNKNOWN = "unknown"


def _look_at_lock(path: Path, lock: int) -> _Lock:
    """Return the state of a lock file by trying to get a lock, as Fast DDS itself does.

    A lock that is held is not touched. One that nobody holds is ours for some microseconds, in which a Fast DDS that is just
    starting takes it for another's: it then chooses the next port, as it does for a port that is in use.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except FileNotFoundError:
        return _Lock.ABSENT
    except OSError:
        return _Lock.UNKNOWN
    try:
        fcntl.flock(descriptor, lock | fcntl.LOCK_NB)
        fcntl.flock(
            descriptor, fcntl.LOCK_UN
        )  # closing is not enough while a child that was just forked has it, too
    except BlockingIOError:
        return _Lock.HELD
    except OSError:  # a file system without locks
        return _Lock.UNKNOWN
    finally:
        os.close(descriptor)
    return _Lock.FREE
