"""Text from traces made safe for a terminal, a page or a file: a label, a device or a topic may contain anything."""

from __future__ import annotations

import unicodedata

MAX_SHOWN_CHARACTERS = 300
"""Longest text that is shown whole; JSON keeps texts whole."""

MAX_FINDING_CHARACTERS = 3000
"""Longest text of a finding or of a comparison's line, which may name several results."""

# Cc control, Cf format (bidi overrides, zero width), Zl and Zp line separators, Cs lone surrogates, Co private use.
_HIDDEN_CATEGORIES = frozenset({"Cc", "Cf", "Zl", "Zp", "Cs", "Co"})


def printable(text: object, most: int = MAX_SHOWN_CHARACTERS) -> str:
    r"""Return the text on one line, cut to `most` characters, with control and invisible characters spelled out: `\x1b`, `\u2028`."""
    shown = str(text)
    if len(shown) > most:
        shown = shown[: most - 1] + "…"
    if shown.isprintable():  # the common case
        return shown
    return "".join(_spelled(c) if is_hidden(c) else c for c in shown)


def is_hidden(character: str) -> bool:
    # XML 1.0 forbids U+FFFE and U+FFFF.
    return unicodedata.category(character) in _HIDDEN_CATEGORIES or ord(character) & 0xFFFE == 0xFFFE


def _spelled(character: str) -> str:
    code = ord(character)
    if code <= 0xFF:
        return f"\\x{code:02x}"
    return f"\\u{code:04x}" if code <= 0xFFFF else f"\\U{code:08x}"
