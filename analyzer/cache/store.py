"""The cache of read traces, and of what was made of them: in the user's own cache folder, sealed with a key that only this user has.

    $XDG_CACHE_HOME/dds-trace/traces/KEY.trace    events (`analyzer/cache/events.py`), then their trace without them as JSON
                                                  (`analyzer/cache/entries.py`), its seal and its size
    $XDG_CACHE_HOME/dds-trace/traces/KEY.details  sealed frames (`analyzer/engines/cached_details.py`)
    $XDG_CACHE_HOME/dds-trace/traces/KEY.rows     sealed rows (`analyzer/engines/cached_batches.py`), or what is known of rows in
    $XDG_CACHE_HOME/dds-trace/traces/KEY.table    rows as they are, a Parquet file (`analyzer/engines/cached_parts.py`)
    $XDG_STATE_HOME/dds-trace/cache-key           32 random bytes

KEY is the HMAC-SHA-256 of the trace's content, or of all that the frames are made of. A seal is the HMAC of KEY and of what it
stands before, or behind; the JSON holds the HMACs of the events, a sealed file those of tables. So an entry that somebody else
wrote, or that was written for another trace, or that a disk has damaged, is not used: the trace is read again. The key is not kept beside the entries, because caches are copied (a CI server restores
them) and what comes with a copy must not vouch for it.

Only regular files that are named as entries are removed, and only from this folder, never through a link.
"""

from __future__ import annotations

import fcntl
import hashlib
import hmac
import os
import re
import secrets
import shutil
import stat
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dds_trace.base.errors import TraceFormatError
from dds_trace.base.files import open_regular, replacing
from dds_trace.tracefile.format.ring import ring_path

from .remote import is_remote, remote_key

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from io import BufferedReader
    from typing import Any, BinaryIO

    from numpy.typing import NDArray

MOST_BYTES = 8 << 30
"""Size of the whole cache after an analysis, if a tenth of its disk is not less; entries that were not used for the longest
time are removed."""

MOST_TEXT_BYTES = 256 << 20
"""Largest JSON of an entry; a trace with more descriptions than that is read anew each time."""

_OLD = ("json", "events")  # in which a trace was kept before
_NAME = re.compile(rf"([0-9a-f]{{64}})\.(trace|details|rows|table|{'|'.join(_OLD)})(\.[0-9a-f]{{8}}\.part)?")
"""Names of entries, and of their drafts."""

_TRACE, _TABLE = "trace", "table"

_KEY_BYTES = 32
_SEAL_BYTES = 64  # hexadecimal digits
_SIZE_BYTES = 16  # hexadecimal digits, too
_END_BYTES = 32 << 10  # what is read of the end of an entry at first
_BLOCK_BYTES = 4 << 20
_ROOM_BYTES = 1 << 20  # a file up to here is read into memory that is kept
_of_thread = threading.local()
_DIGEST = "sha256"  # the quickest of hashlib on machines whose processor has instructions for it


@dataclass(frozen=True, slots=True)
class Sealer:
    """Makes the seals of this user's entries, here or in a worker process.

    Attributes:
        secret: this user's key.
    """

    secret: bytes = field(repr=False)

    def hash(self, purpose: bytes) -> hmac.HMAC:
        """Return an HMAC that has begun with its purpose."""
        return hmac.new(self.secret, purpose + b"\0", _DIGEST)

    def seal_events(self, columns: Iterable[NDArray[Any]], behind: hmac.HMAC | None = None) -> hmac.HMAC:
        """Seal the columns in the entry of a trace; the JSON, which has a seal itself, says the others.

        Args:
            columns: the columns.
            behind: the seal of those before them, which is extended.
        """
        seal = self.hash(b"events") if behind is None else behind
        for column in columns:
            seal.update(np.ascontiguousarray(column).data)
        return seal


