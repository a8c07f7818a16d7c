"""The threat model in `SECURITY.md` rests on tests that exist."""

import re
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
PAGE = (TESTS.parent / "SECURITY.md").read_text(encoding="utf-8")
NAMED = sorted(set(re.findall(r"`([\w/]+\.py)(?:::(\w+))?`", PAGE)))


def test_the_page_names_tests():
    assert len(NAMED) > 20


@pytest.mark.parametrize(("file", "name"), NAMED)
def test_a_named_test_is_there(file, name):
    text = (TESTS / file).read_text(encoding="utf-8")
    assert re.search(rf"^\s*(def|class) {name or 'test_'}", text, re.MULTILINE)


def test_every_line_of_a_table_that_forbids_something_names_a_test():
    rows = [line.split("|")[1:-1] for line in PAGE.splitlines() if line.startswith("| ") and "may not" not in line]
    for _, forbidden, test in rows:
        assert "::" in test or ".py" in test or not forbidden.strip()


@pytest.mark.parametrize("surface", ["tap", "beacon", "calls", "live page", "`watch`"])
def test_each_surface_on_the_network_has_a_row(surface):
    assert re.search(rf"^\| [^|]*\*\*{surface}\*\*", PAGE, re.MULTILINE)
