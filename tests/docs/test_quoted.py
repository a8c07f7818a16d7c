"""Every answer that README and the pages quote is what the kept traces give today; `just readme` writes them again."""

import sys
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def quoted(monkeypatch):
    monkeypatch.setattr(sys, "path", [str(ROOT / "scripts"), *sys.path])
    monkeypatch.setenv("COLUMNS", "80")
    return import_module("quoted")


def test_pages_quote_what_their_traces_give(quoted):
    pages = [page for page in quoted.PAGES if "<!-- quoted:" in page.read_text(encoding="utf-8")]
    assert {page.name for page in pages} >= {"README.md", "loopback.md", "camera-late.md", "bag.md"}
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert text.count("<!-- quoted:") == len(quoted.QUOTE.findall(text))
        assert quoted.with_quotes(text) == text, f"{page}: run `just readme`"
