"""Texts from traces made harmless: whatever shows one, on a terminal, a page or in a file, shows `printable(text)`.

A label, a device or a topic may hold anything: a sequence that steers the terminal, a change of the direction of
reading, a lone surrogate that cannot be encoded.
"""

from __future__ import annotations

import unicodedata

MAX_SHOWN_CHARACTERS = 300
"""Longest text that is shown whole; a label of a million characters would bury the page. JSON keeps texts whole."""

MAX_FINDING_CHARACTERS = 3000
"""Longest text of a finding or a line of a comparison, which may name several groups in full."""

# Cc control, Cf format (bidi overrides, zero width), Zl and Zp line separators, Cs lone surrogates, Co private use.
_HIDDEN_CATEGORIES = frozenset({"Cc", "Cf", "Zl", "Zp", "Cs", "Co"})


def printable(text: object, most: int = MAX_SHOWN_CHARACTERS) -> str:
    r"""Return the text on one line, with every control or invisible character spelled out: `\x1b`, `\u2028`.

    Args:
        text: anything that has a text.
        most: the number of characters beyond which it is cut.
    """
    shown = str(text)
    if len(shown) > most:
        shown = shown[: most - 1] + "…"
    if shown.isprintable():  # what nearly every text is: no character of a hidden category is printable
        return shown
    return "".join(_spelled(c) if _is_hidden(c) else c for c in shown)


def _is_hidden(character: str) -> bool:
    # The last two code points of a plane are no characters, and XML 1.0 forbids U+FFFE and U+FFFF.
    return unicodedata.category(character) in _HIDDEN_CATEGORIES or ord(character) & 0xFFFE == 0xFFFE


def _spelled(character: str) -> str:
    code = ord(character)
    if code <= 0xFF:
        return f"\\x{code:02x}"
    return f"\\u{code:04x}" if code <= 0xFFFF else f"\\U{code:08x}"
