"""Contents pages that import a room's modules at the first use of a name, not when the room is imported (PEP 562).

A command's `--help` then loads one small module and not numpy. The page keeps one list of its imports, below
`if TYPE_CHECKING:`, where type checkers and readers expect it; the same list is read here, as SPEC 1 of the
Scientific Python project does with stub files.
"""

from __future__ import annotations

import ast
import sys
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping


def contents_page(page: str) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` of a contents page.

    Args:
        page: `__name__` of the page, a package whose imports stand below `if TYPE_CHECKING:`.
    """

    def load(name: str) -> object:
        module = sys.modules[page]
        homes = _homes(str(module.__file__))
        if name not in homes:
            raise AttributeError(f"module {page!r} has no attribute {name!r}")
        value = getattr(import_module(homes[name], page), name)
        setattr(module, name, value)  # so that the next use costs nothing
        return value

    def names() -> list[str]:
        module = sys.modules[page]
        return sorted({*vars(module), *_homes(str(module.__file__))})

    return load, names


@cache
def _homes(path: str) -> Mapping[str, str]:
    """Return each name that the page at `path` imports below `if TYPE_CHECKING:`, and its module, relative to the page."""
    tree = ast.parse(Path(path).read_text(encoding="utf-8"))
    guarded = [
        line
        for block in tree.body
        if isinstance(block, ast.If) and ast.unparse(block.test) == "TYPE_CHECKING"
        for line in block.body
    ]
    return {
        alias.name: "." * line.level + (line.module or "")
        for line in guarded
        if isinstance(line, ast.ImportFrom)
        for alias in line.names
    }
