import json
import re
import sys
from types import ModuleType

import pytest
from analyses import EVERY_ANALYSIS, MS, Measured, make_analysis
from campaigns import write_runs
from commands import run_main
from page_reader import unpacked

from dds_trace.reports.book.book import Book
from dds_trace.reports.figures.figure import Facet, FigureMaker, spread_plan
from dds_trace.reports.figures.table import FIGURES
from dds_trace.reports.reporters import REPORT_MODULES, load_reporter


@pytest.fixture
def toy_figure():
    """Worst latency against size: what a newcomer would write, with the page's own kind of lines."""

    FIGURES.append(
        FigureMaker(
            name="toy",
            title="A toy figure",
            how_to_read="Read it from left to right.",
            nothing="nothing was measured.",
            make=lambda book: spread_plan(book, Facet("size", "rate"), lambda _: True, x_title="Size"),
        )
    )
    yield
    FIGURES.pop()


def island_of(page):
    return json.loads(unpacked(re.search(r'data-packed="data">(.*?)</script>', page)[1]))


@pytest.mark.usefixtures("toy_figure")
def test_a_toy_figure_is_drawn_after_the_others():
    page = load_reporter("html").render(Book(make_analysis(Measured([MS, 2 * MS]), Measured([MS], payload_bytes=7))))
    assert "A toy figure" in page
    assert "Read it from left to right." in page
    plan = island_of(page)["figures"]["toy"]["plan"]
    assert plan["facet"] == {"x": "size", "panels": "rate", "lines": "choice"}
    assert plan["groups"] == [0, 1]


@pytest.mark.usefixtures("toy_figure")
def test_a_toy_figure_without_data_is_listed_with_its_reason():
    page = load_reporter("html").render(Book(EVERY_ANALYSIS["empty folder"]()))
    assert "nothing was measured." in page


def render(book):
    return "".join(f"{group.index},{group.published}\n" for group in book.groups.groups)


@pytest.fixture
def toy_format(monkeypatch):
    """A module with the one door, as a new file would be: the number of messages of each group."""
    module = ModuleType("toy_report")
    module.render = render
    monkeypatch.setitem(sys.modules, "toy_report", module)
    monkeypatch.setitem(REPORT_MODULES, "toy", "toy_report")


@pytest.mark.usefixtures("toy_format")
def test_a_toy_report_format_is_written_by_the_command(tmp_path, capsys):
    write_runs(tmp_path, [0])
    assert run_main(tmp_path, "--report", "toy", "--out", tmp_path / "out") == 0
    assert str(tmp_path / "out" / "report.toy") in capsys.readouterr().out
    assert re.fullmatch(r"(\d+,\d+\n)+", (tmp_path / "out" / "report.toy").read_text())
