"""One browser and one set of pages for all browser tests of a worker."""

import shutil

import pytest
from page_reader import EVERY_PAGE, FLAGS, Reader

from dds_trace.reports import load_reporter
from dds_trace.reports.book.book import Book


@pytest.fixture(scope="session")
def chromium():
    """One browser; Playwright gives it a fresh profile."""
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    if program is None:
        pytest.skip("Chromium is not installed (apt-get install chromium)")
    playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=program, args=list(FLAGS))
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def pages(tmp_path_factory):
    """Name of an analysis -> the report's file."""
    folder = tmp_path_factory.mktemp("pages")
    written = {}

    def page_of(name):
        if name not in written:
            path = folder / f"{name.replace(' ', '_')}.html"
            path.write_text(load_reporter("html").render(Book(EVERY_PAGE[name]())), encoding="utf-8")
            written[name] = path.as_uri()
        return written[name]

    return page_of


@pytest.fixture
def reader(chromium):
    one = Reader(chromium)
    yield one
    one.tab.context.close()
