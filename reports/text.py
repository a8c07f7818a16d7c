"""Escaping of strings from traces for each format, and numbers without a unit.

`visible` comes first for every format. Then jinja2's autoescape escapes HTML, `json_island` the JSON inside the page,
and `markdown` Markdown; the page writes its CSV files itself (`assets/output/export.js`).
"""

from __future__ import annotations

import json
import math
from dataclasses import fields
from typing import TYPE_CHECKING

from dds_trace.tracefile.units.durations import format_duration
from dds_trace.tracefile.units.quantities import MISSING
from dds_trace.tracefile.visible import MAX_FINDING_CHARACTERS, visible

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_MARKDOWN_PLAIN = frozenset(" ,()%+-=/'.;:?!\"")


def markdown(text: object) -> str:
    """Escape text for GitHub's Markdown, also inside a table cell.

    Punctuation becomes entities, which Markdown never interprets as syntax. An empty comment follows `@` and `#`,
    because GitHub resolves entities before it looks for mentions and issue references.
    """
    parts = []
    for c in visible(text, MAX_FINDING_CHARACTERS):
        if c.isalnum() or c in _MARKDOWN_PLAIN:
            parts.append(c)
        elif c in "@#":
            parts.append(f"{c}<!-- -->")
        else:
            parts.append(f"&#{ord(c)};")
    # GitHub turns bare addresses into links; an entity inside keeps them text.
    return "".join(parts).replace("://", "&#58;//").replace("www.", "www&#46;")


def json_island(value: object) -> str:
    """Encode JSON that cannot end its `<script>` element: dataclasses as objects, sorted keys, no NaN."""
    text = json.dumps(
        value, separators=(",", ":"), sort_keys=True, ensure_ascii=False, allow_nan=False, default=_fields
    )
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    # A lone surrogate (undecodable file name) cannot be written as UTF-8.
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def _fields(record: DataclassInstance) -> dict[str, object]:
    # Not `asdict`: that copies every number of a campaign one by one.
    return {each.name: getattr(record, each.name) for each in fields(record)}


def format_added_ns(value_ns: float) -> str:
    """Format a difference of durations with its sign: `+1.25 ms`."""
    return f"+{format_duration(value_ns)}" if value_ns > 0 else format_duration(value_ns)


def format_ratio(value: float | None) -> str:
    """Format a share in percent; `100 %` and `0 %` stand for exactly these values: `99.99 %`."""
    if value is None or not math.isfinite(value):
        return MISSING
    percent = 100.0 * value
    if 0.0 < percent < 0.01:
        return "< 0.01 %"
    if 99.99 < percent < 100.0:
        return "> 99.99 %"
    return f"{percent:.2f}".rstrip("0").rstrip(".") + " %"


def format_count(value: float | None) -> str:
    """Format a whole number with separated thousands: `12,000`."""
    return MISSING if value is None else f"{int(value):,}"
