"""How each file of a trace is opened."""

from __future__ import annotations

import errno
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import Executor
from contextlib import closing, contextmanager
from pathlib import Path

import zstandard

from dds_trace.base.errors import MissingEventsError, OutputError, TraceFormatError
from dds_trace.base.extension import load, offers
from dds_trace.base.files import real_path

from ..format.bag_metadata import METADATA_NAME
from ..mcapfile.chunks import LARGEST_RATIO
from .mcap_source import McapSource
from .source import Source

ZSTD_SUFFIX = ".zstd"
_COPY_BYTES, _FRAME_HEAD_BYTES = 1 << 20, 18


def find_traces(folder: str | os.PathLike[str], *, skip: Collection[str | os.PathLike[str]] = ()) -> list[Path]:
    """Find the traces in `folder` and below it: `.mcap` files and rosbag2 folders, sorted, without those in `skip`.

    Files are found by name and not opened; `read_trace` refuses what is not a trace. A `folder` that is itself a file or a
    rosbag2 folder is the only trace. Links to folders are not followed.

    Raises:
        MissingEventsError: `folder` does not exist.
    """
    return find_storage(folder, skip, is_bag, (".mcap",), "the folder with the traces")


def find_storage(
    path: str | os.PathLike[str],
    skip: Collection[str | os.PathLike[str]],
    is_one: Callable[[Path], bool],
    suffixes: tuple[str, ...],
    cure: str,
) -> list[Path]:
    folder, left_out = Path(path), {real_path(other) for other in skip}
    if folder.is_file() or (folder.is_dir() and is_one(folder)):
        return [folder]
    if not folder.is_dir():
        raise MissingEventsError(f"{folder}: no such file or folder; give {cure}")
    recordings: list[Path] = []
    for name, folders, files in os.walk(folder):
        parent, real = Path(name), real_path(name)

        def is_left_out(child: Path, real: Path = real) -> bool:
            # Only a link leads elsewhere, and resolving every path is slow.
            return (real_path(child) if child.is_symlink() else real / child.name) in left_out

        searched = [child for child in folders if not is_left_out(parent / child)]
        recordings += [parent / child for child in searched if is_one(parent / child)]
        folders[:] = [child for child in searched if not is_one(parent / child)]
        listed = [file for file in files if file.endswith(suffixes) and not is_left_out(parent / file)]
        recordings += [parent / file for file in listed if file.removesuffix(ZSTD_SUFFIX) not in {*files} - {file}]
    return sorted(recordings)


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
    try:
        return (folder / METADATA_NAME).is_file() and any(_opener_suffix(file) for file in folder.iterdir())
    except OSError:  # no permission: nothing in it can be found
        return False


@contextmanager
def open_source(file: Path, pool: Executor) -> Iterator[Source]:
    suffix = _opener_suffix(file) or ".mcap"
    with unpacked(file) as path:
        opened: Source = McapSource(path, pool, file) if suffix == ".mcap" else load("storages", suffix)(path, file)
        with closing(opened) as source:
            yield source


def _opener_suffix(file: Path) -> str | None:
    suffix = file.with_suffix("").suffix if file.suffix == ZSTD_SUFFIX else file.suffix
    return suffix if suffix == ".mcap" or suffix in offers("storages") else None


@contextmanager
def unpacked(packed: Path, ratio: int = LARGEST_RATIO, unsuspected_bytes: int = 0) -> Iterator[Path]:
    """Yield a file, of a packed one a copy, unpacked as far as there is room; the reader reports one that is cut off."""
    if packed.suffix != ZSTD_SUFFIX:
        yield packed
        return
    limit = max(packed.stat().st_size * ratio, unsuspected_bytes)
    with tempfile.TemporaryDirectory(prefix="dds-trace-") as folder:
        path = Path(folder) / packed.stem
        try:
            _unpack(packed, path, ratio, limit)
        except OSError as err:
            if err.errno not in {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}:
                raise
            where = f"it is unpacked into {Path(folder).parent}, which has no room for that"
            raise OutputError(f"{packed}: {where} ({err.strerror}); set TMPDIR to a folder with more") from err
        yield path


def _unpack(packed: Path, path: Path, ratio: int, limit: int) -> None:
    with (
        path.open("wb") as copy,
        packed.open("rb") as stream,
        zstandard.ZstdDecompressor().stream_reader(stream) as reader,
    ):
        try:
            size_bytes = zstandard.frame_content_size(stream.read(_FRAME_HEAD_BYTES))
            stream.seek(0)
            free_bytes = shutil.disk_usage(path.parent).free
            if free_bytes < size_bytes <= limit:
                raise OSError(errno.ENOSPC, f"{size_bytes >> 20} MiB are needed, {free_bytes >> 20} MiB are free")
            while data := reader.read(_COPY_BYTES):
                copy.write(data)
                if copy.tell() > limit:
                    raise TraceFormatError(packed, f"unpacks to more than {ratio} times its size; not read")
        except zstandard.ZstdError as err:
            if not copy.tell():
                raise TraceFormatError(packed, f"cannot be unpacked ({err})", 0) from err
