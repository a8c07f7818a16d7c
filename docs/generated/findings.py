"""Every finding with its cause and cure, read from the checks themselves.

A check is a function of `analyzer/findings/`; its docstring says what it reports, and each `Finding` that it makes has a
severity, a code, what it says and what to do. Where a figure or a name is put in, `…` stands.
"""

from __future__ import annotations

import ast
import inspect
import re
import sys
from collections import defaultdict
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from dds_trace.analyzer.findings.table import CHECKS
from dds_trace.analyzer.model.finding import Finding, Severity

from .markdown import escaped

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

GAP = "…"


@dataclass(frozen=True)
class Told:
    """One place of the code that makes a finding: how grave it is, when it is made, what it says, what to do."""

    code: str
    severity: str
    when: str
    what: str
    action: str


def findings() -> str:
    """Return a section for each code, the gravest first."""
    of_code: dict[str, list[Told]] = defaultdict(list)
    for told in all_told():
        of_code[told.code].append(told)
    order = [severity.value for severity in Severity]
    gravest = {code: min(order.index(told.severity) for told in of) for code, of in of_code.items()}
    return "\n".join(
        part
        for code in sorted(of_code, key=lambda code: (gravest[code], code))
        for part in _section(code, of_code[code])
    )


def all_told() -> Iterator[Told]:
    """Yield every place that makes a finding, in the order of the checks."""
    modules = dict.fromkeys(sys.modules[check.__module__] for check in CHECKS)
    for module in modules:
        tree = ast.parse(inspect.getsource(module))
        for function in (node for node in tree.body if isinstance(node, ast.FunctionDef)):
            when = (ast.get_docstring(function) or "").partition("\n\n")[0].removeprefix("Report ")
            for call in ast.walk(function):
                if isinstance(call, ast.Call) and getattr(call.func, "id", "") == Finding.__name__:
                    yield from _told(call, " ".join(when.split()), vars(module))


def _told(call: ast.Call, when: str, names: dict[str, Any]) -> Iterator[Told]:
    severity, code, _, what, action = call.args[:5]
    if isinstance(code, ast.Attribute):  # _TABLE[reason].code: a table of the module has a row for each code
        rows = names[next(node.id for node in ast.walk(code) if isinstance(node, ast.Name))]
        for row in rows.values():
            yield Told(row.code, row.severity.value, when, f"{row.what} {GAP}", row.action)
        return
    for first in (True, False) if isinstance(code, ast.IfExp) else (True,):
        texts = [_text(node, names, first=first) for node in (severity, code, what, action)]
        yield Told(texts[1], texts[0], when, *texts[2:])


def _text(node: ast.expr, names: dict[str, Any], *, first: bool) -> str:  # noqa: PLR0911 - a line for each kind of expression
    """Return the text that an expression makes, with a gap for all that only a measurement tells.

    Args:
        node: the expression.
        names: what the module defines.
        first: whether the first text is taken where the code chooses between two.
    """
    text = partial(_text, names=names, first=first)
    match node:
        case ast.Attribute(value=ast.Name(id="Severity"), attr=name):
            return Severity[name].value
        case ast.Constant(value=str(words)):
            return words
        case ast.JoinedStr(values=parts):
            return "".join(
                text(part.value if isinstance(part, ast.FormattedValue) else part) for part in parts
            )
        case ast.BinOp(left=left, right=right):
            return text(left) + text(right)
        case ast.IfExp(body=one, orelse=other):
            return text(one if first else other)
        case ast.Call(func=ast.Name(id="counted"), args=[_, *words]):
            return f"{GAP} {text(words[-1])}{'s' if len(words) == 1 else ''}"
        case ast.Name(id=name) if isinstance(names.get(name), str):
            return str(names[name])
        case _:
            return GAP


def _section(code: str, told: Iterable[Told]) -> Iterator[str]:
    said = list(dict.fromkeys(told))
    yield f"### {code}\n"
    for when in dict.fromkeys((each.severity, each.when) for each in said):
        yield f"*{when[0].capitalize()}.* {escaped(when[1][0].upper() + when[1][1:])}\n"
    for each in said:
        yield f"- **Says:** {_one_gap(each.what)}\n  **Do:** {_one_gap(each.action)}"
    yield ""


def _one_gap(text: str) -> str:
    """Return a text as Markdown; neighbouring gaps are one."""
    return escaped(re.sub(f"{GAP}[ {GAP}]*{GAP}", GAP, text))
