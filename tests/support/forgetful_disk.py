"""A disk in memory that forgets, when the power goes, what was written to it and not flushed.

It is one file of a FUSE file system that this process serves through `/dev/fuse`, without any library; a loop device makes
a block device of the file. A flush of the block device arrives as an fsync of the file (`dm-log-writes` would see the
same, where a kernel has it). Protocol: Linux `include/uapi/linux/fuse.h`, version 7.31. Needs root, in a mount namespace
of its own.
"""

import ctypes
import errno
import os
import random
import shutil
import stat
import struct
import subprocess
import threading
from collections.abc import Callable
from pathlib import Path

SECTOR_BYTES = 512
"""What a disk writes whole or not at all."""

DISK = "disk"
"""Name of the one file."""

_IN = struct.Struct("<IIQQIIII")  # length, opcode, unique, node, uid, gid, pid, lengths of extensions
_OUT = struct.Struct("<IiQ")  # length, minus error, unique
_ATTRIBUTES = struct.Struct("<6Q10I")
_ENTRY = struct.Struct("<4Q2I")
_TRANSFER = struct.Struct("<QQI")  # handle, offset, size: the beginning of what READ and WRITE are given
_WRITE_BYTES = 40
_ROOT, _FILE = 1, 2
_VALID_S = 3600
_MOST_BYTES = 1 << 20
_LOOKUP, _FORGET, _GETATTR, _SETATTR, _OPEN, _READ, _WRITE = 1, 2, 3, 4, 14, 15, 16
_STATFS, _RELEASE, _FSYNC, _FLUSH, _INIT, _OPENDIR, _RELEASEDIR = 17, 18, 20, 25, 26, 27, 29
_INTERRUPT, _DESTROY, _BATCH_FORGET = 36, 38, 42
_WITHOUT_ANSWER = {_FORGET, _INTERRUPT, _BATCH_FORGET}


def missing_for_a_disk() -> str | None:
    """What this machine lacks for such a disk with ext4 on it, in words; None if it has all."""
    if os.geteuid() != 0:
        return "only root may mount a loop device"
    wanted = ("/dev/fuse", "/dev/loop-control")
    lacking = [path for path in wanted if not Path(path).exists()]
    lacking += [name for name in ("mkfs.ext4", "unshare", "mount") if shutil.which(name) is None]
    if lacking:
        return f"{', '.join(lacking)} is not here"
    allowed = subprocess.run(["unshare", "-m", "true"], check=False).returncode == 0
    return None if allowed else "no mount namespace may be made here (unshare -m)"


class ForgetfulDisk:
    """The disk, served by a thread of its own until its file system is unmounted or the process ends.

    Attributes:
        path: the file that is the disk.
        is_broken: whether every write and flush fails with EIO from now on, as on a disk that dies.

    Args:
        folder: an empty folder, at which the file system with the file `DISK` is mounted.
        size_bytes: size of the disk.
    """

    def __init__(self, folder: Path, size_bytes: int) -> None:
        self.path = folder / DISK
        self.is_broken = False
        self._content = bytearray(size_bytes)
        self._durable = bytearray(size_bytes)
        self._pending: list[tuple[int, bytes]] = []  # offset, data: written since the last flush
        self._lock = threading.Lock()
        self._fuse = os.open("/dev/fuse", os.O_RDWR | os.O_CLOEXEC)
        options = f"fd={self._fuse},rootmode=40000,user_id=0,group_id=0"
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.mount(b"forgetful", os.fsencode(folder), b"fuse", 0, options.encode()):
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()), "mount of a FUSE file system")
        self._answers: dict[int, Callable[[int, memoryview], bytes]] = {
            _LOOKUP: self._look_up,
            _GETATTR: self._attributes,
            _SETATTR: self._attributes,
            _READ: self._read,
            _WRITE: self._write,
            _FSYNC: self._flush,
            _INIT: lambda _node, _body: struct.pack(
                "<IIIIHHIIHHII24x", 7, 31, 0, 1 << 5 | 1 << 22, 16, 16, _MOST_BYTES, 1, 256, 0, 0, 0
            ),
            _OPEN: lambda _node, _body: bytes(16),
            _OPENDIR: lambda _node, _body: bytes(16),
            _STATFS: lambda _node, _body: bytes(80),
            **dict.fromkeys((_RELEASE, _RELEASEDIR, _FLUSH, _DESTROY), lambda _node, _body: b""),
        }
        threading.Thread(target=self._serve, daemon=True).start()

    def after_power_loss(self, moment: random.Random, kept: float) -> bytes:
        """Return what the disk would hold if the power went now.

        Args:
            moment: draws which sectors survive.
            kept: probability that a sector that was written and not flushed is on the disk all the same; later ones may
                be there without earlier ones.
        """
        with self._lock:
            image, pending = bytearray(self._durable), list(self._pending)
        for offset, data in pending:
            for at in range(0, len(data), SECTOR_BYTES):
                if moment.random() < kept:
                    image[offset + at : offset + at + SECTOR_BYTES] = data[at : at + SECTOR_BYTES]
        return bytes(image)

    def _serve(self) -> None:
        while True:
            try:
                request = memoryview(os.read(self._fuse, _MOST_BYTES + 4096))
            except OSError as err:
                if err.errno == errno.ENODEV:  # unmounted
                    return
                if err.errno in (errno.EINTR, errno.EAGAIN, errno.ENOENT):  # ENOENT: it was taken back
                    continue
                raise
            _, opcode, unique, node, *_ = _IN.unpack_from(request)
            if opcode in _WITHOUT_ANSWER:
                continue
            answer, fault = b"", errno.ENOSYS
            if opcode in self._answers:
                try:
                    answer, fault = self._answers[opcode](node, request[_IN.size :]), 0
                except OSError as err:
                    fault = err.errno or errno.EIO
            os.write(self._fuse, _OUT.pack(_OUT.size + len(answer), -fault, unique) + answer)

    def _look_up(self, _node: int, name: memoryview) -> bytes:
        if bytes(name).rstrip(b"\0") != DISK.encode():
            raise FileNotFoundError(errno.ENOENT, "no such file")
        return _ENTRY.pack(_FILE, 0, _VALID_S, _VALID_S, 0, 0) + self._describe(_FILE)

    def _attributes(self, node: int, _body: memoryview) -> bytes:
        return struct.pack("<QII", _VALID_S, 0, 0) + self._describe(node)

    def _describe(self, node: int) -> bytes:
        size, mode = (0, stat.S_IFDIR | 0o700) if node == _ROOT else (len(self._content), stat.S_IFREG | 0o600)
        return _ATTRIBUTES.pack(node, size, size // SECTOR_BYTES, 0, 0, 0, 0, 0, 0, mode, 1, 0, 0, 0, 4096, 0)

    def _read(self, _node: int, body: memoryview) -> bytes:
        _, offset, size = _TRANSFER.unpack_from(body)
        return bytes(self._content[offset : offset + size])

    def _write(self, _node: int, body: memoryview) -> bytes:
        _, offset, size = _TRANSFER.unpack_from(body)
        data = bytes(body[_WRITE_BYTES : _WRITE_BYTES + size])
        self._check()
        with self._lock:
            self._content[offset : offset + size] = data
            self._pending.append((offset, data))
        return struct.pack("<II", size, 0)

    def _check(self) -> None:
        if self.is_broken:
            raise OSError(errno.EIO, "broken")

    def _flush(self, _node: int, _body: memoryview) -> bytes:
        self._check()
        with self._lock:
            for offset, data in self._pending:
                self._durable[offset : offset + len(data)] = data
            self._pending.clear()
        return b""
