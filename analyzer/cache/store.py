"""The cache folder of the user: traces and results under keys and seals that only this user can make.

    $XDG_CACHE_HOME/dds-trace/traces/KEY.trace    events, then the trace without them as JSON, its seal and its size
                                                  (`cache/events.py`, `cache/entries.py`)
    $XDG_CACHE_HOME/dds-trace/traces/KEY.details  a seal, then frames (`engines/result_cache.py`)
    $XDG_CACHE_HOME/dds-trace/traces/KEY.rows     a seal, then paired rows (`engines/packed_rows.py`)
    $XDG_STATE_HOME/dds-trace/cache-key           32 random bytes: the secret

KEY is the HMAC-SHA-256 of the trace's content, or of everything that a result is computed from. A seal is the HMAC of
KEY and the sealed bytes; the JSON of a trace contains the HMACs of its events. So an entry of another user or trace, or
a damaged one, is ignored. The secret is elsewhere because a copy of a cache (a CI server restores one) must not bring
the key that vouches for it.

Only regular files with the name of an entry are removed, only from this folder, and never through a link.
"""

from __future__ import annotations

import fcntl
import hashlib
import hmac
import mmap
import os
import re
import secrets
import shutil
import stat
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from dds_trace.base.errors import TraceFormatError
from dds_trace.base.files import open_regular, replacing
from dds_trace.tracefile.format.ring import ring_path

from .remote import is_remote, remote_key

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from io import BufferedReader

    from numpy.typing import NDArray

MOST_BYTES = 8 << 30
"""Size of the cache after an analysis, or a tenth of its disk if that is less; the least recently used entries go first."""

MOST_TEXT_BYTES = 256 << 20
"""Largest JSON of a trace; a larger one is not cached."""

SEAL_BYTES = 64

_OUTDATED = ("json", "events", "table")
_NAME = re.compile(rf"([0-9a-f]{{64}})\.(trace|details|rows|{'|'.join(_OUTDATED)})(\.[0-9a-f]{{8}}\.part)?")

_TRACE = "trace"
_KEY_BYTES = 32
_SIZE_BYTES = 16  # hexadecimal digits
_END_BYTES = 32 << 10  # first read at the end of a trace's entry
_BLOCK_BYTES = 4 << 20
_BUFFER_BYTES = 1 << 20  # smaller files are read into a buffer that is reused
_thread_local = threading.local()
_DIGEST = "sha256"  # the quickest of hashlib on most processors


@dataclass(frozen=True, slots=True)
class Sealer:
    """Makes the seals of this user's entries, here or in a worker process."""

    secret: bytes = field(repr=False)

    def hash(self, purpose: bytes) -> hmac.HMAC:
        return hmac.new(self.secret, purpose + b"\0", _DIGEST)

    def seal_events(self, columns: Iterable[NDArray[Any]], previous: hmac.HMAC | None = None) -> hmac.HMAC:
        seal = self.hash(b"events") if previous is None else previous
        for column in columns:
            seal.update(np.ascontiguousarray(column).data)
        return seal


class SealedStream:
    """Writes an entry and computes its seal."""

    closed = False

    def __init__(self, file: BinaryIO, digest: hmac.HMAC) -> None:
        self._file = file
        self._digest = digest

    def write(self, content: bytes | memoryview) -> int:
        self._digest.update(content)
        return self._file.write(content)

    def tell(self) -> int:
        return self._file.tell() - SEAL_BYTES

    def close(self) -> None:
        """Do nothing: Arrow closes its streams before the seal is written."""


