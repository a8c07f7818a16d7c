"""Size and language of the product: lines, modules, words of prose, names, each with its bar; `just check` runs it.

python scripts/house.py          # the figures, room by room; exit 1 where a bar is missed
python scripts/house.py --list   # with the place of each word and name to replace
"""

from __future__ import annotations

import ast
import io
import re
import sys
import tokenize
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
ROOMS = ("src", "tracefile", "recorder", "analyzer", "reports", "cli")

WORDS = re.compile(
    r"\b(anew|begun|behind|beside|lies|mends?|mended|of which|seldom|stands|tell|tells|that of|those of|told|unto"
    r"|whoever|worked at|alone)\b(?!:)",  # before a colon it is the name of a field
    re.IGNORECASE,
)
"""Words of prose for which the trade has a plainer one (behind -> after, told -> reported, alone -> only)."""

NAMES = {"asked", "each", "found", "held", "kept", "known", "place", "places", "told", "wanted"}
"""Parts of the name of a value that do not say what the value is; so does a name that starts with `of_`."""

MOST = {"lines": 69_000, "modules": 420, "prose": 86_000, "words": 0}
"""Bars of the product; `prose` is words of docstrings and comments. A capability may raise them, by 1,500 lines at most (topics of a robot, its
traffic: 3,000)."""

MOST_VAGUE = 0.005
"""Share of stored names that may still have such a part."""


def modules() -> list[Path]:
    """Return every Python file of the product."""
    paths = (path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py")))
    return [path for path in paths if not any(part.is_symlink() for part in path.parents)]


def prose(text: str) -> list[tuple[int, str]]:
    """Return docstrings, of attributes too, and comments: line and text."""
    found = []
    for node in ast.walk(ast.parse(text)):
        body = getattr(node, "body", None)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and body:
            strings = [line for line in body if isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant)]
            found += [(line.lineno, line.value.value) for line in strings if isinstance(line.value.value, str)]
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return found + [(t.start[0], t.string.lstrip("#")) for t in tokens if t.type == tokenize.COMMENT]


def literals(text: str) -> list[tuple[int, str]]:
    """Return the other strings: what users read."""
    docs = {line for line, _ in prose(text)}
    return [
        (node.lineno, node.value)
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node.lineno not in docs
    ]


def stored_names(text: str) -> list[tuple[int, str]]:
    """Return the names of values that are stored: variables, arguments, fields, attributes."""
    names = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.append((node.lineno, node.id))
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            names.append((node.lineno, node.attr))
        elif isinstance(node, ast.arg):
            names.append((node.lineno, node.arg))
    return names


def is_vague(name: str) -> bool:
    """Return whether a name says how a value came about and not what it is."""
    name = name.lstrip("_").lower()
    return name.startswith("of_") or bool(NAMES & set(name.split("_")))


def main() -> int:
    """Print the figures; return 1 where a bar is missed."""
    rooms: dict[str, Counter[str]] = {}
    places: list[str] = []
    for path in modules():
        text, where = path.read_text(encoding="utf-8"), path.relative_to(ROOT)
        texts, names = prose(text), stored_names(text)
        vague = [(line, name) for line, name in names if is_vague(name)]
        spoken = [(line, word) for line, said in [*texts, *literals(text)] for word in WORDS.findall(said)]
        count = rooms.setdefault(where.parts[0], Counter())
        count["lines"] += text.count("\n")
        count["modules"] += path.name != "__init__.py"
        count["prose"] += sum(len(said.split()) for _, said in texts)
        count["words"] += len(spoken)
        count["names"] += len(names)
        count["vague"] += len(vague)
        places += [f"{where}:{line}: {what}" for line, what in spoken + vague]
    total = sum(rooms.values(), Counter[str]())
    print(f"{'room':10} {'lines':>7} {'modules':>8} {'prose':>7} {'words':>6} {'names':>7} {'vague':>6}")
    for room, count in [*rooms.items(), ("all", total)]:
        share = count["vague"] / max(count["names"], 1)
        print(
            f"{room:10} {count['lines']:7} {count['modules']:8} {count['prose']:7} {count['words']:6} "
            f"{count['names']:7} {share:6.1%}"
        )
    if "--list" in sys.argv:
        print("\n".join(places))
    bars = MOST | {"vague": int(MOST_VAGUE * total["names"])}
    missed = [f"{name}: {total[name]:,}, at most {most:,}" for name, most in bars.items() if total[name] > most]
    print("".join(f"too many {line}\n" for line in missed), end="")
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
