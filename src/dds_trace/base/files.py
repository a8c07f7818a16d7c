"""Files written whole or not at all, and read safely."""

from __future__ import annotations

import errno
import fcntl
import os
import re
import secrets
import stat
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from io import BufferedReader
from pathlib import Path
from typing import BinaryIO

from .errors import OptionError, OutputError

PLAN_COPY = "plan.toml"
"""Copy of its plan in the folder of a sweep."""


@contextmanager
def given_to_caller(out: Path) -> Iterator[None]:
    """Let what root writes below `out` within the block, and the folders made for it, belong to the user who called sudo."""
    owner = [os.environ.get(name, "") for name in ("SUDO_UID", "SUDO_GID")]
    if os.geteuid() or not all(map(str.isdecimal, owner)):
        yield
        return
    top = out.absolute()
    was_there, began_s = top.exists(), time.time() - 0.05  # the clock of files has ticks
    while not top.parent.exists():
        top = top.parent
    try:
        yield
    finally:
        with suppress(OSError):
            for folder, _, names, descriptor in os.fwalk(top):
                for name in names if was_there and folder == str(top) else (*names, "."):
                    status = os.stat(name, dir_fd=descriptor, follow_symlinks=False)
                    # A file with a second name is perhaps somebody else's.
                    is_own = stat.S_ISDIR(status.st_mode) or status.st_nlink == 1
                    if is_own and status.st_uid == 0 and status.st_ctime >= began_s:
                        os.chown(name, int(owner[0]), int(owner[1]), dir_fd=descriptor, follow_symlinks=False)


@contextmanager
def replacing(path: Path, *, fsync: bool = False) -> Iterator[Path]:
    """Yield a draft that replaces `path` once the block ends without an error; after an error it is removed.

    A reader sees the old file or the new one; a symbolic link is replaced itself. The draft ends in `.part`, which no
    reader takes for a trace. With `fsync` file and folder are on the disk on return.

    Raises:
        OSError: the draft cannot be flushed to the disk, or cannot replace `path`.
    """
    if real_path(path.parent) == Path("/dev") or (path.exists() and not (path.is_file() or path.is_dir())):
        raise OSError(errno.EEXIST, "It is a device or a pipe", os.fspath(path))  # replaced, it would be gone
    # Random, so that no other process and no link in a shared folder has the same name.
    draft = path.with_name(f"{path.name}.{secrets.token_hex(4)}.part")
    with folder_lock(path.parent, fcntl.LOCK_SH, _DRAFT_LOCK_S):  # `remove_drafts` sees that somebody writes
        try:
            yield draft
            if fsync:
                flush_to_disk(draft)
            draft.replace(path)
        except BaseException:
            with suppress(OSError):  # it was never written
                draft.unlink()
            raise
    if fsync:
        flush_to_disk(path.parent)


def write_whole(path: Path, text: str) -> Path:
    """Write a file as UTF-8, with the line ends of `text`, in place of an earlier one; errors as in `replacing`."""
    with replacing(path) as draft:
        draft.write_text(text, encoding="utf-8", newline="\n")
    return path


def asset(package: str, name: str) -> str:
    from importlib.resources import files  # noqa: PLC0415 - only pages have assets

    return (files(package) / "assets" / name).read_text(encoding="utf-8")


@contextmanager
def folder_lock(folder: Path, kind: int, wait_s: float = 0.0) -> Iterator[bool]:
    """Lock a folder (`fcntl.LOCK_SH` or `LOCK_EX`) within the block; yield whether that is possible, within `wait_s`."""
    descriptor, has_lock = None, False
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        end_s = time.monotonic() + wait_s
        while not (has_lock := try_lock(descriptor, kind)) and time.monotonic() < end_s:
            time.sleep(_LOCK_PAUSE_S)
    try:
        yield has_lock
    finally:
        if descriptor is not None:
            os.close(descriptor)


