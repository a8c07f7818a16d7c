"""Distinct short names of groups, setups and lines: a base, and words that rules choose."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from hashlib import blake2b
from typing import TypeVar

import polars as pl

from dds_trace.base.printable import printable

from .parameters import CELL_COLUMNS, SERIES_COLUMNS, ParameterValue

Item = TypeVar("Item")

Rule = Callable[[Sequence[str], Sequence[str]], "Iterable[int]"]
"""Names so far and words -> indices of the names that get their word."""


def where_it_varies(names: Sequence[str], words: Sequence[str]) -> Iterable[int]:
    return range(len(names)) if len(set(words)) > 1 else ()


def where_it_helps(names: Sequence[str], words: Sequence[str]) -> Iterable[int]:
    return range(len(names)) if len(set(zip(names, words, strict=True))) > len(set(names)) else ()


def where_alike(names: Sequence[str], words: Sequence[str]) -> Iterable[int]:
    words_by_name: dict[str, set[str]] = defaultdict(set)
    for name, word in zip(names, words, strict=True):
        words_by_name[name].add(word)
    return [index for index, name in enumerate(names) if len(words_by_name[name]) > 1]


def tell_apart(
    items: Sequence[Item], base: Callable[[Item], str], parts: Iterable[tuple[Rule, Callable[[Item], str]]]
) -> list[str]:
    """Name items by a base and the words that rules choose; an empty word adds nothing."""
    names = [base(item) for item in items]
    for rule, word in parts:
        words = [word(item) for item in items]
        for index in rule(tuple(names), words):
            names[index] += f", {words[index]}" if words[index] else ""
    return names


def distinct(names: Sequence[str], keys: Sequence[str]) -> list[str]:
    """Return identifiers as distinct as the keys that they are made of: where two keys share a name, each ends in its hash."""
    keys_by_name: dict[str, set[str]] = defaultdict(set)
    for name, key in zip(names, keys, strict=True):
        keys_by_name[name].add(key)
    return [
        name if len(keys_by_name[name]) == 1 else f"{name}_{blake2b(key.encode(), digest_size=4).hexdigest()}"
        for name, key in zip(names, keys, strict=True)
    ]


_FIRST = ("vendor", "bridge")

_PLAIN = frozenset({"vendor", "backend", "reliability", "durability", "connectivity"})


def name_groups(parameters: pl.DataFrame) -> list[str]:
    """Name each group, as in `binary 33000 B at 10 Hz, fastdds`, by the settings that differ and follow from no others."""
    groups = parameters.to_dicts()
    others = dict.fromkeys(("domain_mode", *SERIES_COLUMNS))
    parts = [
        *((where_it_varies, partial(_word, name)) for name in _FIRST),
        *((where_it_helps, partial(_word, name)) for name in others if name not in _FIRST),
    ]
    # Groups of different size or rate get their settings, too.
    settings = tell_apart(groups, lambda _: "", parts)
    return [f"{_sent(group)}{setting}" for group, setting in zip(groups, settings, strict=True)]


def _sent(group: Mapping[str, ParameterValue]) -> str:
    data_type, payload_bytes, rate_hz = (group[name] for name in CELL_COLUMNS)
    return f"{data_type} {payload_bytes} B at {f'{rate_hz:g} Hz' if rate_hz else 'max'}"


def _word(name: str, group: Mapping[str, ParameterValue]) -> str:
    value = group[name]
    if name == "domain_mode":
        return f"{value} domain"
    if name == "bridge" and value == "none":
        return "no bridge"
    if name == "setting":
        return str(value) or "nothing else set"
    return str(value) if name in _PLAIN else f"{name} {value}"


def is_topic(data_type: object) -> bool:
    return isinstance(data_type, str) and data_type.startswith("/")


def varying_parameters(groups: pl.DataFrame, columns: Iterable[str]) -> list[str]:
    always = {*_FIRST, *CELL_COLUMNS}
    return [name for name in columns if name in always or groups[name].n_unique() > 1]


def group_words(group: Mapping[str, ParameterValue], columns: Iterable[str]) -> str:
    """Write `vendor=fastdds payload_bytes=33000 ...`; a topic has no size and rate."""
    left_out = CELL_COLUMNS[1:] if is_topic(group.get(CELL_COLUMNS[0])) else ()
    values = ((name, group[name]) for name in columns if name not in left_out)
    return " ".join(f"{n}={v:g}" if isinstance(v, float) else f"{n}={v}" for n, v in values)


def device_pair(ping_device: str, relay_device: str | None) -> str:
    devices = [printable(device) for device in (ping_device, relay_device) if device is not None]
    return " → ".join(dict.fromkeys(devices))


def value_word(value: object) -> str:
    if value is None:
        return "unknown"
    return f"{value:g}" if isinstance(value, float) else str(value) or "nothing"
