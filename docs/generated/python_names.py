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
