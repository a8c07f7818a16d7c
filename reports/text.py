"""One place where numbers get their unit and where strings from traces are made harmless for a medium.

Whatever the medium, `visible` comes first. Then HTML is escaped by jinja2's autoescape, its JSON island by
`json_island`, Markdown by `markdown`; the page writes its CSV files itself (`assets/export.js`).
"""

from __future__ import annotations

import json
import math
import unicodedata
from dataclasses import fields
from typing import Any

MAX_SHOWN_CHARACTERS = 300
"""A label of a million characters would bury the page; the JSON report keeps it whole."""

MAX_FINDING_CHARACTERS = 3000
"""A finding may name several groups in full."""

MISSING = "-"
"""What stands where there is no number. Never 0."""

_TIME_UNITS = ((1e9, "s"), (1e6, "ms"), (1e3, "µs"), (1.0, "ns"))
_BYTE_UNITS = ((1e9, "GB"), (1e6, "MB"), (1e3, "KB"), (1.0, "B"))
_BINARY_UNITS = ((1 << 30, "GiB"), (1 << 20, "MiB"), (1 << 10, "KiB"))

# Cc control, Cf format (bidi overrides, zero width), Zl and Zp line separators, Cs lone surrogates, Co private use.
_HIDDEN_CATEGORIES = frozenset({"Cc", "Cf", "Zl", "Zp", "Cs", "Co"})
_MARKDOWN_PLAIN = frozenset(" ,()%+-=/'.;:?!\"")


def visible(text: object, most: int = MAX_SHOWN_CHARACTERS) -> str:
    r"""The text with every control or invisible character spelled out (`\x1b`, `\u2028`), cut to `most` characters."""
    shown = str(text)
    if len(shown) > most:
        shown = shown[: most - 1] + "…"
    return "".join(_spelled(c) if unicodedata.category(c) in _HIDDEN_CATEGORIES else c for c in shown)


def _spelled(character: str) -> str:
    code = ord(character)
    if code <= 0xFF:
        return f"\\x{code:02x}"
    return f"\\u{code:04x}" if code <= 0xFFFF else f"\\U{code:08x}"


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


def format_ns(value_ns: float | None) -> str:
    """A duration in the unit that leaves one to three digits before the point: `812 ns`, `1.25 ms`."""
    return _in_units(value_ns, _TIME_UNITS)


def format_added_ns(value_ns: float) -> str:
    """A difference of durations with its sign: `+1.25 ms`."""
    return f"+{format_ns(value_ns)}" if value_ns > 0 else format_ns(value_ns)


def format_size(payload_bytes: int) -> str:
    """A message size, exactly, as the command line takes it: `33 KB`, `1.5 MB`, `1 KiB`, `1405 B`."""
    for factor, unit in _BYTE_UNITS:
        if payload_bytes >= factor > 1 and payload_bytes % (factor / 10) == 0:
            return f"{_digits(payload_bytes / factor)} {unit}"
    for step, unit in _BINARY_UNITS:
        if payload_bytes >= step and payload_bytes % step == 0:
            return f"{payload_bytes // step} {unit}"
    return f"{payload_bytes} B"


def format_bytes(value_bytes: float | None) -> str:
    """An amount of data, to three digits: `1.65 MB`."""
    return _in_units(value_bytes, _BYTE_UNITS)


def format_bytes_per_s(value: float | None) -> str:
    """A transfer rate: `1.65 MB/s`."""
    shown = format_bytes(value)
    return shown if shown == MISSING else f"{shown}/s"


def format_hz(value_hz: float | None) -> str:
    """A rate: `10 Hz`."""
    return MISSING if _absent(value_hz) else f"{_digits(value_hz)} Hz"


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


def _absent(value: float | None) -> bool:
    return value is None or not math.isfinite(value)


def _in_units(value: float | None, units: tuple[tuple[float, str], ...]) -> str:
    if value is None or not math.isfinite(value):
        return MISSING
    for factor, unit in units:
        # 999.96 would be shown as 1000: let the larger unit take it.
        if abs(value) >= 0.9995 * factor:
            return f"{_digits(value / factor)} {unit}"
    return f"{_digits(value / units[-1][0])} {units[-1][1]}"


def _digits(value: float | None) -> str:
    """Three significant digits, no exponent, no trailing zeros after the point; whole numbers whole."""
    if value is None or value == 0:
        return "0"
    decimals = max(0, 2 - math.floor(math.log10(abs(value)) + 1e-12))
    shown = f"{value:.{min(decimals, 9)}f}"
    return shown.rstrip("0").rstrip(".") if "." in shown else shown
