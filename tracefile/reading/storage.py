"""How each file of a trace is opened."""

from __future__ import annotations

import os
import re
import tempfile
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING

import zstandard

from dds_trace.base.errors import MissingEventsError, TraceFormatError

from ..format.bag_metadata import METADATA_NAME
from ..mcapfile.chunks import LARGEST_RATIO
from .mcap_source import McapSource
from .sqlite_rows import SqliteSource

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator
    from concurrent.futures import Executor

    from .source import Source

ZSTD_SUFFIX = ".zstd"
_COPY_BYTES = 1 << 20


_OPENERS: dict[str, Callable[[Path, Executor, Path], Source]] = {
    ".mcap": McapSource,
    ".db3": lambda path, _pool, shown_as: SqliteSource(path, shown_as),
}


def find_traces(folder: str | os.PathLike[str], *, skip: Collection[str | os.PathLike[str]] = ()) -> list[Path]:
    """Find the traces in `folder` and below it: `.mcap` files and rosbag2 folders, sorted, without those in `skip`.

    Files are found by name and not opened; `read_trace` refuses what is not a trace. A `folder` that is itself a file or a
    rosbag2 folder is the only trace. Links to folders are not followed.

    Raises:
        MissingEventsError: `folder` does not exist.
    """
    folder, left_out = Path(folder), {Path(path).resolve() for path in skip}
    if folder.is_file() or (folder.is_dir() and is_bag(folder)):
        return [folder]
    if not folder.is_dir():
        raise MissingEventsError(f"{folder}: no such file or folder; give the folder with the traces")
    traces: list[Path] = []
    for name, folders, files in os.walk(folder):
        parent, real = Path(name), Path(name).resolve()

        def is_left_out(child: Path, real: Path = real) -> bool:
            # Only a link leads elsewhere, and resolving every path is slow.
            return (child.resolve() if child.is_symlink() else real / child.name) in left_out

        searched = [child for child in folders if not is_left_out(parent / child)]
        traces += [parent / child for child in searched if is_bag(parent / child)]
        folders[:] = [child for child in searched if not is_bag(parent / child)]
        traces += [parent / file for file in files if file.endswith(".mcap") and not is_left_out(parent / file)]
    return sorted(traces)


def storage_files(path: Path) -> list[Path]:
    """Return the files of a trace in the order in which they were recorded: `bag_10.mcap` after `bag_9.mcap`."""
    if not path.is_dir():
        return [path]
    try:
        stored = [file for file in path.iterdir() if _opener_suffix(file) and file.is_file()]
    except OSError as err:
        raise TraceFormatError(path, f"cannot be read ({err.strerror})") from err
    files = [file for file in stored if file.suffix != ZSTD_SUFFIX or file.with_suffix("") not in stored]
    if not files:
        raise TraceFormatError(path, "not a rosbag2 folder: it contains no .mcap or .db3 file")
    return sorted(
        files,
        key=lambda file: [(len(part), part) if part.isdigit() else (0, part) for part in re.split(r"(\d+)", file.name)],
    )


def is_bag(folder: Path) -> bool:
    """Return whether a folder has a `metadata.yaml` and a storage file."""
    try:
        return (folder / METADATA_NAME).is_file() and any(_opener_suffix(file) for file in folder.iterdir())
    except OSError:  # no permission: nothing in it can be found
        return False


@contextmanager
def open_source(file: Path, pool: Executor) -> Iterator[Source]:
    """Open a storage file within the block."""
    opener = _OPENERS[_opener_suffix(file) or ".mcap"]
    with ExitStack() as opened:
        path = file
        if file.suffix == ZSTD_SUFFIX:
            copy = opened.enter_context(tempfile.NamedTemporaryFile(prefix="dds-trace-"))
            unpack_file(file, copy)
            path = Path(copy.name)
        yield opened.enter_context(closing(opener(path, pool, file)))


def _opener_suffix(file: Path) -> str | None:
    suffix = file.with_suffix("").suffix if file.suffix == ZSTD_SUFFIX else file.suffix
    return suffix if suffix in _OPENERS else None


def unpack_file(packed: Path, copy: IO[bytes], ratio: int = LARGEST_RATIO, unsuspected_bytes: int = 0) -> None:
    """Unpack a file as far as possible; the reader reports a cut off copy."""
    limit = max(packed.stat().st_size * ratio, unsuspected_bytes)
    with packed.open("rb") as stream, zstandard.ZstdDecompressor().stream_reader(stream) as reader:
        written = 0
        while True:
            try:
                data = reader.read(_COPY_BYTES)
            except zstandard.ZstdError as err:
                if not written:
                    raise TraceFormatError(packed, f"cannot be unpacked ({err})", 0) from err
                break
            written += len(data)
            if not data:
                break
            if written > limit:
                raise TraceFormatError(packed, f"unpacks to more than {ratio} times its size; not read")
            copy.write(data)
        copy.flush()
