"""Where strings from traces are made harmless for a medium, and the numbers that have no unit of their own.

Whatever the medium, `visible` comes first. Then HTML is escaped by jinja2's autoescape, its JSON island by
`json_island`, Markdown by `markdown`; the page writes its CSV files itself (`assets/export.js`).
"""

from __future__ import annotations

import json
import math
from dataclasses import fields
from typing import Any

from dds_trace.tracefile.units.durations import format_duration
from dds_trace.tracefile.units.quantities import MISSING
from dds_trace.tracefile.visible import MAX_FINDING_CHARACTERS, visible

_MARKDOWN_PLAIN = frozenset(" ,()%+-=/'.;:?!\"")


def markdown(text: object) -> str:
    """The text as literal words for GitHub's Markdown, also inside a table cell.

    Punctuation becomes entities, which Markdown never reads as syntax. `@` and `#` get an empty comment behind them,
    because mentions and issue references are looked for after entities are resolved.
    """
    parts = []
    for c in visible(text, MAX_FINDING_CHARACTERS):
        if c.isalnum() or c in _MARKDOWN_PLAIN:
            parts.append(c)
        elif c in "@#":
            parts.append(f"{c}<!-- -->")
        else:
            parts.append(f"&#{ord(c)};")
    # Bare addresses become links of their own accord; an entity in them keeps them text.
    return "".join(parts).replace("://", "&#58;//").replace("www.", "www&#46;")


def json_island(value: Any) -> str:
    """JSON that cannot end the `<script>` element it stands in; dataclasses as objects, sorted keys, no NaN."""
    text = json.dumps(
        value, separators=(",", ":"), sort_keys=True, ensure_ascii=False, allow_nan=False, default=_fields
    )
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    # A lone surrogate (undecodable file name) cannot be written as UTF-8.
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def _fields(record: Any) -> dict[str, Any]:
    # Not `asdict`: that copies every number of a campaign one by one.
    return {each.name: getattr(record, each.name) for each in fields(record)}


def format_added_ns(value_ns: float) -> str:
    """A difference of durations with its sign: `+1.25 ms`."""
    return f"+{format_duration(value_ns)}" if value_ns > 0 else format_duration(value_ns)


def format_ratio(value: float | None) -> str:
    """A share in percent that says 100 % (or 0 %) only where it is exactly that: `99.99 %`."""
    if value is None or not math.isfinite(value):
        return MISSING
    percent = 100.0 * value
    if 0.0 < percent < 0.01:
        return "< 0.01 %"
    if 99.99 < percent < 100.0:
        return "> 99.99 %"
    return f"{percent:.2f}".rstrip("0").rstrip(".") + " %"


def format_count(value: float | None) -> str:
    """A whole number with thin groups: `12,000`."""
    return MISSING if value is None else f"{int(value):,}"
