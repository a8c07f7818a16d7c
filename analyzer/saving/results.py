"""The results of one analysis, which replace the earlier ones in their folder together.

All new files are complete in a folder of drafts, `results.xxxxxxxx.part`, before its name becomes `results.xxxxxxxx.whole`. From then
on they are the results: a process that dies while it moves them leaves the rest to the next analysis. Earlier files
go first, so that old and new ones are never in the folder together.
"""

from __future__ import annotations

import fcntl
import os
import re
import secrets
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from dds_trace.base.errors import OutputError
from dds_trace.base.files import folder_lock, output_errors, remove_drafts

RESULT_NAMES = (
    *(f"{name}.{kind}" for name in ("roundtrips", "summary") for kind in ("parquet", "csv", "arrow")),
    *(f"report.{kind}" for kind in ("html", "md", "json")),
    *("openmetrics.txt", "latency.hlog", "timeline.pftrace", "otava.csv", "otava.yaml", "bencher.json"),
    *(f"figures{width}.{kind}" for width in ("", "-column") for kind in ("pdf", "tex")),
    *("github-benchmark-smaller.json", "github-benchmark-bigger.json"),
    "latency.derived.mcap",
    "latency.derived.foxglove.json",
)

_DRAFTS = re.compile(r"results\.[0-9a-f]{8}\.(part|whole)")
_MARK = ".dds-trace"
"""Empty file in each folder of drafts, by which a later process knows it as ours."""
_LOCK_S = 2.0


@contextmanager
def replacing_results(folder: Path) -> Iterator[Path]:
    """Yield a folder for drafts, which replace the results of their names once the block ends without an error."""
    with ExitStack() as stack:
        with output_errors(folder):
            missing = [path for path in (folder, *folder.parents) if not path.exists()]
            drafts = _open_drafts(folder, stack)
        try:
            yield drafts
            with output_errors(folder):
                for target in (folder / draft.name for draft in drafts.iterdir()):
                    if target.is_dir() and not target.is_symlink():
                        raise OutputError(f"{target} is a folder; give another folder with --out")
                with _finished_results(folder):
                    whole = drafts.rename(drafts.with_suffix(".whole"))
                    _move_results(whole)
                    _remove(whole)
        finally:
            with suppress(OSError):  # after an error
                _remove(drafts)
            for path in missing:
                with suppress(OSError):  # it has the results
                    path.rmdir()


def _open_drafts(folder: Path, stack: ExitStack) -> Path:
    """Create the folder of drafts, locked until the stack ends, so that others see that somebody writes into it."""
    folder.mkdir(parents=True, exist_ok=True)
    remove_drafts(folder, RESULT_NAMES)
    with _finished_results(folder):
        drafts = folder / f"results.{secrets.token_hex(4)}.part"
        drafts.mkdir()
        (drafts / _MARK).touch()
        stack.enter_context(folder_lock(drafts, fcntl.LOCK_SH))
        return drafts


@contextmanager
def _finished_results(folder: Path) -> Iterator[None]:
    with folder_lock(folder, fcntl.LOCK_EX, _LOCK_S) as is_ours:
        for leftover in sorted(folder.iterdir()) if is_ours else ():
            if _DRAFTS.fullmatch(leftover.name) and leftover.is_dir() and not leftover.is_symlink():
                with folder_lock(leftover, fcntl.LOCK_EX) as is_dead, suppress(OSError):
                    if is_dead and _is_ours(leftover):
                        if leftover.suffix == ".whole":
                            _move_results(leftover)
                        _remove(leftover)
        yield


def _is_ours(drafts: Path) -> bool:
    files = list(drafts.iterdir())
    is_marked = not files or drafts / _MARK in files
    is_plain = all(path.is_file() and not path.is_symlink() for path in files)
    return is_marked and is_plain and {path.lstat().st_uid for path in (drafts, *files)} == {os.geteuid()}


def _move_results(whole: Path) -> None:
    """Move complete results to their names, again if need be; earlier files are moved away first, as deleting is slow."""
    folder = whole.parent
    names = sorted(path.name for path in whole.iterdir() if path.name != _MARK and path.suffix != ".old")
    for name in names[1:]:  # a single one is replaced at once
        with suppress(FileNotFoundError):
            (folder / name).replace(whole / f"{name}.old")
    for name in names:
        (whole / name).replace(folder / name)


def _remove(drafts: Path) -> None:
    for path in sorted(drafts.iterdir(), key=lambda path: path.name == _MARK):
        path.unlink()
    drafts.rmdir()
