"""Values of options: percentages, pairs, rotation of files, free space."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.base.limits import shown
from dds_trace.base.units import parse_rate, parse_size, split_quantity

from .choices import Call

if TYPE_CHECKING:
    from collections.abc import Iterable

    from dds_trace.tracefile.writing.destination import TraceDestination

AGE_UNITS_S = {"s": 1, "min": 60, "h": 3600, "d": 86_400}


def parse_percentage(name: str, text: str) -> float:
    try:
        share = float(text.strip().removesuffix("%")) / 100
    except ValueError:
        share = -1.0
    if not text.strip().endswith("%") or not 0 <= share <= 1:
        raise OptionError(f"{name} {text!r}: write a percentage from 0% to 100%, for example 1%")
    return share


def parse_pairs(name: str, texts: Iterable[str], example: str) -> dict[str, str]:
    pairs = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not key or not equals:
            raise OptionError(f"{name} {text!r}: write KEY=VALUE, for example {example}")
        pairs[key] = value
    return pairs


def parse_topics(texts: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name.strip() for text in texts for name in text.split(",") if name.strip()))


def parse_rate_or_max(text: str) -> float:
    try:
        rate_hz = math.inf if text == "max" else float(text)
    except ValueError:
        return parse_rate(text, "--rate")
    if text != "max" and not math.isfinite(rate_hz):
        raise OptionError(f"--rate {shown(text)} is not finite; write a rate in messages a second, or max")
    return rate_hz


def parse_rates(texts: Iterable[str]) -> dict[str, float]:
    pairs = parse_pairs("--expect", texts, "/camera/image=30")
    return {name: parse_rate(text, f"-o expect={name}") for name, text in pairs.items()}


@dataclass(frozen=True, slots=True)
class Rotation:
    file_bytes: int | None = None
    age_s: float | None = None
    keep: int | None = None

    @classmethod
    def parse(cls, text: str) -> Rotation:
        file_bytes: int | None = None
        age_s: float | None = None
        for part in text.split(","):
            value, unit = split_quantity(part.strip()) or (0.0, "")
            if unit in AGE_UNITS_S and age_s is None:
                age_s = value * AGE_UNITS_S[unit]
            elif unit.endswith("b") and file_bytes is None:
                file_bytes = parse_size(part.strip(), "--rotate")
            else:
                raise OptionError(
                    f"-o rotate={shown(text)}: write a size, an age (s, min, h, d) or both: 1GB, 1h, 1GB,1h"
                )
        return cls(file_bytes, age_s)

    def check(self, destination: TraceDestination) -> None:
        limits.check(limits.FILE_BYTES, self.file_bytes, "--rotate")
        limits.check(limits.FILE_AGE_S, self.age_s, "--rotate")
        limits.check(limits.RETAINED_FILES, self.keep, "--keep")
        if destination.is_bag:
            raise OptionError(
                "-o rotate writes .mcap files: give --out NAME.mcap, which becomes NAME.00001.mcap and so on"
            )
        if destination.force:
            raise OptionError("-o rotate overwrites nothing and numbers on from the last file; remove --force")


@dataclass(frozen=True, slots=True)
class KeepFree:
    """The disk space to leave free: a share (0 to 1) or `most_bytes`, whichever is less."""

    share: float = 0.05
    most_bytes: int | None = 1_000_000_000

    @classmethod
    def parse(cls, text: str) -> KeepFree:
        if text.strip().endswith("%"):
            return cls(parse_percentage("--keep-free", text), None)
        return cls(1.0, parse_size(text, "--keep-free"))

    def floor_bytes(self, disk_bytes: int) -> int:
        share_bytes = int(self.share * disk_bytes)
        return share_bytes if self.most_bytes is None else min(share_bytes, self.most_bytes)


ACTION_GOAL_BYTES = 4


def check_call(
    call: Call,
    clients: int,
    response_bytes: int | None,
    bridge: str,
    flows: tuple[str, ...],
    size_bytes: int | None,
    *,
    is_one_way: bool = False,
) -> None:
    if call is Call.NONE:
        if clients > 1 or response_bytes is not None:
            raise OptionError("-o clients and -o response_size need -o call=service or action")
    elif bridge != "none":
        raise OptionError(
            f"-o call={call.value} with --bridge {bridge}: bridges are started for topics; use one domain"
        )
    elif flows:
        raise OptionError(f"-o call={call.value} with -o flow={flows[0]}: a flow is a topic; remove one of them")
    elif is_one_way:
        raise OptionError(
            f"-o call={call.value} with --rate max or -o ping_share: each call has a response; remove them"
        )
    elif call is Call.ACTION and size_bytes not in (None, ACTION_GOAL_BYTES):
        raise OptionError(
            f"--size {size_bytes}: the goal of an action is one number of {ACTION_GOAL_BYTES} bytes; give -o response_size"
        )
