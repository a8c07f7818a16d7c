"""`file:PATH`: the bytes of a file, or of each file in a folder, sent as `binary` data."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import BinaryIO

from dds_trace.base.errors import OptionError
from dds_trace.base.files import open_regular

from .base import Message, Payload, Source, check_size, check_stop
from .binary import BINARY, image_message

_PIECE_BYTES = 1 << 20


def load_payload(where: str, stop: threading.Event | None = None) -> Payload:
    path = Path(where)
    try:
        files = _files(path)
        check_size(sum(file.stat().st_size for file in files), path)
        messages = tuple(_message(file, stop) for file in files)
    except OSError as err:
        raise OptionError(f"--data file:{where}: {err.strerror or err}; name a file or a folder of files") from err
    return Payload(BINARY, messages, max(message.payload_bytes for message in messages), source=f"file:{where}")


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    files = sorted(file for file in path.iterdir() if file.is_file() and not file.name.startswith("."))
    if not files:
        raise OptionError(f"--data file:{path}: the folder has no files")
    return files


def _message(file: Path, stop: threading.Event | None) -> Message:
    with open_regular(file) as stream:
        size = os.fstat(stream.fileno()).st_size
        check_size(size, file)
        if not size:
            raise OptionError(f"--data file:{file}: the file is empty; name one with content")
        return image_message(size, _pieces(stream, size, stop))


def _pieces(stream: BinaryIO, size: int, stop: threading.Event | None) -> Iterator[bytes]:
    while size:
        check_stop(stop)
        piece = stream.read(min(_PIECE_BYTES, size))
        if not piece:
            raise OSError("the file became shorter while it was read")
        size -= len(piece)
        yield piece


def check_path(where: str) -> None:
    """Refuse a text that is not a path; an empty one would mean this folder."""
    if not where or "\0" in where:
        raise OptionError(f"--data file:{where}: write file:PATH, a file or a folder of files")


FILE = Source(
    name="file",
    usage="file:PATH",
    open=lambda where, context: nullcontext(load_payload(where, context.stop)),
    check=check_path,
)
