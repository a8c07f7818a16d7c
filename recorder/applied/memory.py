"""What one process maps: a middleware's shared memory, and its libraries with versions."""

from __future__ import annotations

import fcntl
import os
import re
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from functools import cache
from importlib import metadata
from pathlib import Path

from ..kernel.sockets import open_files
from .vendors import PORT, SEGMENT, VENDORS, memory_owner, vendor_facts

SHM = Path("/dev/shm")  # noqa: S108 - POSIX shared memory of Linux, shm_overview(7)

# Address range, permissions, offset, device, inode, path; proc_pid_maps(5).
_MAPPING = re.compile(r"^(\w+)-(\w+) \S+ \w+ (\w+):(\w+) (\d+) +(?:/dev/shm/|/(?=SYSV))(.+)$", re.MULTILINE)
_DELETED = " (deleted)"
_ATTEMPTS = 3
"""Readings before a mapped file counts as missing: it may be removed between maps and folder."""
_PORT_NUMBER = re.compile(r"\d+$")
_LOCK = "_el"
"""Fast DDS locks this file while a segment, or the port of one receiver, is in use."""
_LOCK_TESTS = {_LOCK: fcntl.LOCK_SH, "_sl": fcntl.LOCK_EX}
"""Lock that fails while the file is locked: `_el` exclusively, `_sl` (a multicast port) by each receiver."""


@dataclass(frozen=True, slots=True)
class SharedMemory:
    """One shared-memory file of a middleware that the process maps (docs/trace-format.md); None is unknown."""

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
        return not self.is_deleted

    @property
    def is_foreign_segment(self) -> bool:
        return self.is_in_use and self.role == SEGMENT and self.is_own is False

    @property
    def is_unserved_port(self) -> bool:
        return self.is_in_use and self.role == PORT and self.is_served is False and not self.is_abandoned

    @property
    def port_number(self) -> int | None:
        number = _PORT_NUMBER.search(self.name) if self.role == PORT else None
        return int(number[0]) if number else None


@dataclass(frozen=True, slots=True)
class _Mapped:
    device: int
    inode: int
    size_bytes: int
    is_deleted: bool


def read_memory(pid: int | None = None, folder: Path = SHM) -> tuple[SharedMemory, ...] | None:
    pid = os.getpid() if pid is None else pid
    memory: tuple[SharedMemory, ...] = ()
    for _ in range(_ATTEMPTS):
        try:
            mapped = parse_maps(Path(f"/proc/{pid}/maps").read_text(errors="replace"))
        except OSError:
            return None
        opened: set[str] = set()
        with suppress(OSError):
            opened.update(target.name for _, target in open_files(pid) if target.parent == SHM)
        memory = tuple(
            _shared_memory(name, owner, mapping, opened, folder)
            for name, mapping in sorted(mapped.items())
            if (owner := memory_owner(name)) is not None
        )
        if all(file.is_here for file in memory):
            break
    return memory


def parse_maps(text: str) -> dict[str, _Mapped]:
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


def ports_of_others(ports: range, folder: Path = SHM) -> dict[str, int]:
    """Return the receivers' queues of RTPS ports to which only another user can write: name -> user id."""
    owners: dict[str, int] = {}
    with suppress(OSError):
        for path in folder.iterdir():
            number = _PORT_NUMBER.search(path.name)
            if memory_owner(path.name) == ("fastdds", PORT) and number and int(number[0]) in ports:
                with suppress(OSError):  # removed meanwhile
                    owners[path.name] = path.stat().st_uid
    return {
        name: uid
        for name, uid in sorted(owners.items())
        if uid != os.geteuid() and _lock_state(folder / (name + _LOCK), _LOCK_TESTS[_LOCK]) is not _Lock.FREE
    }


def remove_own_segments(vendor: str, folder: Path = SHM) -> None:
    """Zenoh's locks are shared: the last process to give up its own locks exclusively."""
    for descriptor, path in open_files(os.getpid()):
        if path.parent == folder and memory_owner(path.name) == (vendor, SEGMENT):
            with suppress(OSError):
                fcntl.flock(descriptor, fcntl.LOCK_UN)
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                path.unlink()


def _shared_memory(name: str, owner: tuple[str, str], mapped: _Mapped, opened: set[str], folder: Path) -> SharedMemory:
    vendor, role = owner
    try:
        file = (folder / name).stat()
    except OSError:
        file = None
    is_the_file = file is not None and (file.st_dev, file.st_ino) == (mapped.device, mapped.inode)
    has_locks = vendor_facts(vendor).locks_own_files
    locks = {_lock_state(folder / (name + suffix), lock) for suffix, lock in (_LOCK_TESTS.items() if has_locks else ())}
    return SharedMemory(
        name,
        vendor,
        role,
        size_bytes=file.st_size if file is not None and is_the_file else mapped.size_bytes,
        owner_uid=file.st_uid if file is not None and is_the_file else None,
        is_own=name + _LOCK in opened if has_locks else None,
        is_served=_Lock.LOCKED in locks or (None if _Lock.UNKNOWN in locks or not locks else False),
        is_abandoned=_Lock.FREE in locks and _Lock.LOCKED not in locks,
        is_deleted=mapped.is_deleted,
        is_here=is_the_file or mapped.is_deleted or name.startswith("SYSV"),
    )


class _Lock(Enum):
    LOCKED = "locked"
    FREE = "free"
    ABSENT = "absent"
    UNKNOWN = "unknown"


def _lock_state(path: Path, lock: int) -> _Lock:
    """Try to get a lock, as Fast DDS does; a Fast DDS that starts in these microseconds chooses the next port."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except FileNotFoundError:
        return _Lock.ABSENT
    except OSError:
        return _Lock.UNKNOWN
    try:
        fcntl.flock(descriptor, lock | fcntl.LOCK_NB)
        fcntl.flock(descriptor, fcntl.LOCK_UN)  # closing is not enough while a forked child has it too
    except BlockingIOError:
        return _Lock.LOCKED
    except OSError:  # a file system without locks
        return _Lock.UNKNOWN
    finally:
        os.close(descriptor)
    return _Lock.FREE


_LOADED = re.compile(r"^\S+ r\S+ \w+ \S+ \d+ +(/\S.*\.so[.\d]*)$", re.MULTILINE)
_VERSION = re.compile(r"\.so\.(\d+(?:\.\d+)+)$")


@dataclass(frozen=True, slots=True)
class Library:
    """A loaded library of a middleware; `version` is from the file name or the Python distribution, else empty."""

    name: str
    vendor: str
    version: str = ""


def read_libraries(pid: int | None = None) -> tuple[Library, ...]:
    try:
        text = Path(f"/proc/{os.getpid() if pid is None else pid}/maps").read_text(errors="replace")
    except OSError:
        return ()
    return parse_libraries(text)


def parse_libraries(text: str) -> tuple[Library, ...]:
    paths = sorted({Path(path) for path in _LOADED.findall(text)})
    return tuple(
        Library(path.name, facts.vendor, _version(path, distribution))
        for path in paths
        for facts in VENDORS.values()
        for pattern, distribution in facts.libraries.items()
        if re.match(pattern, path.name)
    )


def _version(path: Path, distribution: str) -> str:
    match = _VERSION.search(path.name)
    in_name = match[1] if match else ""
    if in_name.count(".") >= 2 or not distribution:
        return in_name
    return _distribution_version(distribution) or in_name


@cache  # reads the file system, for the same few names at each snapshot
def _distribution_version(distribution: str) -> str:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return ""
