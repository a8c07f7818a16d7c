"""What pages of the reference take out of the code: the directive `generated`, which names one of `PARTS`.

    ```{generated} findings
    ```

A part is a function without arguments that returns Markdown; it is read in the place of the directive.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

from sphinx.util.docutils import SphinxDirective

from . import commands, findings, gallery, plan_keys, python_names, tables

if TYPE_CHECKING:
    from collections.abc import Callable

    from docutils import nodes
    from sphinx.application import Sphinx

PARTS: dict[str, Callable[[], str]] = {
    "bare-analyzer": tables.bare_analyzer,
    "commands": commands.commands,
    "findings": findings.findings,
    "gallery": gallery.gallery,
    "plan-keys": plan_keys.plan_keys,
    "python": python_names.python_names,
}
"""The table of parts: one row each."""


class Generated(SphinxDirective):
    """The directive: Markdown of a part, in its place."""

    required_arguments = 1
    option_spec: ClassVar[dict[str, Any]] = {}

    def run(self) -> list[nodes.Node]:
        """Return what the part says, read as Markdown."""
        if self.arguments[0] not in PARTS:
            raise self.error(f"no part {self.arguments[0]!r}; there are {', '.join(PARTS)}")
        return self.parse_text_to_nodes(PARTS[self.arguments[0]](), allow_section_headings=True)


def setup(app: Sphinx) -> dict[str, bool]:
    """Make the directive known to Sphinx."""
    app.add_directive("generated", Generated)
    app.connect("autodoc-process-docstring", python_names.mark_code, priority=400)  # before napoleon reads it
    # Code is read anew at each build: Sphinx would keep a page whose own text did not change.
    return {"parallel_read_safe": True}
