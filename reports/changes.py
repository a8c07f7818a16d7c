"""The row of a comparison in words, alike in every table: what it rests on, and what both sides received."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from dds_trace.analyzer.statistics.intervals import Basis
from dds_trace.base.units import counted

from .book.groups import format_ratio

if TYPE_CHECKING:
    from collections.abc import Mapping


def runs_words(row: Mapping[str, Any]) -> str:
    """Return on how many runs a row of a comparison rests, as in `5 and 5`, `5 pairs` or `1 and 1, within one run`."""
    if row["pairs"]:
        return f"{row['pairs']} pairs"
    said = f"{row['base_runs']} and {row['new_runs']}"
    return said if row["basis"] == Basis.BETWEEN_RUNS.value else f"{said}, {row['basis']}"


def received_words(row: Mapping[str, Any]) -> str:
    """Return the shares that both sides received, as in `100 % → 98.5 %`; one share where they are equal."""
    shares = [format_ratio(row[f"{side}_received_ratio"]) for side in ("base", "new")]
    return " → ".join(dict.fromkeys(shares))


def episodes_words(row: Mapping[str, Any], side: str) -> str:
    """Return the episodes that the tail of a side rests on, as in `12 episodes`; empty of a median or a mean.

    Args:
        row: a row of a comparison.
        side: `base` or `new`.
    """
    episodes = row[f"{side}_episodes"]
    is_tail = row["statistic"].startswith("p9") and row[f"{side}_ns"] is not None
    return counted(episodes, "episode") if is_tail and episodes is not None else ""
