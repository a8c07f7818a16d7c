"""Columns that a comparison leaves out of the match: which ones would help, and whether that is sound.

Two folders that were recorded for unlike bridges, middlewares or links have no group in common. Without these columns
their groups pair, and the comparison is one of bridges, middlewares or links. That holds only as long as no two groups
of one side become one: their runs would be pooled, and the answer would follow from how many of each there are.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import TYPE_CHECKING

from dds_trace.base.errors import OptionError

from ...model.names import group_words, value_word, varying_parameters
from ...model.parameters import CELL_COLUMNS, MATCH_COLUMNS
from ..matching import RELAY_COLUMNS

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    import polars as pl

    from ...model.parameters import ParameterValue
    from ..matching import Key

IGNORABLE_COLUMNS = tuple(name for name in MATCH_COLUMNS if name not in CELL_COLUMNS)
"""Columns that may be left out: times of unlike messages are never compared."""

_MOST_TRIED = 50
"""Sets of columns that are tried out, the smallest and most frequent first."""


def match_without(ignored: Iterable[str]) -> tuple[str, ...]:
    """Return the match columns without some.

    Args:
        ignored: those of `IGNORABLE_COLUMNS` to leave out.

    Raises:
        OptionError: one of them is no such column.
    """
    names = set(ignored)
    unknown = sorted(names - set(IGNORABLE_COLUMNS))
    if unknown:
        raise OptionError(f"{unknown[0]!r} cannot be ignored; choose from {', '.join(IGNORABLE_COLUMNS)}")
    return tuple(name for name in MATCH_COLUMNS if name not in names)


def check_match(groups: pl.DataFrame, side: str, match: Sequence[str]) -> None:
    """Refuse a match by which two groups of one side are one.

    A relay without a trace is no difference (`matching.match_groups`).

    Args:
        groups: a row per group of one side, with `MATCH_COLUMNS`.
        side: name of the side.
        match: names of the columns that are matched.

    Raises:
        OptionError: two groups of the side differ only in what is not matched.
    """
    left_out = [name for name in MATCH_COLUMNS if name not in match]
    if not left_out:
        return
    first: dict[Key, Key] = {}
    whole, of_match = (groups.select(names).rows() for names in (left_out, match))
    for ignored, key in zip(whole, of_match, strict=True):
        other = first.setdefault(key, ignored)
        unlike = [
            f"{name} ({one} and {two})"
            for name, one, two in zip(left_out, other, ignored, strict=True)
            if one != two and not (name in RELAY_COLUMNS and None in (one, two))
        ]
        if unlike:
            names = varying_parameters(groups.select(match), match)
            words = group_words(dict(zip(match, key, strict=True)), names)
            raise OptionError(
                f"the {side} has two groups that differ only in {', '.join(unlike)}: {words}; ignored, they would be "
                "pooled. Compare a folder with one of them, or match these columns"
            )


def ignored_sentences(base: pl.DataFrame, new: pl.DataFrame, match: Sequence[str]) -> tuple[str, ...]:
    """Return a sentence for each column that is not matched and in which the sides differ."""
    left_out = (name for name in MATCH_COLUMNS if name not in match)
    return tuple(
        f"{name} is {_either(_values(base, name))} in the base and {_either(_values(new, name))} in the new side"
        for name in left_out
        if _values(base, name) != _values(new, name)
    )


def unlike_columns(base: pl.DataFrame, new: pl.DataFrame) -> dict[str, tuple[str, str]]:
    """Return the columns in which no group of one side agrees with any of the other, with the values of both.

    Args:
        base: match columns of the groups that only the base has.
        new: those of the new side.
    """
    if base.is_empty() or new.is_empty():
        return {}
    sides = {name: (_values(base, name), _values(new, name)) for name in base.columns}
    return {name: (_either(b), _either(n)) for name, (b, n) in sides.items() if not set(b) & set(n)}


def columns_to_ignore(base: pl.DataFrame, new: pl.DataFrame) -> tuple[str, ...]:
    """Return the fewest columns without which groups of both sides pair and none of one side become one; empty if none do.

    Args:
        base: match columns of the groups that only the base has.
        new: those of the new side.
    """
    names, others = base.columns, new.rows()
    unlike: Counter[tuple[str, ...]] = Counter()
    for one in base.rows():
        unlike.update(
            tuple(name for name, a, b in zip(names, one, other, strict=True) if a != b) for other in others
        )
    candidates = sorted(unlike, key=lambda columns: (len(columns), -unlike[columns]))[:_MOST_TRIED]
    return next(
        (
            columns
            for columns in candidates
            if set(columns) <= set(IGNORABLE_COLUMNS)
            and _stay_apart(base, columns)
            and _stay_apart(new, columns)
        ),
        (),
    )


def _stay_apart(groups: pl.DataFrame, without: Sequence[str]) -> bool:
    left: dict[Key, set[tuple[ParameterValue, ...]]] = defaultdict(set)
    match = [name for name in groups.columns if name not in without]
    for key, ignored in zip(groups.select(match).rows(), groups.select(without).rows(), strict=True):
        left[key].add(ignored)
    return all(len(values) == 1 for values in left.values())


def _values(groups: pl.DataFrame, column: str) -> list[str]:
    return sorted({value_word(value) for value in groups[column].to_list()})


def _either(values: Sequence[str]) -> str:
    return " or ".join(values)
