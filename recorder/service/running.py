"""The recordings that run on this machine: a file for each in a folder of the runtime, locked by its process while it lives.

An entry is believed only while its lock is held and its process, by id and start time, is there. One without is what a
killed process left; it tells where its events wait.
"""

from __future__ import annotations

import fcntl
import json
import os
import secrets
import stat
import tempfile
import time
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.base.files import open_regular
from dds_trace.tracefile.format.ring import ring_path

from .rotation import later_files

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from dds_trace.tracefile.format.descriptions import Session

SUFFIX = ".recording"
ENTRY_BYTES = 8192
"""Length of an entry: it is written over in place, in one step, and never becomes shorter."""
_MOST_ENTRY_BYTES = 1 << 16
_TRIES = 3


@dataclass(frozen=True, slots=True)
class Entry:
    """What a recording tells of itself.

    Attributes:
        role: `ping` or `relay`.
        path: the trace file that is written now, absolute.
        pid: its process.
        pid_start: start time of the process in clock ticks since boot, which tells it from a later one of the same id.
        session_id: 16 hex digits.
        domain_id: its DDS domain.
        backend: its backend.
        rmw: its ROS middleware, None without.
        began_ns: its start, ns since 1970.
        told_ns: the time of this word, ns since 1970.
        messages: messages that a relay has sent back, or replies that a ping has got.
        files: number of files so far, above 1 with `--rotate`.
        stopped: the reason why nothing is recorded any more while the node goes on; None while all is well.
    """

    role: str
    path: str
    pid: int
    pid_start: int
    session_id: str
    domain_id: int
    backend: str
    rmw: str | None
    began_ns: int
    told_ns: int
    messages: int = 0
    files: int = 1
    stopped: str | None = None


class State(Enum):
    """What is known of the process of an entry."""

    RUNNING = "running"
    KILLED = "killed"
    UNSEEN = "unseen"
    """Somebody holds its lock, and its process is not seen from here (another container)."""


@dataclass(frozen=True, slots=True)
class Listed:
    """One recording as `dds-record status` lists it.

    Attributes:
        entry: what it told last.
        state: what is known of its process.
        waiting: the trace of a killed one beside which events wait in the ring; None if nothing of it waits.
    """

    entry: Entry
    state: State
    waiting: Path | None = None


def runtime_folder(environment: Mapping[str, str] = os.environ) -> Path:
    """Return the folder of this process's entry: a service's own, else the user's of the runtime, else a temporary one."""
    given = environment.get("RUNTIME_DIRECTORY", "").split(":")[0]
    if given:
        return Path(given)
    user = environment.get("XDG_RUNTIME_DIR", "")
    return Path(user, "dds-trace") if user else Path(tempfile.gettempdir(), f"dds-trace-{os.getuid()}")


def runtime_folders(environment: Mapping[str, str] = os.environ) -> list[Path]:
    """Return the folders with entries of this machine: this user's, those of services and of other users."""
    others = [
        *Path("/run").glob("dds-trace/*/"),
        *Path("/run/user").glob("*/dds-trace/"),
        *Path(tempfile.gettempdir()).glob("dds-trace-*/"),
    ]
    return list(dict.fromkeys([runtime_folder(environment), *sorted(others)]))


