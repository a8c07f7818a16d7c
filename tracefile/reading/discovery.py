"""The traces in a folder."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import MissingEventsError
from .storage import is_bag

if TYPE_CHECKING:
    from collections.abc import Collection


def find_traces(folder: Path, *, skip: Collection[Path] = ()) -> list[Path]:
    """All `.mcap` files and rosbag2 folders in `folder` and below it, sorted; a rosbag2 folder is one entry.

    Files are found by name and not opened; `read_trace` says which of them are traces. A `folder` that is itself a
    file or a rosbag2 folder is the only entry. Links to folders are not followed.

    Args:
        folder: where to look.
        skip: files and folders to leave out, with all that is in them.

    Raises:
        MissingEventsError: there is no such folder.
    """
    left_out = {Path(path).resolve() for path in skip}
    if folder.is_file() or (folder.is_dir() and is_bag(folder)):
        return [folder]
    if not folder.is_dir():
        raise MissingEventsError(f"{folder}: no such file or folder")
    found: list[Path] = []
    for name, folders, files in os.walk(folder):
        here = Path(name)
        kept = [child for child in folders if (here / child).resolve() not in left_out]
        found += [here / child for child in kept if is_bag(here / child)]
        folders[:] = [child for child in kept if not is_bag(here / child)]
        found += [
            here / file
            for file in files
            if file.endswith(".mcap") and (here / file).resolve() not in left_out
        ]
    return sorted(found)
