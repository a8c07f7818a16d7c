import re
import sys
from importlib import import_module

import pytest
from doc_examples import DOCS, PAGES

from dds_trace.reports.figures.table import FIGURES

IMAGES = DOCS / "images"
MOST_BYTES, MOST_BYTES_TOGETHER = 150_000, 2_000_000


def test_pictures_are_small_and_used():
    pictures = sorted(path for path in IMAGES.rglob("*") if path.is_file())
    assert {path.name: path.stat().st_size for path in pictures if path.stat().st_size > MOST_BYTES} == {}
    assert sum(path.stat().st_size for path in pictures) < MOST_BYTES_TOGETHER
    text = "".join(path.read_text(encoding="utf-8") for path in [*PAGES, DOCS.parent / "README.md"])
    assert [path.name for path in pictures if path.relative_to(DOCS).as_posix() not in text] == []


def test_the_recipe_takes_every_picture_and_each_figure_has_one(monkeypatch):
    pytest.importorskip("playwright", reason="Playwright is not installed")
    monkeypatch.setattr(sys, "path", [str(DOCS.parent / "scripts"), *sys.path])
    taken = import_module("screenshots").pictures()
    assert {f"{name}.webp" for name in taken} | {"studio.webp"} == {  # a picture of a search has a recipe of its own
        path.relative_to(IMAGES).as_posix() for path in IMAGES.rglob("*.webp")
    }
    sections = re.findall(
        r"^### .+ \(`(\w+)`\)\n!\[.+\]\(images/figures/(\w+)\.webp\)$",
        (DOCS / "reading-the-report.md").read_text(encoding="utf-8"),
        re.MULTILINE,
    )
    assert len(sections) == len(FIGURES)
    assert all(name == picture and f"figures/{name}" in taken for name, picture in sections)
