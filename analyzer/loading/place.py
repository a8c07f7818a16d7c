"""Where traces are, and where the results of their analysis go."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from dds_trace.base.errors import OptionError

REMOTE = re.compile(r"^([a-z][a-z0-9+.-]+):/+")
"""Start of a path in object storage, as `pathlib` writes it."""


def is_remote(path: Path) -> bool:
    return REMOTE.match(os.fspath(path)) is not None


PathText: TypeAlias = str | os.PathLike[str]
Paths: TypeAlias = PathText | Sequence[PathText]


OUTPUT_FOLDER = "analysis"


@dataclass(frozen=True, slots=True)
class Place:
    """`parts` are at or below `folder`, to which names of traces are relative."""

    folder: Path
    parts: tuple[Path, ...]

    @classmethod
    def of(cls, paths: Paths) -> Place:
        """Return the place of a path, or of several on this machine; several in object storage are an `OptionError`."""
        arguments = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
        parts = tuple(dict.fromkeys(Path(path) for path in arguments))
        if not parts:
            raise OptionError("no path; give the folder with the traces")
        if len(parts) == 1:
            return cls(parts[0], parts)
        if any(map(is_remote, parts)):
            raise OptionError("only one path in object storage can be read; give the folder that contains all of them")
        if any(part.is_absolute() for part in parts):
            parts = tuple(part.absolute() for part in parts)
        return cls(Path(os.path.commonpath(parts)), parts)

    @property
    def default_output(self) -> Path:
        """Return `analysis/` in the folder, next to a trace, or in the working directory for a remote path."""
        if self._is_scattered:
            raise OptionError(
                f"the {len(self.parts)} paths have no folder in common; give a folder for the results with --out"
            )
        if is_remote(self.folder):
            return Path(OUTPUT_FOLDER)
        is_trace = self.folder.is_file() or (self.folder / "metadata.yaml").is_file()
        return (self.folder.parent if is_trace else self.folder) / OUTPUT_FOLDER

    @property
    def own_folders(self) -> set[Path]:
        default_outputs = {Place.of(part).default_output for part in self.parts}
        return default_outputs if self._is_scattered else default_outputs | {self.default_output}

    @property
    def _is_scattered(self) -> bool:
        return len(self.parts) > 1 and os.fspath(self.folder) == self.folder.anchor


def default_output(path: Paths) -> Path:
    return Place.of(path).default_output
