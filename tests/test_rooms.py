"""The shape of the rooms: small folders, modules of one sitting, no circle of imports."""

import statistics
from collections import Counter
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("tracefile", "recorder", "analyzer", "reports", "cli")
MOST_ENTRIES = 17  # sixteen and the contents page
MOST_LINES = 450
MEDIAN_LINES = range(120, 221)


def modules():
    """Every module that holds code; contents pages hold names alone."""
    return [path for room in ROOMS for path in (ROOT / room).rglob("*.py") if path.name != "__init__.py"]


def lines_of(path):
    return len(path.read_text(encoding="utf-8").splitlines())


@pytest.mark.parametrize("room", [*ROOMS, "docs"])
def test_a_folder_is_taken_in_at_a_glance(room):
    # Paths of files, so that a folder of which only caches are left is none.
    files = [path.relative_to(ROOT) for path in (ROOT / room).rglob("*") if path.is_file()]
    inside = {
        (path.parents[up], path.parts[-up - 1])
        for path in files
        if not {"__pycache__", "images"}
        & set(path.parts)  # a picture for each figure is looked at on its page
        for up in range(len(path.parts) - 1)
    }
    entries = Counter(str(folder) for folder, _ in inside)
    assert {folder: count for folder, count in entries.items() if count > MOST_ENTRIES} == {}


def test_no_module_is_longer_than_one_sitting():
    too_long = {
        str(path.relative_to(ROOT)): lines_of(path) for path in modules() if lines_of(path) > MOST_LINES
    }
    assert too_long == {}


def test_modules_are_neither_crumbs_nor_loaves():
    assert statistics.median_low(map(lines_of, modules())) in MEDIAN_LINES


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
