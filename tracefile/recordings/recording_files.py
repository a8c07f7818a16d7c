"""Files of a foreign recording, each readable by itself, and the messages that its metadata claims."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from dds_trace.base.errors import TraceFormatError
from dds_trace.base.files import open_regular
from dds_trace.base.units import counted

from ..format.bag_metadata import METADATA_NAME
from ..mcapfile.blocks import LARGEST_FILE_RATIO, most_unpacked_bytes
from ..reading.storage import ZSTD_SUFFIX, storage_files, unpacked

_MOST_METADATA_BYTES = 16 << 20
"""A thousand topics with the QoS of ten publishers each have 6 MB."""


@dataclass(slots=True)
class RecordingFiles:
    """The files, each as it can be read, with the names that they have."""

    files: list[Path]
    names: list[Path]
    damages: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    claimed: Mapping[str, int] = field(default_factory=dict)


@contextmanager
def open_recording(path: Path) -> Iterator[RecordingFiles]:
    """Yield the files of a recording, packed ones as temporary copies."""
    recording = _described(path) if path.is_dir() else RecordingFiles([path], [path])
    with ExitStack() as stack:
        copies = (unpacked(file, LARGEST_FILE_RATIO, most_unpacked_bytes(0)) for file in recording.files)
        recording.files = [stack.enter_context(copy) for copy in copies]
        yield recording


_HASHED_BYTES = 4096


def content_hash(data: bytes) -> int:
    return hash((len(data), bytes(data[:_HASHED_BYTES]), bytes(data[-_HASHED_BYTES:])))


def copied_messages(topic: str, copies: int) -> Iterator[str]:
    if copies:
        yield f"{counted(copies, 'message')} of {topic} {'is' if copies == 1 else 'are'} there twice (same time and bytes): a merged bag, or a reset?"


def _described(folder: Path) -> RecordingFiles:
    stored = storage_files(folder)
    listed, claimed = _read_metadata(folder / METADATA_NAME)
    if not listed:
        return RecordingFiles(stored, stored[:], claimed=claimed)
    names = {name.removesuffix(ZSTD_SUFFIX) for name in listed}
    files = [file for file in stored if file.name.removesuffix(ZSTD_SUFFIX) in names]
    missing = sorted(names - {file.name.removesuffix(ZSTD_SUFFIX) for file in files})
    unlisted = [file for file in stored if file not in files]
    if len(missing) == len(unlisted) == 1:
        note = f"{unlisted[0].name} is not listed in {METADATA_NAME} and is read as {missing[0]}, which is not here: renamed?"
        return RecordingFiles(stored, stored[:], notes=[note], claimed=claimed)
    damages = [f"{name} is listed in {METADATA_NAME} but is not here" for name in missing]
    notes = [f"{file.name} is not listed in {METADATA_NAME} and was not read" for file in unlisted]
    if not files:
        raise TraceFormatError(folder, "; ".join([*damages, *notes][:3]))
    return RecordingFiles(files, files[:], damages, notes, claimed)


def _read_metadata(path: Path) -> tuple[list[str], dict[str, int]]:
    """Return the listed files and the messages of each topic, nothing where the file cannot be read."""
    try:
        with open_regular(path) as file:
            text = file.read(_MOST_METADATA_BYTES).decode(errors="replace")
    except OSError:
        return [], {}
    listed: list[str] = []
    claimed: dict[str, int] = {}
    section, section_indent = "", 0
    name, count = None, None
    for line in text.splitlines():
        key = _KEY.match(line)
        if key and len(key["indent"]) <= section_indent and not key["item"]:
            section = ""
        if key and not section and key["key"] in {"relative_file_paths", "topics_with_message_count"}:
            section, section_indent = key["key"], len(key["indent"])
        elif section == "relative_file_paths" and (item := _ITEM.match(line)):
            listed.append(Path(_plain(item[1])).name)
        elif section == "topics_with_message_count" and key:
            if key["key"] == "name":
                name = _plain(key["value"])
            elif key["key"] == "message_count" and _COUNT.fullmatch(key["value"].strip()):
                count = int(key["value"])
            if name is not None and count is not None:
                claimed[name] = claimed.get(name, 0) + count
                name, count = None, None
    return listed, claimed


_KEY = re.compile(r"(?P<indent> *)(?P<item>- )? *(?P<key>\w+):(?P<value>.*)")
_ITEM = re.compile(r" *- +(.+)")
_COUNT = re.compile(r"\d{1,18}")


def _plain(text: str) -> str:
    text = text.strip()
    return text[1:-1] if len(text) > 1 and text[0] == text[-1] and text[0] in "\"'" else text
