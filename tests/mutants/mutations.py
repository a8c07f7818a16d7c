"""The mutants of a module: every place where one operator or number of its code can be another, as an edit of its syntax tree.

What is left out, each by a rule, because no test of behaviour could tell the two apart or should:

- texts: docstrings, messages and names are no operators, and numbers within a message only shape it;
- arguments of decorators: `frozen`, `slots` and the like change what a class costs or refuses, not what it computes;
- annotations, `contravariant=`, protocols and what stands under `if TYPE_CHECKING`: they are for the type checker;
- `assert`, and `strict=` of `zip`: they guard against our own mistakes and change nothing for a caller who makes none;
- `copy=`, `maxsize=`, `stacklevel=`, `daemon=` and `buffering=`: what they change is speed, or the line that a warning names;
- module constants whose names say that they bound work, not results (`_AT_ONCE`, `_BLOCK_MESSAGES` and the like,
  `WORK_BOUNDS`): tests of blocks give each of them other sizes and find the same results;
- numbers of requests to the kernel (`KERNEL_REQUESTS`).
"""

from __future__ import annotations

import ast
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

OPERATORS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.And: ast.Or,
    ast.Or: ast.And,
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,  # `/` would make a float of it, which most code refuses at once
    ast.Mod: ast.FloorDiv,
    ast.Pow: ast.Mult,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.BitXor: ast.BitAnd,
}
UNTOLD_KEYWORDS = frozenset(
    {"strict", "copy", "maxsize", "stacklevel", "daemon", "buffering", "contravariant", "covariant"}
)
KERNEL_REQUESTS = ("SIOC", "TUNSET")
"""Numbers of requests to the kernel; the next one may change the machine: 0x8914 sets the flags of an interface, so took it down."""
WORK_BOUNDS = ("AT_ONCE", "_BATCH", "CHUNK_ROWS", "CACHE", "BUFFER", "_BLOCK")
"""Ends and parts of the names of constants that say how much is done at a time; results do not depend on them."""


@dataclass(frozen=True)
class Mutant:
    """One edit of a syntax tree.

    Attributes:
        line: line of the edit.
        change: what becomes what, `a < b -> a <= b`.
        lines: lines of the statement around it, up to its body; a test that runs none of them cannot tell.
        runs_at_import: whether it stands outside of functions.
        put: function that makes the edit (True) in the tree or takes it back (False).
    """

    line: int
    change: str
    lines: range
    runs_at_import: bool
    put: Callable[[bool], None]


def mutants_of(tree: ast.Module) -> list[Mutant]:
    return sorted(_edits(tree, range(0), runs_at_import=True), key=lambda each: (each.line, each.change))


def _edits(node: ast.AST, lines: range, *, runs_at_import: bool) -> Iterator[Mutant]:
    for owner, name, child in _children(node):
        around = _statement_lines(child) if isinstance(child, ast.stmt) else lines
        outside = runs_at_import and not (isinstance(node, ast.FunctionDef | ast.Lambda) and name == "body")
        for at, change, put in _edits_of(owner, name, child):
            yield Mutant(at, change, around, outside, put)
        if not _is_left_out(child):
            yield from _edits(child, around, runs_at_import=outside)


def _statement_lines(node: ast.stmt) -> range:
    body = getattr(node, "body", None)
    end = node.end_lineno if not body else max(body[0].lineno - 1, node.lineno)
    return range(node.lineno, end + 1)


def _children(node: ast.AST) -> Iterator[tuple[object, object, ast.AST]]:
    """(list or node that holds it, index or field, child) of each part of a node that the rules above leave in."""
    for field, value in ast.iter_fields(node):
        if field in {"decorator_list", "annotation", "returns", "type_comment"}:
            continue
        if isinstance(value, ast.AST):
            yield node, field, value
        elif isinstance(value, list):
            for index, child in enumerate(value):
                if isinstance(child, ast.AST):
                    yield value, "body" if isinstance(child, ast.stmt) else index, child


def _is_left_out(node: ast.AST) -> bool:
    if isinstance(node, ast.JoinedStr | ast.Raise | ast.Assert | ast.Import | ast.ImportFrom):
        return True
    if isinstance(node, ast.ClassDef):
        return any("Protocol" in ast.unparse(base) for base in node.bases)
    if isinstance(node, ast.keyword):
        return node.arg in UNTOLD_KEYWORDS
    if isinstance(node, ast.If):
        return isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
    if isinstance(node, ast.Assign | ast.AnnAssign):
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        return any(isinstance(each, ast.Name) and _is_left_as_it_is(each.id) for each in targets)
    return False


def _is_left_as_it_is(name: str) -> bool:
    return name.isupper() and any(part in name for part in (*WORK_BOUNDS, *KERNEL_REQUESTS))


def _edits_of(owner: object, name: object, node: ast.AST) -> Iterator[tuple[int, str, Callable[[bool], None]]]:
    if isinstance(node, ast.Compare):
        for at, operator in enumerate(node.ops):
            yield _swap(node, node.ops, at, OPERATORS[type(operator)]())
    elif isinstance(node, ast.BoolOp) or (isinstance(node, ast.BinOp | ast.AugAssign) and not _joins_texts(node)):
        if type(node.op) in OPERATORS:
            yield _swap(node, node, "op", OPERATORS[type(node.op)]())
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        yield _swap(node, owner, name, node.operand)
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool | int | float):
        yield _swap(node, node, "value", not node.value if isinstance(node.value, bool) else node.value + 1)


def _joins_texts(node: ast.BinOp | ast.AugAssign) -> bool:
    sides = (node.left, node.right) if isinstance(node, ast.BinOp) else (node.value,)
    return any(isinstance(side, ast.JoinedStr) or _is_text(side) for side in sides)


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str | bytes)


def _swap(node: ast.AST, owner: object, name: object, new: object) -> tuple[int, str, Callable[[bool], None]]:
    old = owner[name] if isinstance(owner, list) else getattr(owner, name)

    def put(edited: bool) -> None:
        value = new if edited else old
        if isinstance(owner, list):
            owner[name] = value
        else:
            setattr(owner, name, value)

    before = ast.unparse(node)
    put(edited=True)
    after = ast.unparse(new if old is node else node)
    put(edited=False)
    return node.lineno, f"{before} -> {after}", put
