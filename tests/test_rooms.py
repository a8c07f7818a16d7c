import ast
import re
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("src/dds_trace/base", "tracefile", "recorder", "analyzer", "reports", "cli", "extensions")
MOST_LINES = 450


@pytest.mark.parametrize("folder", ["scripts", "benchmarks", "sample_traces", "tests/support", "tests/packaging"])
def test_whatever_starts_a_relay_waits_until_it_serves(folder):
    scripts = [path.read_text(encoding="utf-8") for path in (ROOT / folder).rglob("*.[ps][yh]")]
    assert not [text for text in scripts if re.search(r"--role\W+relay\b", text) and "serves" not in text]


def modules():
    return [path for room in ROOMS for path in (ROOT / room).rglob("*.py") if path.name != "__init__.py"]


def lines_of(path):
    return len(path.read_text(encoding="utf-8").splitlines())


def test_no_module_is_longer_than_one_sitting():
    too_long = {str(path.relative_to(ROOT)): lines_of(path) for path in modules() if lines_of(path) > MOST_LINES}
    assert too_long == {}


def test_a_name_is_imported_from_the_module_that_defines_it():
    """The contents page of a room has no names; only `dds_trace` itself offers some, to users."""
    graph = grimp.build_graph("dds_trace", exclude_type_checking_imports=False, cache_dir=None)
    rooms = [f"dds_trace.{room}" for room in ("analyzer", "base", "cli", "recorder", "reports", "tracefile")]
    assert {room: graph.find_modules_directly_imported_by(room) for room in rooms} == {room: set() for room in rooms}


WORDS = {"Basis", "MIN_RUNS", "PERCENTILES", "POWER", "STATISTICS", "messages_to_end", "planned_messages"}
DECISION = re.compile(
    "judge|rank_|test|alpha|margin|exceeds|limit|speaks_against|pays|interval_of|change_of|LOSSY_SHARE"
)


def test_a_report_makes_no_verdict():
    """It names what the analyzer judged, and imports no test, margin or level of one."""
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in (ROOT / "reports").rglob("*.py")]
    lines = [line for tree in trees for line in ast.walk(tree) if isinstance(line, ast.ImportFrom) and line.module]
    imported = {(line.module, alias.name) for line in lines for alias in line.names}
    statistics = {
        name for module, name in imported if re.match(r"(dds_trace\.analyzer\.(run_)?statistics|scipy)", module)
    }
    verdicts = {name for module, name in imported if module.startswith("dds_trace.analyzer.verdicts")}
    assert "MIN_RUNS" in statistics <= WORDS
    assert "PROVEN" in verdicts
    assert not [name for name in verdicts if DECISION.match(name)]


def test_no_module_imports_itself_in_a_circle():
    """Imports for type checkers count: a circle hidden under TYPE_CHECKING is still a circle."""
    graph = grimp.build_graph("dds_trace", exclude_type_checking_imports=False, cache_dir=None)
    # A package stands for its contents page, which imports the modules that it names and is imported in their place.
    assert len(graph.modules) > 200
    imports = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    try:
        tuple(TopologicalSorter(imports).static_order())
    except CycleError as err:
        pytest.fail(" -> ".join(err.args[1]))