class TraceCache:
    """The open cache of this user; only this user can write in `folder`."""

    def __init__(self, folder: Path, descriptor: int, secret: bytes) -> None:
        self.folder = folder
        self.sealer = Sealer(secret)
        self._descriptor = descriptor
        self._pool = ThreadPoolExecutor(len(os.sched_getaffinity(0)), thread_name_prefix="cache")

    @classmethod
    def open(cls) -> TraceCache | None:
        """Open or make the cache; None if it cannot be made, or is a link or another user's folder."""
        try:
            parent = _base("XDG_CACHE_HOME", ".cache") / "dds-trace"
            os.close(_own_folder(parent))
            secret = _own_secret(_base("XDG_STATE_HOME", ".local/state") / "dds-trace")
            folder = parent / "traces"
            descriptor = _own_folder(folder)
        except (OSError, RuntimeError):  # no home
            return None
        with suppress(OSError):  # without locks nothing is ever removed
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        return cls(folder, descriptor, secret)

    def key_of(self, path: Path) -> str:
        """Return the key of the content of a trace and its ring, or of a rosbag2 folder.

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
                        # Without the trace's own name: a trace that was moved or renamed keeps its key.
                        digest.update(os.fsencode(file)[len(os.fsencode(path)) :] + b"\0%d\0" % size)
                        for block in self._block_digests(stream.fileno(), size):
                            digest.update(block)
        except OSError as err:
            raise TraceFormatError(path, f"cannot be read ({err.strerror})") from err
        return digest.hexdigest()

    def key_of_text(self, purpose: str, text: str) -> str:
        digest = self.sealer.hash(purpose.encode())
        digest.update(text.encode())
        return digest.hexdigest()

    def path(self, key: str, ending: str) -> Path:
        return self.folder / f"{key}.{ending}"

    @contextmanager
    def writing(self, key: str, ending: str) -> Iterator[SealedStream]:
        """Write a sealed entry; it is there once the block ends without an error.

        Raises:
            OSError: it cannot be written.
        """
        with replacing(self.path(key, ending)) as draft, draft.open("wb") as file:
            file.seek(SEAL_BYTES)
            digest = self._entry_digest(key)
            yield SealedStream(file, digest)
            file.seek(0)
            file.write(digest.hexdigest().encode())

    def read(self, key: str, ending: str) -> memoryview:
        """Map the content of a sealed entry into memory, and mark the entry as used.

        Raises:
            OSError: there is no such entry.
            ValueError: this user did not write it for this key.
        """
        with open_regular(self.path(key, ending), follow_links=False) as file:
            entry = memoryview(mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ))
            seal, content = entry[:SEAL_BYTES], entry[SEAL_BYTES:]
            digest = self._entry_digest(key)
            digest.update(content)
            if not hmac.compare_digest(seal, digest.hexdigest().encode()):
                raise ValueError("not sealed by this user")
            os.utime(file.fileno())
        return content

    def write_end(self, key: str, stream: BinaryIO, text: bytes) -> None:
        """Append the sealed JSON of a trace to its events in the stream.

        Raises:
            OSError: it cannot be written, or is too large.
        """
        if len(text) > MOST_TEXT_BYTES:
            raise OSError(f"{len(text)} bytes are too many to cache")
        digest = self._entry_digest(key)
        digest.update(text)
        stream.writelines((text, digest.hexdigest().encode(), b"%0*x" % (_SIZE_BYTES, len(text))))

    def read_end(self, key: str) -> tuple[bytes, int]:
        """Return the JSON of a trace and the number of bytes before it; as `read`."""
        with open_regular(self.path(key, _TRACE), follow_links=False) as stream:
            size = os.fstat(stream.fileno()).st_size
            end = _read_end(stream, size, _END_BYTES)
            text_bytes = int(end[-_SIZE_BYTES:], 16)
            after_text = SEAL_BYTES + _SIZE_BYTES
            before_text = size - text_bytes - after_text
            if text_bytes > MOST_TEXT_BYTES or before_text < 0:
                raise ValueError("not the size of an entry")
            if text_bytes + after_text > len(end):
                end = _read_end(stream, size, text_bytes + after_text)
            text, seal = end[-text_bytes - after_text : -after_text], end[-after_text:-_SIZE_BYTES]
            digest = self._entry_digest(key)
            digest.update(text)
            if not hmac.compare_digest(seal, digest.hexdigest().encode()):
                raise ValueError("not sealed by this user")
            os.utime(stream.fileno())
        return text, before_text

    def close(self) -> None:
        """Close the cache; the last analysis removes what exceeds its size."""
        self._pool.shutdown()
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._shrink()
        except OSError:
            pass
        finally:
            os.close(self._descriptor)

    def _shrink(self) -> None:
        entries: dict[str, os.stat_result] = {}
        for name in os.listdir(self._descriptor):  # noqa: PTH208 - a path might lead elsewhere by now
            matched = _NAME.fullmatch(name)
            if matched is None:
                continue
            status = os.stat(name, dir_fd=self._descriptor, follow_symlinks=False)
            if not stat.S_ISREG(status.st_mode):
                continue
            if matched[3] or matched[2] in _OUTDATED:
                os.unlink(name, dir_fd=self._descriptor)
            else:
                entries[name] = status
        left = min(MOST_BYTES, shutil.disk_usage(self._descriptor).total // 10)
        for name in sorted(entries, key=lambda name: entries[name].st_mtime_ns, reverse=True):
            left -= entries[name].st_size
            if left < 0:
                os.unlink(name, dir_fd=self._descriptor)

    def _block_digests(self, descriptor: int, size: int) -> Iterator[bytes]:
        if 0 < size <= _BUFFER_BYTES:
            buffer = _buffer_of_thread()
            return iter([hashlib.sha256(buffer[: os.preadv(descriptor, [buffer], 0)]).digest()])

        def digest_of(offset: int) -> bytes:
            return hashlib.sha256(os.pread(descriptor, _BLOCK_BYTES, offset)).digest()

        offsets = range(0, size, _BLOCK_BYTES)
        return map(digest_of, offsets) if len(offsets) < 2 else self._pool.map(digest_of, offsets)

    def _entry_digest(self, key: str) -> hmac.HMAC:
        digest = self.sealer.hash(b"entry")
        digest.update(key.encode() + b"\0")
        return digest


def _read_end(stream: BufferedReader, size: int, count: int) -> bytes:
    return os.pread(stream.fileno(), count, max(0, size - count))


def _buffer_of_thread() -> memoryview:
    """Reuse memory: for small files, fresh memory costs more than the digest."""
    if not hasattr(_thread_local, "buffer"):
        _thread_local.buffer = memoryview(bytearray(_BUFFER_BYTES))
    buffer: memoryview = _thread_local.buffer
    return buffer


def _base(variable: str, default: str) -> Path:
    named = Path(os.environ.get(variable, ""))
    return named if named.is_absolute() else Path.home() / default


def _own_folder(folder: Path) -> int:
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
