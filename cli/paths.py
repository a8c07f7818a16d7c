"""The paths of `dds-analyze`, with the patterns that no shell has expanded."""

from __future__ import annotations

import glob
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.tracefile import MissingEventsError, limits

if TYPE_CHECKING:
    from collections.abc import Sequence


def expand_paths(texts: Sequence[str]) -> list[Path]:
    """Return the paths that these texts mean: each one that is there or in object storage, and what a pattern matches.

    Raises:
        OptionError: a text cannot be a path.
        MissingEventsError: nothing matches a pattern.
    """
    paths: list[Path] = []
    for text in texts:
        limits.check(limits.INPUT, text, "PATH")
        if not glob.has_magic(text) or Path(text).exists() or "://" in text:
            paths.append(Path(text))
            continue
        matches = sorted(glob.glob(text, recursive=True))  # noqa: PTH207 - pathlib's takes no absolute pattern
        if not matches:
            raise MissingEventsError(
                f"{text}: no file or folder matches; give the folder that dds-record wrote into"
            )
        paths += map(Path, matches)
    return paths
