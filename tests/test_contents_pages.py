"""The contents pages of the rooms: each name is there, is the module's own, and is loaded at its first use."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from dds_trace.base import lazy

PAGES = ("dds_trace",)


@pytest.mark.parametrize("page", PAGES)
def test_every_name_of_a_page_can_be_imported_and_is_listed(page):
    module = import_module(page)
    for name in module.__all__:
        assert getattr(module, name) is not None
        assert name in dir(module)


@pytest.mark.parametrize("page", PAGES)
def test_a_name_that_no_page_has_is_an_attribute_error(page):
    with pytest.raises(AttributeError, match=f"module '{page}' has no attribute 'nothing'"):
        import_module(page).nothing  # noqa: B018 - the access is what is tested


DOCS = Path(__file__).parents[1] / "docs" / "explanation" / "analysis.md"


def test_the_page_for_users_says_of_every_name_what_it_is():
    page = import_module("dds_trace")
    told = dict(re.findall(r"^- `(\w+)`: (.+)\.$", page.__doc__, re.MULTILINE))
    assert set(told) == set(page.__all__) - {"__version__"}
    assert 25 <= len(told) <= 40
    for name in told:
        own = getattr(page, name).__doc__
        assert own, name
        assert not own.startswith(f"{name}("), f"{name} has the docstring that dataclass makes up"


def test_importing_the_package_loads_no_numpy_and_no_room():
    script = (
        "import sys\nimport dds_trace\n"
        "print(*sorted(name for name in sys.modules if name.partition('.')[0] in {'numpy', 'polars', 'dds_trace'}))"
    )
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert ran.stdout.split() == ["dds_trace", "dds_trace.base", "dds_trace.base.lazy"]


def test_a_name_of_the_tracefile_is_loaded_without_polars():
    script = "import sys\nfrom dds_trace import read_trace\nprint('polars' in sys.modules)"
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert ran.stdout.split() == ["False"]


@pytest.mark.parametrize("page", PAGES)
def test_a_page_lists_what_it_imports_and_no_more(page):
    module = import_module(page)
    assert set(module.__all__) == set(lazy._homes(module.__file__))
