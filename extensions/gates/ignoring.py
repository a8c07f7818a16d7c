"""Columns that a comparison does not match, as long as no two groups of one side merge without them."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence

import polars as pl

from dds_trace.analyzer.model.names import group_words, value_word, varying_parameters
from dds_trace.analyzer.model.parameters import CELL_COLUMNS, MATCH_COLUMNS, ParameterValue
from dds_trace.base.errors import OptionError

from .matching import RELAY_COLUMNS, Key

IGNORABLE_COLUMNS = tuple(name for name in MATCH_COLUMNS if name not in CELL_COLUMNS)
"""Columns that may be ignored; times of different messages are never compared."""

_MOST_TRIED = 50
"""Sets of columns that are tried, the smallest and most frequent first."""


def match_without(ignored: Iterable[str]) -> tuple[str, ...]:
    """Return the match columns without some; an `OptionError` for one that is not of `IGNORABLE_COLUMNS`."""
    names = set(ignored)
    unknown = sorted(names - set(IGNORABLE_COLUMNS))
    if unknown:
        raise OptionError(f"{unknown[0]!r} cannot be ignored; choose from {', '.join(IGNORABLE_COLUMNS)}")
    return tuple(name for name in MATCH_COLUMNS if name not in names)


def check_match(groups: pl.DataFrame, side: str, match: Sequence[str]) -> None:
    """Raise an `OptionError` for a match by which two groups of one side are one."""
    left_out = [name for name in MATCH_COLUMNS if name not in match]
    if not left_out:
        return
    first: dict[Key, Key] = {}
    for ignored, key in zip(groups.select(left_out).rows(), groups.select(match).rows(), strict=True):
        other = first.setdefault(key, ignored)
        differences = [
            f"{name} ({one} and {two})"
            for name, one, two in zip(left_out, other, ignored, strict=True)
            if one != two and not (name in RELAY_COLUMNS and None in (one, two))
        ]
        if differences:
            names = varying_parameters(groups.select(match), match)
            words = group_words(dict(zip(match, key, strict=True)), names)
            raise OptionError(
                f"the {side} has two results that differ only in {', '.join(differences)}: {words}; without it they would "
                "be pooled. Compare a folder with one of them, or match these columns"
            )


def ignored_sentences(base: pl.DataFrame, new: pl.DataFrame, match: Sequence[str]) -> tuple[str, ...]:
    sides = ((name, _values(base, name), _values(new, name)) for name in MATCH_COLUMNS if name not in match)
    return tuple(
        f"{name} is {' or '.join(before)} in the base and {' or '.join(after)} in the new side"
        for name, before, after in sides
        if before != after
    )


def unlike_columns(base: pl.DataFrame, new: pl.DataFrame) -> dict[str, tuple[str, str]]:
    if base.is_empty() or new.is_empty():
        return {}
    sides = {name: (_values(base, name), _values(new, name)) for name in base.columns}
    return {name: (" or ".join(b), " or ".join(n)) for name, (b, n) in sides.items() if not set(b) & set(n)}


def columns_to_ignore(base: pl.DataFrame, new: pl.DataFrame) -> tuple[str, ...]:
    """Return the fewest columns without which unmatched groups pair and none of one side merge; empty if none do."""
    names, others = base.columns, new.rows()
    differing: Counter[tuple[str, ...]] = Counter()
    for row in base.rows():
        differing.update(
            tuple(name for name, a, b in zip(names, row, other, strict=True) if a != b) for other in others
        )
    candidates = sorted(differing, key=lambda columns: (len(columns), -differing[columns]))[:_MOST_TRIED]
    allowed = (columns for columns in candidates if set(columns) <= set(IGNORABLE_COLUMNS))
    return next((columns for columns in allowed if _stay_apart(base, columns) and _stay_apart(new, columns)), ())


def _stay_apart(groups: pl.DataFrame, without: Sequence[str]) -> bool:
    ignored: dict[Key, set[tuple[ParameterValue, ...]]] = defaultdict(set)
    match = [name for name in groups.columns if name not in without]
    for key, values in zip(groups.select(match).rows(), groups.select(without).rows(), strict=True):
        ignored[key].add(values)
    return all(len(values) == 1 for values in ignored.values())


def _values(groups: pl.DataFrame, column: str) -> list[str]:
    return sorted({value_word(value) for value in groups[column].to_list()})
