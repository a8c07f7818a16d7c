"""Files that are written: replaced whole or not at all, and what a failure means; files that are read: regular ones, from any offset."""

from __future__ import annotations

import errno
import os
import secrets
import stat
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from .errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from io import BufferedReader
    from typing import BinaryIO


@contextmanager
def replacing(path: Path, *, fsync: bool = False) -> Iterator[Path]:
    """Yield the path of a draft beside `path`, which takes the place of `path` once the block ends without an error.

    A reader finds the old file or the new one, never a part of it. After an error the old file stays and the draft is
    removed. Where `path` is a symbolic link the link itself is replaced; what it points to is not touched.

    Args:
        path: the file to write; its folder exists.
        fsync: whether the new file and its folder are on the disk, not only in the page cache, when this returns.

    Yields:
        A path that does not exist yet. Its ending is `.part`, so that nobody takes a draft for a trace or a table.

    Raises:
        OSError: the draft cannot be flushed to the disk, or cannot take the place of `path`.
    """
    # Random, so that neither another process nor a link that somebody left in a shared folder meets the draft.
    draft = path.with_name(f"{path.name}.{secrets.token_hex(4)}.part")
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


def open_regular(path: Path, *, follow_links: bool = True) -> BufferedReader:
    """Open a regular file for reading; a pipe would wait for a writer, and a device may never end.

    Args:
        path: the file.
        follow_links: whether `path` may be a symbolic link to it.

    Raises:
        OSError: as `open`; the file is no regular file.
    """
    flags = os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK | (0 if follow_links else os.O_NOFOLLOW)
    descriptor = os.open(path, flags)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "no regular file", str(path))
    return os.fdopen(descriptor, "rb")


def read_into(descriptor: int, room: memoryview, offset: int) -> int:
    """Fill `room` with the bytes of a file from `offset` on.

    Returns:
        How many there were: fewer than `room` has where the file ends before.

    Raises:
        OSError: as `os.preadv`.
    """
    done = 0
    while done < len(room):  # the kernel hands out at most 2 GiB at once
        count = os.preadv(descriptor, [room[done:]], offset + done)
        if not count:
            break
        done += count
    return done


def expand_home(text: str) -> Path:
    """Return a path with the home folder in place of `~` or `~user`; as it is where that user is not known.

    `Path.expanduser` raises there, though such a name may be a folder's.
    """
    return Path(os.path.expanduser(text))  # noqa: PTH111


OWNER_AND_GROUP = 0o640
"""Mode of a new trace and its ring: the owner writes, the group reads, others do nothing; the umask may take more away."""


def create_file(path: Path, mode: int = OWNER_AND_GROUP) -> BinaryIO:
    """Make a file that does not exist and open it for writing; it never has more rights than `mode`.

    Raises:
        OSError: as `open`; there is something of that name already, a dangling link too.
    """
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode)
    return os.fdopen(descriptor, "wb")


def mode_within(rights: int) -> int:
    """Return the mode for a file that is made of one with these rights: no more, and none for others."""
    return rights & OWNER_AND_GROUP | stat.S_IRUSR | stat.S_IWUSR


def flush_to_disk(path: Path) -> None:
    """Have a file, or the names in a folder, on the disk and not only in the page cache.

    Raises:
        OSError: it cannot be opened or flushed.
    """
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
    errno.ENOTDIR: "a part of the path is no folder; choose another --out",
}


def output_error(path: Path, err: OSError, what: str = "the trace") -> OutputError:
    """Return the error that tells a user what a failed write means and what to do, by the system's error number."""
    advice = _ADVICE.get(err.errno or 0, f"{err.strerror}; check the disk")
    return OutputError(f"{path}: cannot write {what}: {advice}")
