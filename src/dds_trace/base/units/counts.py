"""Counts as people read them: `1 message`, `2 messages`, `1,000 replies`."""

from __future__ import annotations


def counted(count: float, one: str, many: str = "", *, text: str = "") -> str:
    """Return a count with its noun in the right number.

    Args:
        count: decides between the two wordings.
        one: the noun for a count of 1, with the words that follow it where they depend on the number.
        many: the same for any other count; `one` with an `s` if it is left out.
        text: the count as it is to be printed, for example with thousands separated; its digits if left out.
    """
    noun = one if count == 1 else many or f"{one}s"
    return f"{text or count} {noun}"
