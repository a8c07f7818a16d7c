"""A process in which a table of one room has more rows: what a newcomer's edit does."""

import os
import shutil
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def with_rows(tmp_path, file, rows):
    """The environment of a process with a copy of a room, rows put before others in one of its files."""
    package = tmp_path / "changed" / "dds_trace"
    package.mkdir(parents=True)
    room = file.partition("/")[0]
    for entry in (ROOT / "src" / "dds_trace").iterdir():
        if entry.name == room:
            shutil.copytree(entry, package / entry.name, ignore=shutil.ignore_patterns("__pycache__"))
        elif entry.name != "__pycache__":
            (package / entry.name).symlink_to(entry.resolve())
    text = (package / file).read_text(encoding="utf-8")
    for before, row in rows.items():
        assert text.count(before) == 1
        text = text.replace(before, row + before)
    (package / file).write_text(text, encoding="utf-8")
    return {**os.environ, "PYTHONPATH": str(package.parent), "PYTHONDONTWRITEBYTECODE": "1"}
