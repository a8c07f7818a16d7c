"""Size and language of the product, each with its bar in `scripts/house.toml`; `just check` runs it.

python scripts/house.py          # the counts, room by room; exit 1 where a bar is missed
python scripts/house.py --list   # with the line of each word and name to replace
python scripts/house.py --lower  # lower each bar to its count and the room for a newcomer
python scripts/house.py --lower 'The CI job'   # and take from that issue's allowance what it added
"""

from __future__ import annotations

import ast
import io
import re
import sys
import tokenize
from collections import Counter
from pathlib import Path
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
BARS = ROOT / "scripts" / "house.toml"
ROOMS = ("src", "tracefile", "recorder", "analyzer", "reports", "cli", "extensions")

WORDS = re.compile(
    r"\b(anew|begun|behind|beside|lies|mends?|mended|of which|of whom|seldom|stands|tells?|telling|that of|those of|told|unto"
    r"|whoever|whose|worked at|alone)\b(?!:)",  # before a colon it is the name of a field
    re.IGNORECASE,
)
"""Words for which the trade has a plainer one (behind -> after, told -> reported, alone -> only)."""

NAMES = re.compile(
    r"both|done|each|every|found|given|held|here|kept|known|left|made|named|one|own|places?|rest|said|some|taken|asked|told|wanted"
)
"""Names of a value that do not say what the value is."""

WRITTEN = re.compile(r"^<!-- [^>]*-->\n+(```.*?^```|(?:\|[^\n]*\n)+)", re.MULTILINE | re.DOTALL)
"""A quote or a table that a recipe writes: it follows a comment that names it."""

MAIN_HOUSE = tuple(room for room in ROOMS if room != "extensions")
BAGS = ROOT / "extensions/bags"

PARTS = frozenset({"asked", "each", "found", "held", "kept", "known", "place", "places", "told", "wanted"})
"""Those that make a longer name vague too, as does `of_` at its start."""


def texts(tree: ast.AST, text: str) -> list[tuple[int, str]]:
    """Return docstrings, of attributes too, and comments: line and text."""
    found = []
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        strings = [line for line in body if isinstance(line, ast.Expr)] if isinstance(body, list) else []
        found += [(line.lineno, line.value) for line in strings]
    docs = [(n, value.value) for n, value in found if isinstance(value, ast.Constant) and isinstance(value.value, str)]
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return docs + [(t.start[0], t.string.lstrip("#")) for t in tokens if t.type == tokenize.COMMENT]


def stored_names(tree: ast.AST) -> list[tuple[int, str]]:
    """Return the names of values that are stored: variables, arguments, fields, attributes."""
    names = []
    for node in ast.walk(tree):
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
    return bool(NAMES.fullmatch(name)) or name.startswith("of_") or bool(PARTS & set(name.split("_")))


def count_module(path: Path) -> tuple[Counter[str], list[tuple[int, str]]]:
    """Return the counts of a module, and the line of each word and name to replace."""
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text)
    prose, names = texts(tree, text), stored_names(tree)
    documented = {line for line, _ in prose}
    nodes = (node for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str))
    strings = [(node.lineno, str(node.value)) for node in nodes if node.lineno not in documented]  # what users read
    bad, read = ([(line, word) for line, said in part for word in WORDS.findall(said)] for part in (prose, strings))
    vague = [(line, name) for line, name in names if is_vague(name)]
    count = Counter(
        lines=text.count("\n"),
        modules=int(path.name != "__init__.py"),
        words=sum(len(said.split()) for _, said in prose),
        bad=len(bad),
        read=len(read),
        names=len(names),
        vague=len(vague),
    )
    return count, bad + read + vague


def count_constants(tree: ast.Module) -> int:
    """Return how many names of a module are numbers, or several of them."""
    names = 0
    for line in tree.body:
        if isinstance(line, ast.Assign):
            values = [node for node in ast.walk(line.value) if isinstance(node, ast.Constant)]
            only = all(type(node.value) in (int, float) for node in values) and not any(
                isinstance(node, ast.Call | ast.Subscript) for node in ast.walk(line.value)
            )
            names += only and bool(values)
    return names


def count_rooms() -> tuple[dict[str, Counter[str]], list[str]]:
    """Return the counts of each room of the product, and where the words and names to replace are."""
    rooms, replace = {}, []
    for room in ROOMS:
        rooms[room] = Counter[str]()
        for path in sorted((ROOT / room).rglob("*.py")):
            if not any(part.is_symlink() for part in path.parents):
                count, lines = count_module(path)
                rooms[room] += count
                replace += [f"{path.relative_to(ROOT)}:{line}: {what}" for line, what in lines]
    return rooms, replace


