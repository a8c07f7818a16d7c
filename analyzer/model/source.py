"""A source: one file or folder that an analysis looked at, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Source:
    """One file or folder that was looked at.

    Attributes:
        status: `read`, `truncated` (used up to where it ends), `duplicate` (same content as another, not
            counted again) or `skipped` (no trace).
        detail: why it was skipped or cut; empty when read whole.
        events: events used from it.
    """

    path: str
    status: str
    detail: str
    events: int