class RunningRecording:
    """The entry of this process, from its first word until `close`; where none can be made, the recording goes on without.

    Args:
        session: the recording.
        path: its trace file.
        folder: the folder of the entry.
    """

    def __init__(self, session: Session, path: Path, folder: Path | None = None) -> None:
        folder = runtime_folder() if folder is None else folder
        self._path = folder / f"{session.session_id:016x}{SUFFIX}"
        self._descriptor: int | None = None
        self._entry = Entry(
            role=session.role,
            path=str(path.absolute()),
            pid=os.getpid(),
            pid_start=_start_of(os.getpid()) or 0,
            session_id=f"{session.session_id:016x}",
            domain_id=session.domain_id,
            backend=session.backend,
            rmw=session.rmw,
            began_ns=time.time_ns(),
            told_ns=time.time_ns(),
        )
        with suppress(OSError):
            folder.mkdir(mode=0o700 if "RUNTIME_DIRECTORY" not in os.environ else 0o755, exist_ok=True)
            if _is_own(folder):
                _sweep(folder)
                self._open()

    def _open(self) -> None:
        # Locked before it has its name, so that nobody meets an entry without a lock.
        draft = self._path.with_name(f".{self._path.name}.{secrets.token_hex(4)}")
        descriptor = os.open(draft, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._descriptor = descriptor
            self._write()
            draft.rename(self._path)
        except OSError:
            self._descriptor = None
            draft.unlink(missing_ok=True)
            os.close(descriptor)

    def tell(self, *, path: Path, messages: int, files: int, stopped: str | None) -> None:
        """Tell how it is now."""
        if self._descriptor is not None:
            told = {"path": str(path.absolute()), "messages": messages, "files": files, "stopped": stopped}
            self._entry = Entry(**{**asdict(self._entry), **told, "told_ns": time.time_ns()})
            with suppress(OSError):
                self._write()

    def close(self) -> None:
        """Take the entry away."""
        if self._descriptor is not None:
            with suppress(OSError):
                self._path.unlink(missing_ok=True)
            os.close(self._descriptor)
            self._descriptor = None

    def _write(self) -> None:
        assert self._descriptor is not None
        text = json.dumps(asdict(self._entry)).encode()
        os.pwrite(self._descriptor, text.ljust(ENTRY_BYTES), 0)


def list_recordings(folders: Iterable[Path] | None = None) -> list[Listed]:
    """Return the recordings of this machine, running ones first, then by their start."""
    found = []
    for folder in runtime_folders() if folders is None else folders:
        with suppress(OSError):
            found += [listed for path in sorted(folder.glob(f"*{SUFFIX}")) if (listed := _look(path))]
    return sorted(found, key=lambda each: (each.state is not State.RUNNING, each.entry.began_ns))


def _look(path: Path) -> Listed | None:
    """Return what an entry tells; None if it cannot be read, or went meanwhile."""
    with suppress(OSError), open_regular(path, follow_links=False) as file:
        for _ in range(_TRIES):  # another look, should one fall into the middle of a word
            text = os.pread(file.fileno(), _MOST_ENTRY_BYTES, 0)
            entry = _parse(text)
            if entry is not None:
                break
        else:
            return None
        is_held = _is_locked(file.fileno())
        if is_held and _start_of(entry.pid) == entry.pid_start:
            return Listed(entry, State.RUNNING)
        if is_held:
            return Listed(entry, State.UNSEEN)
        if not path.exists():
            return None
        return Listed(entry, State.KILLED, _waiting_trace(Path(entry.path), int(entry.session_id, 16)))
    return None


def _waiting_trace(path: Path, session_id: int) -> Path | None:
    """Return the file beside which a ring was left: the one that was told last, or a later one, begun behind the last word."""
    return next((each for each in (path, *later_files(path, session_id)) if ring_path(each).exists()), None)


def _parse(text: bytes) -> Entry | None:
    try:
        told = json.loads(text)
        return Entry(**{each.name: told[each.name] for each in fields(Entry)})
    except (ValueError, KeyError, TypeError, RecursionError):
        return None


def _is_locked(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    fcntl.flock(descriptor, fcntl.LOCK_UN)
    return False


def _start_of(pid: int) -> int | None:
    """Return the start time of a process in clock ticks since boot; None if it is not there."""
    try:
        return int(Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[19])
    except (OSError, ValueError, IndexError):
        return None


def _is_own(folder: Path) -> bool:
    """Return whether a folder, which may lie where everybody writes, is this user's and nobody else's to write."""
    status = folder.lstat()
    return stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & 0o022


def _sweep(folder: Path) -> None:
    """Remove entries of killed processes of which nothing waits any more."""
    for path in folder.glob(f"*{SUFFIX}"):
        listed = _look(path)
        if listed is not None and listed.state is State.KILLED and listed.waiting is None:
            with suppress(OSError):
                path.unlink()
