"""Where the traces of an analysis are: one path, or several and their common folder."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from dds_trace.base.errors import OptionError

from ..cache.remote import is_remote

PathText: TypeAlias = str | os.PathLike[str]
Paths: TypeAlias = PathText | Sequence[PathText]
"""One path, or several."""


OUTPUT_FOLDER = "analysis"


@dataclass(frozen=True, slots=True)
class Place:
    """`parts` are at or below `folder`, to which names of traces are relative."""

    folder: Path
    parts: tuple[Path, ...]

    @classmethod
    def of(cls, paths: Paths) -> Place:
        """Return the place of one path, or of several on this machine.

        Raises:
            OptionError: there is no path, or one of several is in object storage.
        """
        given = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
        parts = tuple(dict.fromkeys(Path(path) for path in given))
        if not parts:
            raise OptionError("no path; give the folder that dds-record wrote into")
        if len(parts) == 1:
            return cls(parts[0], parts)
        if any(map(is_remote, parts)):
            raise OptionError("only one path in object storage can be read; give the folder that contains all of them")
        if any(part.is_absolute() for part in parts):
            parts = tuple(part.absolute() for part in parts)
        return cls(Path(os.path.commonpath(parts)), parts)

    @property
    def default_output(self) -> Path:
        """`analysis/` in the folder, next to a trace, or in the working directory for a remote path.

        Raises:
            OptionError: several paths have only the root of the file system in common.
        """
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
        """Default folders of results, of all parts and of each; they are not searched for traces."""
        default_outputs = {Place.of(part).default_output for part in self.parts}
        return default_outputs if self._is_scattered else default_outputs | {self.default_output}

    @property
    def _is_scattered(self) -> bool:
        return len(self.parts) > 1 and os.fspath(self.folder) == self.folder.anchor
