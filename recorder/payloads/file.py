"""`file:PATH`: the bytes of a file, or of each file in a folder in turn, sent as `binary` data."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.tracefile import OptionError

from .base import Payload, Source, check_held_bytes
from .binary import BINARY, image_message

if TYPE_CHECKING:
    from .base import Message, Surroundings


def load_payload(where: str) -> Payload:
    """Return one image for each file at `where`, in the order of their names; hidden files are left out.

    Raises:
        OptionError: there is no file, one that is empty, or more than is held in memory.
    """
    path = Path(where)
    try:
        files = _files(path)
        check_held_bytes(sum(file.stat().st_size for file in files), path)
        messages = tuple(map(_message, files))
    except OSError as err:
        raise OptionError(
            f"--data file:{where}: {err.strerror or err}; name a file or a folder of files"
        ) from err
    return Payload(
        BINARY, messages, max(message.payload_bytes for message in messages), source=f"file:{where}"
    )


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    files = sorted(file for file in path.iterdir() if file.is_file() and not file.name.startswith("."))
    if not files:
        raise OptionError(f"--data file:{path}: the folder holds no files")
    return files


def _message(file: Path) -> Message:
    data = file.read_bytes()
    if not data:
        raise OptionError(f"--data file:{file}: the file is empty, there is nothing to send")
    return image_message(data)


def _open(where: str, _surroundings: Surroundings) -> AbstractContextManager[Payload]:
    return nullcontext(load_payload(where))


FILE = Source(name="file", usage="file:PATH", open=_open)
