"""A plan from the answers to three questions."""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.base.units import parse_size, split_quantity
from dds_trace.recorder.options import DEFAULT_MESSAGES
from dds_trace.recorder.payloads import check_data, sources

from .link import PRESETS
from .schema import INSTALLED, POINTER, TABLES, plain

WIDTH = 80

DATA_EXAMPLE = "binary 33KB @ 20, imu @ 100"
HERE, NOTHING = "here", "nothing"

COMPARISONS: Mapping[str, tuple[str, object]] = {
    "middleware": ("backend", INSTALLED),
    "bridge": ("bridge", ["none", "builtin"]),
    "reliability": ("reliability", ["reliable", "best_effort"]),
    "tuning": ("tuned", [False, True]),
    "serialization": ("serialization", ["raw", "typed"]),
}


@dataclass(frozen=True, slots=True)
class Message:
    """One kind of message: `--data`, `--size` (None: its own) and `--rate`."""

    data: str
    size: str | None
    rate_hz: float


def parse_messages(text: str) -> list[Message]:
    return [_message(part.strip()) for part in text.split(",")]


def _message(text: str) -> Message:
    described, at, rate = text.rpartition("@")
    quantity = split_quantity(rate.lower().removesuffix("hz"))
    if not at or quantity is None or quantity[1]:
        raise OptionError(f"{limits.shown(text)}: write a kind, a size and a rate, for example {DATA_EXAMPLE}")
    data, size = described.strip(), None
    kind, colon, _ = data.partition(":")
    if not (colon and kind in sources()):
        data, *sizes = data.split() or [""]
        size = "".join(sizes) or None
    check_data(data)
    limits.check(limits.RATE_HZ, quantity[0], "the rate")
    if size is not None:
        limits.check(limits.SIZE_BYTES, parse_size(size), "the size")
    return Message(data, size, quantity[0])


def parse_comparisons(text: str) -> list[str]:
    words = [word for word in re.split(r"[,\s]+", text.strip()) if word and word != NOTHING]
    for word in words:
        if word not in COMPARISONS:
            raise OptionError(f"{limits.shown(word)}: {limits.nearest(word, [*COMPARISONS, NOTHING])}")
    return list(dict.fromkeys(words))


def check_location(text: str) -> str:
    location = text.strip()
    if location != HERE and location not in PRESETS and "@" not in location:
        raise OptionError(f"{limits.shown(location)}: write {HERE}, USER@HOST, or a link: {', '.join(PRESETS)}")
    limits.check(limits.NAME, location, "the relay's device")
    return location


def plan_text(name: str, messages: Sequence[Message], comparisons: Sequence[str], location: str) -> str:
    axes = [_line("axes", *COMPARISONS[word]) for word in comparisons]
    blocks = [
        POINTER,
        "\n".join(
            [
                f"# Check it:   dds-trace sweep {name}.toml --rehearse",
                f"# Record it:  dds-trace sweep {name}.toml --out runs/",
                f"# Look:       dds-trace analyze runs/{name} --report html",
            ]
        ),
        _block(
            "[run]",
            "run",
            [
                _line("run", "messages", DEFAULT_MESSAGES),
                _line("run", "repeats", 5),
                _line("run", "order", "alternating"),
            ],
        ),
        *([_block("[axes]", "axes", axes)] if axes else []),
        *(_matrix(message) for message in messages),
        *_where(location),
    ]
    return "\n\n".join(blocks) + "\n"


def _matrix(message: Message) -> str:
    values = {"data": message.data, "size": message.size, "rate": message.rate_hz}
    lines = [f"{key} = {_toml(value)}" for key, value in values.items() if value is not None]
    return "\n".join(["[[matrix]]", *lines])


def _where(location: str) -> list[str]:
    if location == HERE:
        return []
    if location in PRESETS:
        return [_block("[link]", "link", [_line("link", "preset", location)])]
    lines = [_line("devices.relay", "ssh", location)]
    further = [_comment(f"{key}: {plain(TABLES['devices.relay'].keys[key].meaning)}") for key in ("setup", "path")]
    return [_block("[devices.relay]", "devices.relay", [*lines, *further])]


def _block(title: str, table: str, lines: Sequence[str]) -> str:
    return "\n".join([_comment(plain(TABLES[table].meaning)), title, *lines])


def _line(table: str, key: str, value: object) -> str:
    return f"{_comment(plain(TABLES[table].keys[key].meaning))}\n{key} = {_toml(value)}"


def _comment(text: str) -> str:
    whole = text.replace("**", "").replace("`. ", "`.\u00a0")  # a command stays in one line
    return textwrap.fill(whole, WIDTH, initial_indent="# ", subsequent_indent="# ").replace("\u00a0", " ")


def _toml(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.15g}"
    # JSON is TOML here, but for DEL.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
