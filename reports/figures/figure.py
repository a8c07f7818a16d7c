"""What a figure hands to the page: the plan of its plot, with groups in place of values.

The page looks the values up (metric, statistic, filters are the reader's choice) and draws with plotly.js, so one
plan serves every view and the numbers are in the page once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure that can be drawn.

    Attributes:
        name: the id in the page and in file names of downloads.
        how_to_read: one sentence.
        kind: which function of `assets/kinds.js` draws it.
        plan: what that function needs, as `json_island` writes it.
    """

    name: str
    title: str
    how_to_read: str
    kind: str
    plan: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A figure whose data are not there, and the sentence that says why."""

    name: str
    title: str
    reason: str
