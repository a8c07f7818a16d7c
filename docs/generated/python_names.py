"""What `from dds_trace import ...` offers: a section for each group of the package's own list of names."""

from __future__ import annotations

import inspect
import re

import dds_trace

_GROUP = re.compile(r"^(?P<title>\w[\w ]*):\n\n(?P<names>(?:- .*\n)+)", re.MULTILINE)


def python_names() -> str:
    """Return reStructuredText, the language of Sphinx's autodoc, in a directive of MyST."""
    groups = _GROUP.finditer(inspect.getdoc(dds_trace) + "\n")
    return "\n".join(
        _section(group["title"], re.findall(r"^- `(\w+)`", group["names"], re.MULTILINE)) for group in groups
    )


def _section(title: str, names: list[str]) -> str:
    return "\n".join([f"## {title}\n", "```{eval-rst}", *(_directive(name) for name in names), "```\n"])


def _directive(name: str) -> str:
    """Return the directive that documents a name; an error's own text is all there is to it."""
    thing = getattr(dds_trace, name)
    if not inspect.isclass(thing):
        return f".. autofunction:: dds_trace.{name}\n"
    shown = "" if issubclass(thing, Exception) else "   :members:\n"
    return f".. autoclass:: dds_trace.{name}\n{shown}"


def mark_code(_app: object, _what: str, _name: str, _thing: object, _options: object, lines: list[str]) -> None:
    """Make an indented paragraph of a docstring, as ours show code, a block of code for Sphinx; called for each docstring."""
    for number in range(len(lines) - 1, 0, -1):
        begins = lines[number].startswith("    ") and not lines[number - 1].strip()
        above = next((line for line in reversed(lines[:number]) if line.strip()), "")
        if begins and not above.startswith(" ") and not above.endswith(":"):
            lines[number:number] = [".. code-block:: python", ""]
