"""Middleware libraries that a process has loaded, and their versions."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from pathlib import Path

from .vendors import VENDORS

_LOADED = re.compile(r"^\S+ r\S+ \w+ \S+ \d+ +(/\S.*\.so[.\d]*)$", re.MULTILINE)
_VERSION = re.compile(r"\.so\.(\d+(?:\.\d+)+)$")


@dataclass(frozen=True, slots=True)
class Library:
    """One loaded library of a middleware.

    Attributes:
        name: file name as it is loaded, without its folder.
        vendor: middleware that it belongs to.
        version: of its file name, or of the Python distribution that carries it; empty if neither tells.
    """

    name: str
    vendor: str
    version: str = ""


def read_libraries(pid: int | None = None) -> tuple[Library, ...]:
    """Return the middleware libraries that a process has loaded, by name; the calling process by default."""
    try:
        text = Path(f"/proc/{os.getpid() if pid is None else pid}/maps").read_text(errors="replace")
    except OSError:
        return ()
    return parse_libraries(text)


def parse_libraries(text: str) -> tuple[Library, ...]:
    """Return the middleware libraries in the text of `/proc/PID/maps`, by name."""
    paths = sorted({Path(path) for path in _LOADED.findall(text)})
    return tuple(
        Library(path.name, facts.vendor, _version(path, distribution))
        for path in paths
        for facts in VENDORS.values()
        for pattern, distribution in facts.libraries.items()
        if re.match(pattern, path.name)
    )


def _version(path: Path, distribution: str) -> str:
    """Return the fullest version of a library: three numbers in its file name, else its distribution's, else two."""
    named = _VERSION.search(path.name)
    in_name = named[1] if named else ""
    if in_name.count(".") >= 2 or not distribution:
        return in_name
    return _distribution_version(distribution) or in_name


@cache  # a look at the file system, for the same few names at each snapshot
def _distribution_version(distribution: str) -> str:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return ""