class TraceCache:
    """The open cache of this user.

    Attributes:
        folder: the folder of the entries, in which only this user can write.
        sealer: makes its seals.
    """

    def __init__(self, folder: Path, descriptor: int, secret: bytes) -> None:
        """Take an open folder; see `open`."""
        self.folder = folder
        self.sealer = Sealer(secret)
        self._descriptor = descriptor
        self._pool = ThreadPoolExecutor(len(os.sched_getaffinity(0)), thread_name_prefix="cache")

    @classmethod
    def open(cls) -> TraceCache | None:
        """Open the cache, made if it is missing.

        Returns:
            None where there can be none: no home folder, no right to write, or a folder that is a link or somebody else's.
        """
        try:
            above = _own_folder(_base("XDG_CACHE_HOME", ".cache") / "dds-trace")
            os.close(above)
            secret = _own_secret(_base("XDG_STATE_HOME", ".local/state") / "dds-trace")
            folder = _base("XDG_CACHE_HOME", ".cache") / "dds-trace" / "traces"
            descriptor = _own_folder(folder)
        except (OSError, RuntimeError):  # RuntimeError: this user has no home
            return None
        with suppress(OSError):  # a file system without locks: nothing is ever removed there
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        return cls(folder, descriptor, secret)

    def key_of(self, path: Path) -> str:
        """Return the key of a trace's content: its file and the ring beside it, or the files of a rosbag2 folder.

        Raises:
            TraceFormatError: it cannot be read.
        """
        digest = self.sealer.hash(b"trace")
        if is_remote(path):
            digest.update(remote_key(path).encode())
            return digest.hexdigest()
        try:
            for file in sorted(path.iterdir()) if path.is_dir() else [path, ring_path(path)]:
                if file.is_file():
                    with open_regular(file) as stream:
                        size = os.fstat(stream.fileno()).st_size
                        # Behind the trace's own name, so that one that was moved or renamed is known.
                        digest.update(os.fsencode(file)[len(os.fsencode(path)) :] + b"\0%d\0" % size)
                        for of_block in self._block_digests(stream.fileno(), size):
                            digest.update(of_block)
        except OSError as err:
            raise TraceFormatError(path, f"cannot be read ({err.strerror})") from err
        return digest.hexdigest()

    def key_of_text(self, purpose: str, text: str) -> str:
        """Return the key of what follows from a text alone."""
        digest = self.sealer.hash(purpose.encode())
        digest.update(text.encode())
        return digest.hexdigest()

    def path(self, key: str, ending: str) -> Path:
        """Return the path of an entry."""
        return self.folder / f"{key}.{ending}"

    def write(
        self, key: str, ending: str, *parts: bytes | memoryview, most_bytes: int = MOST_TEXT_BYTES
    ) -> Path:
        """Write a sealed entry, part by part.

        Returns:
            Its path.

        Raises:
            OSError: it cannot be written, or is too large.
        """
        _check_size(sum(map(len, parts)), most_bytes)
        path = self.path(key, ending)
        with replacing(path) as draft, draft.open("wb") as stream:
            stream.writelines((self._seal(key, *parts), *parts))
        return path

    def read(self, key: str, ending: str, most_bytes: int = MOST_TEXT_BYTES) -> bytes:
        """Return what was written into a sealed entry, and note that it was used.

        Raises:
            OSError: there is no such entry.
            ValueError: this user did not write it, or not so, or for another key.
        """
        with open_regular(self.path(key, ending), follow_links=False) as stream:
            if os.fstat(stream.fileno()).st_size > _SEAL_BYTES + most_bytes:
                raise ValueError("larger than an entry is")
            seal, content = stream.read(_SEAL_BYTES), stream.read(most_bytes)
            if not hmac.compare_digest(seal, self._seal(key, content)):
                raise ValueError("not sealed by this user")
            os.utime(stream.fileno())
        return content

    def write_end(self, key: str, stream: BinaryIO, text: bytes) -> None:
        """Write the end of the entry of a trace, whose events are in the stream already: its JSON, sealed.

        Raises:
            OSError: it cannot be written, or is too large.
        """
        _check_size(len(text), MOST_TEXT_BYTES)
        stream.writelines((text, self._seal(key, text), b"%0*x" % (_SIZE_BYTES, len(text))))

    def read_end(self, key: str) -> tuple[bytes, int]:
        """Return the JSON of the entry of a trace and the number of bytes before it, and note that the entry was used.

        Raises:
            OSError: there is no such entry.
            ValueError: this user did not write it, or not so, or for another key.
        """
        with open_regular(self.path(key, _TRACE), follow_links=False) as stream:
            size = os.fstat(stream.fileno()).st_size
            end = _read_end(stream, size, _END_BYTES)
            text_bytes = int(end[-_SIZE_BYTES:], 16)
            behind = _SEAL_BYTES + _SIZE_BYTES
            before = size - text_bytes - behind
            if text_bytes > MOST_TEXT_BYTES or before < 0:
                raise ValueError("another size than an entry has")
            if text_bytes + behind > len(end):
                end = _read_end(stream, size, text_bytes + behind)
            text, seal = end[-text_bytes - behind : -behind], end[-behind:-_SIZE_BYTES]
            if not hmac.compare_digest(seal, self._seal(key, text)):
                raise ValueError("not sealed by this user")
            os.utime(stream.fileno())
        return text, before

    def store(self, key: str, content: memoryview) -> str:
        """Write a table, whose readers know no seal, as it is.

        Returns:
            Its seal, for a sealed file (`holds`).

        Raises:
            OSError: it cannot be written.
        """
        with replacing(self.path(key, _TABLE)) as draft, draft.open("wb") as stream:
            stream.write(content)
        return self._table_seal(key, [content])

    def holds(self, key: str, seal: str) -> bool:
        """Return whether a table is there as it was stored, and note that it was used."""
        with suppress(OSError), open_regular(self.path(key, _TABLE), follow_links=False) as stream:
            os.utime(stream.fileno())
            room = _room_of_thread()
            blocks = (room[:size] for size in iter(lambda: os.readv(stream.fileno(), [room]), 0))
            return hmac.compare_digest(seal, self._table_seal(key, blocks))
        return False

    def close(self) -> None:
        """Close the cache; unless another analysis has it open, remove what is too much."""
        self._pool.shutdown()
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._shrink()
        except OSError:
            pass  # another analysis reads entries: the last to close removes
        finally:
            os.close(self._descriptor)

    def _shrink(self) -> None:
        """Remove drafts, what no version of ours reads now, and entries beyond the size of the cache, those used last being kept."""
        entries: dict[str, os.stat_result] = {}
        for name in os.listdir(self._descriptor):  # noqa: PTH208 - a path might lead elsewhere by now
            matched = _NAME.fullmatch(name)
            if matched is None:
                continue
            status = os.stat(name, dir_fd=self._descriptor, follow_symlinks=False)
            if not stat.S_ISREG(status.st_mode):
                continue
            if matched[3] or matched[2] in _OLD:
                os.unlink(name, dir_fd=self._descriptor)
            else:
                entries[name] = status
        left = min(MOST_BYTES, shutil.disk_usage(self._descriptor).total // 10)
        for name in sorted(entries, key=lambda name: entries[name].st_mtime_ns, reverse=True):
            left -= entries[name].st_size
            if left < 0:
                os.unlink(name, dir_fd=self._descriptor)

    def _block_digests(self, descriptor: int, size: int) -> Iterator[bytes]:
        """Yield the SHA-256 of each block of a file; those of a large one are made on all cores."""
        if 0 < size <= _ROOM_BYTES:
            room = _room_of_thread()
            return iter([hashlib.sha256(room[: os.preadv(descriptor, [room], 0)]).digest()])

        def digest_of(offset: int) -> bytes:
            return hashlib.sha256(os.pread(descriptor, _BLOCK_BYTES, offset)).digest()

        offsets = range(0, size, _BLOCK_BYTES)
        return map(digest_of, offsets) if len(offsets) < 2 else self._pool.map(digest_of, offsets)

    def _table_seal(self, key: str, blocks: Iterable[memoryview]) -> str:
        digest = self.sealer.hash(b"table")
        digest.update(key.encode() + b"\0")
        for block in blocks:
            digest.update(block)
        return digest.hexdigest()

    def _seal(self, key: str, *parts: bytes | memoryview) -> bytes:
        digest = self.sealer.hash(b"entry")
        digest.update(key.encode() + b"\0")
        for part in parts:
            digest.update(part)
        return digest.hexdigest().encode()


def _check_size(size: int, most_bytes: int) -> None:
    if size > most_bytes:
        raise OSError(f"{size} bytes are too many to keep")


def _read_end(stream: BufferedReader, size: int, count: int) -> bytes:
    """Return so many of the last bytes of a file of this size, or all."""
    return os.pread(stream.fileno(), count, max(0, size - count))


def _room_of_thread() -> memoryview:
    """Return this thread's own room for a small file: of thousands, fresh memory would take longer to touch than to digest."""
    if not hasattr(_of_thread, "room"):
        _of_thread.room = memoryview(bytearray(_ROOM_BYTES))
    room: memoryview = _of_thread.room
    return room


def _base(variable: str, default: str) -> Path:
    """Return a base folder of the XDG specification; a relative path in the variable is ignored, as it demands.

    Raises:
        RuntimeError: this user has no home.
    """
    named = Path(os.environ.get(variable, ""))
    return named if named.is_absolute() else Path.home() / default


def _own_folder(folder: Path) -> int:
    """Return a descriptor of a folder that is this user's alone, made if it is missing.

    Raises:
        OSError: it is a link, somebody else's, or cannot be made.
    """
    with suppress(FileExistsError):
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700)
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        status = os.fstat(descriptor)
        if status.st_uid != os.geteuid():
            raise PermissionError(f"{folder} is not ours")
        if status.st_mode & 0o077:
            os.fchmod(descriptor, 0o700)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def _own_secret(folder: Path) -> bytes:
    """Return this user's secret, made if it is missing or damaged.

    Raises:
        OSError: the folder is not this user's, or cannot be written.
    """
    os.close(_own_folder(folder))
    path = folder / "cache-key"
    with suppress(OSError), open_regular(path, follow_links=False) as stream:
        status = os.fstat(stream.fileno())
        secret = stream.read(_KEY_BYTES + 1)
        if len(secret) == _KEY_BYTES and status.st_uid == os.geteuid() and not status.st_mode & 0o077:
            return secret
    secret = secrets.token_bytes(_KEY_BYTES)
    with replacing(path) as draft:
        descriptor = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
        with os.fdopen(descriptor, "wb") as stream:
            stream.write(secret)
    return secret
