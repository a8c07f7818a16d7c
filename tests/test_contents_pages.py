"""The contents pages of the rooms: each name is there, is the module's own, and is loaded at its first use."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module

import pytest

PAGES = (
    "dds_trace.tracefile",
    "dds_trace.recorder",
    "dds_trace.recorder.bridges",
    "dds_trace.recorder.sweep",
)


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


def test_one_name_loads_its_module_and_no_other():
    script = (
        "import sys\nfrom dds_trace.tracefile import OptionError, TraceError\n"
        "assert OptionError.__module__ == 'dds_trace.tracefile.errors'\n"
        "print(*sorted(name for name in sys.modules if name.startswith('dds_trace.tracefile.')))"
    )
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert ran.stdout.split() == ["dds_trace.tracefile.errors"]
