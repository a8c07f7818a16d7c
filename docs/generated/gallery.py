"""The figures of the report side by side: picture, title and question, as `reading-the-report.md` has them."""

from __future__ import annotations

import re
from pathlib import Path

_READING = Path(__file__).parents[1] / "reading-the-report.md"
_SECTION = re.compile(
    r"^### (?P<title>[^\n]+) \(`(?P<name>\w+)`\)\n!\[[^\n]*\]\((?P<picture>\S+)\)\n\n- \*\*Answers:\*\* (?P<question>.+?)\n- ",
    re.MULTILINE | re.DOTALL,
)


def gallery() -> str:
    """Return a grid of pictures, each a link to the section that explains it."""
    items = "\n".join(
        _item(**section.groupdict()) for section in _SECTION.finditer(_READING.read_text(encoding="utf-8"))
    )
    return f"````{{container}} gallery\n{items}\n````\n"


def _item(title: str, name: str, picture: str, question: str) -> str:
    heading = f"{title} ({name})"
    anchor = re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
    link = f"[![{title}]({picture})](reading-the-report.md#{anchor})"
    return f"```{{container}} picture\n{link}\n\n**{title}.** {' '.join(question.split())}\n```"
