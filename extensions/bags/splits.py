"""Files of one recording that was split, without the metadata.yaml that lists them: names that count on, and times that go on."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from dds_trace.base.units import SECOND_NS

from .bounds import FEWEST

_NUMBER = r"(?P<number>0|[1-9]\d{0,6})"
_TIME = r"\d{4}[-_]\d\d[-_]\d\d-\d\d[-_]\d\d[-_]\d\d"
_NAMES = (re.compile(rf"{_NUMBER}_(?P<name>.+)_{_TIME}"), re.compile(rf"(?P<name>(?!.*{_TIME}$).+)_{_NUMBER}"))
"""Of Lyrical (N_NAME_TIME), and of earlier rosbag2 and rosbag (NAME_N)."""


class Part(NamedTuple):
    """One file; `series` is how the files of its recording are named, `number` None for a file by itself."""

    path: Path
    series: tuple[str, ...]
    number: int | None = None


def parts_of(paths: Iterable[Path]) -> list[list[Part]]:
    """Group files with names that count on, by number; others, and folders, by themselves."""
    groups: dict[tuple[str, ...], list[Part]] = {}
    for path in paths:
        part = _part(path)
        groups.setdefault(part.series, []).append(part)
    return [sorted(group, key=lambda part: part.number or 0) for group in groups.values()]


def _part(path: Path) -> Part:
    suffixes = "".join(path.suffixes[-2:]) if path.suffix in (".zstd", ".active") else path.suffix
    for kind, pattern in enumerate(_NAMES):
        match = pattern.fullmatch(path.name.removesuffix(suffixes))
        if match and not path.is_dir():
            return Part(path, (str(path.parent), match["name"], suffixes, str(kind)), int(match["number"]))
    return Part(path, (str(path),))


class Span(NamedTuple):
    number: int
    first_ns: int
    last_ns: int


def goes_on(spans: Sequence[Span], following: Span) -> bool:
    """Return whether a file is the next of a recording: it begins where the last one ended, or as much later as lost files are long."""
    last = spans[-1]
    lost = following.number - last.number - 1
    longest_ns = max(span.last_ns - span.first_ns for span in spans)
    gap_ns = following.first_ns - last.last_ns
    return lost >= 0 and -SECOND_NS < gap_ns < FEWEST * SECOND_NS + 2 * lost * longest_ns


def lost_files(parts: Sequence[Part]) -> Iterator[str]:
    for part, following in pairwise(parts):
        if part.number is None or following.number is None or following.number == part.number + 1:
            continue
        first, last = part.number + 1, following.number - 1
        which = f"file {first}" if first == last else f"files {first} to {last}"
        yield f"{which} of this recording {'is' if first == last else 'are'} not here (between {part.path.name} and {following.path.name})"


def shown_path(parts: Sequence[Part], files: Counter[Path]) -> str:
    first = parts[0].path
    if len(parts) == 1:
        return str(first)
    if files[first.parent] == len(parts):
        return str(first.parent)
    _, name, suffix, kind = parts[0].series
    return str(first.parent / (f"*_{name}_*{suffix}" if kind == "0" else f"{name}_*{suffix}"))