def count_house(product: Counter[str], main_house: int = 0) -> dict[str, float]:
    """Return what has a bar: the counts of the product, the two shares of its language, and what comes with it."""
    endings = {".js", ".css", ".j2", ".html"}
    assets = [path for room in ROOMS for path in (ROOT / room).rglob("*") if path.suffix in endings]
    tests = (ROOT / "tests").rglob("*.py")
    return {
        **{name: product[name] for name in ("lines", "modules", "words")},
        "main_house_lines": main_house,
        "assets": sum(path.read_text(encoding="utf-8").count("\n") for path in assets),
        "tests": sum(path.read_text(encoding="utf-8").count("\n") for path in tests),
        "page_words": sum(
            len(WRITTEN.sub("", path.read_text(encoding="utf-8")).split())
            for path in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "benchmarks").rglob("*.md"))
        ),
        "constants_of_bags": sum(
            count_constants(ast.parse(path.read_text(encoding="utf-8"))) for path in BAGS.rglob("*.py")
        ),
        "bad_words_per_10_000": round(1e4 * product["bad"] / max(product["words"], 1), 2),
        "bad_words_in_strings": product["read"],
        "vague_names_percent": round(100 * product["vague"] / max(product["names"], 1), 2),
    }


def missed_bars(counts: dict[str, float], bars: dict[str, float]) -> list[str]:
    """Return a line for each count over its bar."""
    return [f"{name}: {counts[name]:,}, at most {most:,}" for name, most in bars.items() if counts[name] > most]


def stale_bars(counts: dict[str, float], house: dict[str, Any]) -> list[str]:
    """Return a line for each bar that is higher than its count and the room: the commit that lowered the count lowers it."""
    return [
        f"{name}: {most:,} for a count of {counts[name]:,}; run scripts/house.py --lower"
        for name, most in house["bars"].items()
        if most > round(counts[name] + house["room"][name], 2)
    ]


def raised_bars(parent: dict[str, Any], house: dict[str, Any]) -> list[str]:
    """Return a line for each bar that was raised by more than what the parent's allowances gave for it."""
    raised = []
    for name, most in house["bars"].items():
        before = parent["bars"].get(name, most)
        given = sum(
            max(allowance.get(name, 0) - max(house["allowances"].get(issue, {}).get(name, 0), 0), 0)
            for issue, allowance in parent["allowances"].items()
        )
        if most > round(before + given, 2):
            raised.append(f"{name}: from {before:,} to {most:,}, allowed {given:,} more")
    return raised


def lower(counts: dict[str, float], text: str, issue: str | None = None) -> str:
    """Return the file of bars with each lowered to its count and the room; only the allowance of `issue` raises one."""
    house = tomllib.loads(text)
    for name, most in house["bars"].items():
        needed = round(counts[name] + house["room"][name], 2)
        allowance = house["allowances"][issue].get(name, 0) if issue else 0
        taken = min(max(needed - most, 0), max(allowance, 0))
        bar = min(needed, most + taken)
        text = re.sub(rf"(?m)^{name} = .*$", f"{name} = {bar}", text, count=1)
        if taken:
            row = re.compile(rf'(?m)^("{re.escape(str(issue))}" = .*\b{name} = )\d+')
            text = row.sub(rf"\g<1>{allowance - taken}", text)
    return text


def main() -> int:
    """Print the counts; return 1 where a bar is missed."""
    rooms, replace = count_rooms()
    product = sum(rooms.values(), Counter[str]())
    print(f"{'room':10} {'lines':>7} {'modules':>8} {'words':>7} {'bad':>5} {'read':>5} {'names':>7} {'vague':>6}")
    for room, count in [*rooms.items(), ("all", product)]:
        print(
            f"{room:10} {count['lines']:7} {count['modules']:8} {count['words']:7} {count['bad']:5} {count['read']:5} "
            f"{count['names']:7} {count['vague']:6}"
        )
    if "--list" in sys.argv:
        print("\n".join(replace))
    main_house = sum(rooms[room]["lines"] for room in MAIN_HOUSE)
    counts, text = count_house(product, main_house), BARS.read_text(encoding="utf-8")
    if "--lower" in sys.argv:
        issue = next(iter(sys.argv[sys.argv.index("--lower") + 1 :]), None)
        text = lower(counts, text, issue)
        BARS.write_text(text, encoding="utf-8")
    bars = tomllib.loads(text)["bars"]
    print("; ".join(f"{name} {counts[name]:,} of {most:,}" for name, most in bars.items()))
    missed = missed_bars(counts, bars)
    print("".join(f"too many {line}\n" for line in missed), end="")
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
