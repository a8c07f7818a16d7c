import re
import subprocess
import sys

import pytest

import dds_trace


def test_every_name_can_be_imported_and_is_listed():
    for name in dds_trace.__all__:
        assert getattr(dds_trace, name) is not None
        assert name in dir(dds_trace)


def test_any_other_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'dds_trace' has no attribute 'nothing'"):
        dds_trace.nothing  # noqa: B018 - the access is what is tested


def test_the_page_describes_every_name():
    described = dict(re.findall(r"^- `(\w+)`: (.+)\.$", dds_trace.__doc__, re.MULTILINE))
    assert set(described) == set(dds_trace.__all__) - {"__version__"}
    assert 25 <= len(described) <= 40
    for name in described:
        own = getattr(dds_trace, name).__doc__
        assert own, name
        assert not own.startswith(f"{name}("), f"{name} has the docstring that dataclass makes up"


def printed(script):
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout


def test_importing_the_package_loads_no_numpy_and_no_room():
    script = (
        "import sys\nimport dds_trace\n"
        "print(*sorted(name for name in sys.modules if name.partition('.')[0] in {'numpy', 'polars', 'dds_trace'}))"
    )
    assert printed(script).split() == ["dds_trace"]


def test_a_name_of_the_tracefile_is_loaded_without_polars():
    script = "import sys\nfrom dds_trace import read_trace\nprint('polars' in sys.modules)"
    assert printed(script).split() == ["False"]


def test_the_page_lists_what_it_imports_and_no_more():
    assert set(dds_trace.__all__) == set(dds_trace._homes())
