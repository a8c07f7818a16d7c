"""A program that runs under guard: what it, or a library in it, opens for writing, makes, renames or removes.

Python's own calls are seen anywhere, by an audit hook in the program. What C and Rust do is seen in the watched folders, by
inotify. A SQLite connection has to be to a file of ours, in the first of `allowed`, or one that only reads (`immutable=1`).
"""

import ctypes
import os
import struct
import sys
from collections.abc import Sequence
from pathlib import Path

from processes import executed

_HOOK = """
import os, sys
_report, _allowed = os.fdopen(int(sys.argv.pop(1)), "w"), tuple(sys.argv.pop(1).split(os.pathsep))
_CHANGES = {"os.remove": 1, "os.rename": 2, "os.rmdir": 1, "os.mkdir": 1, "os.truncate": 1, "os.link": 2, "os.symlink": 2,
    "os.chmod": 1, "os.chown": 1, "os.utime": 1}

def _check(event, path, folder, allowed=_allowed):
    if not isinstance(path, (str, bytes, os.PathLike)):
        return
    path = os.fsdecode(path)
    if isinstance(folder, int) and folder >= 0 and not os.path.isabs(path):
        path = os.path.join(os.readlink(f"/proc/self/fd/{folder}"), path)
    path = os.path.abspath(path)
    if path != os.devnull and not path.startswith(allowed):
        print(event, path, file=_report, flush=True)

def _audit(event, args):
    if event == "open" and args[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND):
        _check(event, args[0], -1)
    elif event == "sqlite3.connect" and "immutable=1" not in str(args[0]):
        _check(event, args[0], -1, _allowed[:1])
    elif event in _CHANGES:
        for path in args[: _CHANGES[event]]:
            _check(event, path, args[-1])

sys.addaudithook(_audit)
"""
_CLOSED_AFTER_WRITING, _CHANGED = 0x8, 0x2 | 0x4 | 0x40 | 0x80 | 0x100 | 0x200 | 0x400 | 0x800
_EVENT = struct.Struct("iIII")


def touched(program: str, arguments: Sequence[str | Path], watched: Path, allowed: Sequence[Path]) -> list[str]:
    """Run Python code with arguments; return what was done to paths outside of `allowed`, and to anything below `watched`."""
    libc = ctypes.CDLL(None, use_errno=True)
    events = libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
    for folder in (watched, *(path for path in watched.rglob("*") if path.is_dir())):
        assert libc.inotify_add_watch(events, os.fsencode(folder), _CLOSED_AFTER_WRITING | _CHANGED) > 0
    report_read, report_write = os.pipe()
    hook_arguments = [str(report_write), os.pathsep.join(map(str, allowed)), *map(str, arguments)]
    result = executed([sys.executable, "-B", "-c", _HOOK + program, *hook_arguments], pass_fds=[report_write])
    os.close(report_write)
    with os.fdopen(report_read) as report:
        found = report.read().splitlines()
    with os.fdopen(events, "rb", buffering=0) as stream:
        data = stream.read() or b""
    while data:
        _, mask, _, length = _EVENT.unpack_from(data)
        name = data[_EVENT.size : _EVENT.size + length].rstrip(b"\0").decode()
        found.append(f"inotify {mask:#x} {name}")
        data = data[_EVENT.size + length :]
    assert "Traceback" not in result.stderr, result.stderr
    return found
