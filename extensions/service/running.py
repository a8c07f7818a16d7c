"""The recordings on this machine: for each a file in a runtime folder, locked by its process.

An entry without a lock was left by a killed process, and names the file of the ring in which events wait.
"""

from __future__ import annotations

import fcntl
import json
import os
import secrets
import stat
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from enum import Enum
from pathlib import Path

from dds_trace.base.files import is_locked, open_regular
from dds_trace.base.printable import printable
from dds_trace.base.records import from_json
from dds_trace.tracefile.format.descriptions import Session
from dds_trace.tracefile.format.ring import ring_path

from .rotation import later_files

SUFFIX = ".recording"
ENTRY_BYTES = 8192
"""An entry has this length, so that one write replaces it."""
_MOST_ENTRY_BYTES = 1 << 16
_TRIES = 3


@dataclass(frozen=True, slots=True)
class Entry:
    """The state of a recording, as `dds-trace record status --json` prints it; `causes` are what a relay that nothing reached sees of itself."""

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
    causes: tuple[str, ...] = ()


class State(Enum):
    RUNNING = "running"
    KILLED = "killed"
    UNSEEN = "unseen"
    """Locked, but its process is in another container."""


@dataclass(frozen=True, slots=True)
class Listed:
    entry: Entry
    state: State
    waiting: Path | None = None


def runtime_folder(environment: Mapping[str, str] = os.environ) -> Path:
    service = environment.get("RUNTIME_DIRECTORY", "").split(":")[0]
    if service:
        return Path(service)
    user = environment.get("XDG_RUNTIME_DIR", "")
    return Path(user, "dds-trace") if user else Path(tempfile.gettempdir(), f"dds-trace-{os.getuid()}")


def runtime_folders(environment: Mapping[str, str] = os.environ) -> list[Path]:
    others = [
        *Path("/run").glob("dds-trace/*/"),
        *Path("/run/user").glob("*/dds-trace/"),
        *Path(tempfile.gettempdir()).glob("dds-trace-*/"),
    ]
    return list(dict.fromkeys([runtime_folder(environment), *sorted(others)]))


class RunningRecording:
    def __init__(self, session: Session, path: Path, folder: Path | None = None) -> None:
        folder = runtime_folder() if folder is None else folder
        self._path = folder / f"{session.session_id:016x}{SUFFIX}"
        self._descriptor: int | None = None
        self.causes: tuple[str, ...] = ()
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
        # Locked before it gets its name, so that no reader sees an entry without a lock.
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

    def update(self, *, path: Path, messages: int, files: int, stopped: str | None) -> None:
        if self._descriptor is not None:
            self._entry = replace(
                self._entry,
                path=str(path.absolute()),
                messages=messages,
                files=files,
                stopped=stopped,
                causes=self.causes,
                told_ns=time.time_ns(),
            )
            with suppress(OSError):
                self._write()

    def close(self) -> None:
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
    recordings: list[Listed] = []
    for folder in runtime_folders() if folders is None else folders:
        with suppress(OSError):
            recordings += filter(None, map(_read_entry, folder.glob(f"*{SUFFIX}")))
    return sorted(recordings, key=lambda listed: (listed.state is not State.RUNNING, listed.entry.began_ns))


def causes_of_relays(domain_id: int) -> Iterator[str]:
    """Yield what relays of the domain on this machine, of any container, see of themselves."""
    for listed in list_recordings():
        entry = listed.entry
        if entry.role == "relay" and entry.domain_id == domain_id and listed.state is not State.KILLED:
            yield from (
                f"at the relay (process {entry.pid}, {entry.backend}): {printable(cause, 300)}"
                for cause in entry.causes
            )


def _read_entry(path: Path) -> Listed | None:
    with suppress(OSError), open_regular(path, follow_links=False) as file:
        for _ in range(_TRIES):  # a write may be under way
            entry = _parse(os.pread(file.fileno(), _MOST_ENTRY_BYTES, 0))
            if entry is not None:
                break
        else:
            return None
        if is_locked(file.fileno()):
            is_seen = _start_of(entry.pid) == entry.pid_start
            return Listed(entry, State.RUNNING if is_seen else State.UNSEEN)
        if not path.exists():
            return None
        trace = Path(entry.path)
        files = (trace, *later_files(trace, int(entry.session_id, 16)))  # or one after its last update
        return Listed(entry, State.KILLED, next((file for file in files if ring_path(file).exists()), None))
    return None


def _parse(text: bytes) -> Entry | None:
    try:
        return from_json(Entry, json.loads(text))
    except (ValueError, RecursionError):
        return None


def _start_of(pid: int) -> int | None:
    try:
        return int(Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[19])
    except (OSError, ValueError, IndexError):
        return None


def _is_own(folder: Path) -> bool:
    status = folder.lstat()
    return stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & 0o022


def _sweep(folder: Path) -> None:
    for path in folder.glob(f"*{SUFFIX}"):
        listed = _read_entry(path)
        if listed is not None and listed.state is State.KILLED and listed.waiting is None:
            with suppress(OSError):
                path.unlink()