def try_lock(descriptor: int, kind: int) -> bool:
    try:
        fcntl.flock(descriptor, kind | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def is_locked(descriptor: int) -> bool:
    """Return whether a process has a file locked exclusively; a file system without locks has no such process."""
    with suppress(OSError):
        if not try_lock(descriptor, fcntl.LOCK_SH):
            return True
        fcntl.flock(descriptor, fcntl.LOCK_UN)
    return False


def remove_drafts(folder: Path, names: Iterable[str]) -> None:
    """Remove the drafts of these files that a dead process left; none while any process has a draft in the folder."""
    draft = re.compile(rf"({'|'.join(map(re.escape, names))})\.[0-9a-f]{{8}}\.part")
    with folder_lock(folder, fcntl.LOCK_EX) as nobody_writes, suppress(OSError):
        for path in folder.iterdir() if nobody_writes else ():
            if draft.fullmatch(path.name) and path.is_file() and not path.is_symlink():
                path.unlink()


_DRAFT_LOCK_S, _LOCK_PAUSE_S = 0.2, 0.01
"""`remove_drafts` has its lock for milliseconds."""


def open_regular(path: Path, *, follow_links: bool = True) -> BufferedReader:
    """Open a regular file; any other is an `OSError`: a pipe would wait for a writer, and a device may never end."""
    flags = os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK | (0 if follow_links else os.O_NOFOLLOW)
    descriptor = os.open(path, flags)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "not a regular file", str(path))
    return os.fdopen(descriptor, "rb")


MOST_SETTINGS_BYTES = 16 << 20
"""Far more than any configuration, plan or link file has."""


def read_regular(path: Path, check_owner: Callable[[int], object] = bool) -> bytes:
    """Read a file of at most `MOST_SETTINGS_BYTES`, once `check_owner` has taken its owner; errors as of `open_regular`."""
    with open_regular(path) as file:
        check_owner(os.fstat(file.fileno()).st_uid)
        data = file.read(MOST_SETTINGS_BYTES + 1)
    if len(data) > MOST_SETTINGS_BYTES:
        raise OSError(errno.EFBIG, "larger than any file of settings", str(path))
    return data


def read_settings(path: Path, what: str, remedy: str, check_owner: Callable[[int], object] = bool) -> str:
    """Return the text of a file that a person names; an `OptionError` if it cannot be read."""
    try:
        return read_regular(path, check_owner).decode()
    except OSError as err:
        raise OptionError(f"{path}: {err.strerror}; {remedy}") from err
    except UnicodeDecodeError as err:
        raise OptionError(f"{path}: {err}; {what} is UTF-8 text") from err


def read_into(descriptor: int, target: memoryview, offset: int) -> int:
    total = 0
    while total < len(target):  # the kernel returns at most 2 GiB at once
        count = os.preadv(descriptor, [target[total:]], offset + total)
        if not count:
            break
        total += count
    return total


def expand_home(text: str) -> Path:
    """Return a path with `~` or `~user` expanded; a name of no user's stays, where `Path.expanduser` raises."""
    return Path(os.path.expanduser(text))  # noqa: PTH111


OWNER_AND_GROUP = 0o640
"""Mode of a new trace and its ring; the umask may reduce it."""


def real_path(path: str | os.PathLike[str]) -> Path:
    """Return the path that links lead to; one in a loop stays, where `Path.resolve` raises before Python 3.13."""
    return Path(os.path.realpath(path))


def create_file(path: Path, mode: int = OWNER_AND_GROUP) -> BinaryIO:
    """Create a file that must not exist (nor a dangling link), with at most the rights of `mode`."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode)
    return os.fdopen(descriptor, "wb")


def mode_within(rights: int) -> int:
    """Return the mode for a file derived from one with these rights: no more, and none for others."""
    return rights & OWNER_AND_GROUP | stat.S_IRUSR | stat.S_IWUSR


def flush_to_disk(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


_ADVICE = {
    errno.ENOSPC: "the disk is full; free space or record to another disk",
    errno.EDQUOT: "the disk quota is used up; free space or record to another disk",
    errno.EFBIG: "the file may not grow further; raise the file size limit (ulimit -f)",
    errno.EROFS: "the file system is read-only; choose another --out",
    errno.EACCES: "no permission to write here; choose another --out",
    errno.EPERM: "no permission to write here; choose another --out",
    errno.ENOENT: "the file or its folder was deleted or moved; record to a folder that stays",
    errno.ESTALE: "another program truncated, replaced or overwrote it; keep copies and log rotation away from it",
    errno.ENOTDIR: "a part of the path is not a folder; choose another --out",
}


@contextmanager
def output_errors(folder: Path) -> Iterator[None]:
    """Raise an error of the system as one of a folder for results."""
    try:
        yield
    except OSError as err:
        raise OutputError(
            f"{folder} cannot be written ({err.strerror or err}); give another folder with --out"
        ) from err


def output_error(path: Path, err: OSError, what: str = "the trace") -> OutputError:
    advice = _ADVICE.get(err.errno or 0, f"{err.strerror}; check the disk")
    return OutputError(f"{path}: cannot write {what}: {advice}")
