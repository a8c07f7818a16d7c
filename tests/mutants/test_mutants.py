"""The mutants that `just mutants` makes: which there are, which are left out by rule, and that a loaded module takes them."""

import ast
import importlib.util
import json
import sys
from pathlib import Path

import mutants
import pytest
from grafting import graft
from mutants import CORE, EQUIVALENT, ROOT, modules_of
from mutations import mutants_of
from processes import executed

TOY = '''"""Docstring 1."""
from dataclasses import dataclass, field

LIMIT = 3
ROWS_AT_ONCE = 1000


@dataclass(frozen=True)
class Toy:
    """2 < 3"""

    size: int = 4

    @property
    def is_large(self) -> bool:
        return self.size >= LIMIT


def first(values: list[int], step: int = 1):
    assert step > 0, "4"
    if not values:
        raise ValueError(f"{len(values) + 1}" + "5")
    return [each for each, other in zip(values, values, strict=True) if each < 2 and other != -6][::step]


_SIOCGIFFLAGS = 0x8913


class Sized(__import__("typing").Protocol):
    def size(self, least: int = 6) -> int: ...
'''


def test_each_operator_and_number_has_a_mutant_but_what_the_rules_leave_out():
    tree = ast.parse(TOY)
    whole = ast.dump(tree)
    found = {(each.line, each.change): each for each in mutants_of(tree)}
    assert set(found) == {
        (4, "3 -> 4"),
        (12, "4 -> 5"),
        (16, "self.size >= LIMIT -> self.size > LIMIT"),
        (19, "1 -> 2"),
        (21, "not values -> values"),
        (23, "each < 2 and other != -6 -> each < 2 or other != -6"),
        (23, "each < 2 -> each <= 2"),
        (23, "2 -> 3"),
        (23, "other != -6 -> other == -6"),
        (23, "-6 -> 6"),
        (23, "6 -> 7"),
    }
    assert {line for (line, _), each in found.items() if each.runs_at_import} == {4, 12, 19}
    assert found[21, "not values -> values"].lines == range(21, 22)
    for each in found.values():
        each.put(edited=True)
        assert ast.dump(tree) != whole
        each.put(edited=False)
        assert ast.dump(tree) == whole


@pytest.fixture
def toy(tmp_path, monkeypatch):
    path = tmp_path / "toy.py"
    path.write_text(TOY)
    spec = importlib.util.spec_from_file_location("dds_trace.toy", path)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "dds_trace.toy", module)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("change", "before", "after"),
    [
        ("3 -> 4", "large", False),
        ("4 -> 5", "large", True),
        ("self.size >= LIMIT -> self.size > LIMIT", "edge", False),
        ("1 -> 2", "first", [0]),
        ("2 -> 3", "first", [0, 1, 2]),
    ],
)
def test_what_holds_a_module_already_sees_its_mutant(toy, change, before, after):
    held, first, made = toy.Toy, toy.first, toy.Toy(3)
    seen = {
        "large": lambda: held(3).is_large if change != "4 -> 5" else held().size == 5,
        "edge": lambda: made.is_large,
        "first": lambda: first([0, 1, 2, 3]),
    }[before]
    assert seen() != after
    tree = ast.parse(TOY)
    next(each for each in mutants_of(tree) if each.change == change).put(edited=True)
    graft(toy, compile(tree, "toy.py", "exec"))
    assert seen() == after


def test_every_mutant_that_is_judged_to_change_nothing_is_still_one_and_has_its_reason():
    modules = {each.path: each for part in CORE.values() for each in modules_of(part)}
    for path, kept in json.loads(EQUIVALENT.read_text()).items():
        places = {modules[path].place(number) for number in range(len(modules[path].mutants))}
        for each in kept:
            assert (each["line"], each["change"]) in places, f"{path}: {each}"
            assert each["reason"].endswith(".")


COMPUTING = """
import polars as pl
import pytest

SUM = {query}


@pytest.mark.parametrize("value", [SUM])
def test_sum(value):
    assert value is not None


def test_that_fails_by_itself():
    assert False
"""


@pytest.mark.parametrize(
    ("query", "is_refused"), [("pl.DataFrame({'a': [1]}).lazy().sum().collect()", True), ("1", False)]
)
def test_a_part_that_queries_while_it_is_collected_is_refused_and_a_test_that_fails_by_itself_kills_nothing(
    tmp_path, query, is_refused
):
    """In a child that is forked with polars' threads started a query waits for them without end."""
    test = tmp_path / "test_toy.py"
    test.write_text(COMPUTING.format(query=query))
    code = f"import mutants; mutants.CORE['toy'] = mutants.Part(('recorder/payloads/stamp.py',), ({str(test)!r},))"
    code += "; print(mutants.tried('toy', 0.1, 0, 1))"
    path = {"PYTHONPATH": str(Path(mutants.__file__).parent)}
    found = executed([sys.executable, "-c", code], path, cwd=ROOT, timeout=300)
    assert bool(found.returncode) == is_refused, found.stderr
    assert ("runs a query of polars" in found.stderr) == is_refused
    assert ("Counter({'tried': 7, 'killed': 0})" in found.stdout) != is_refused
