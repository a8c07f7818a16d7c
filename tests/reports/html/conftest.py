"""One browser and one set of pages for all browser tests of a worker."""

import pytest
from page_reader import EVERY_PAGE, Reader, open_browser

from dds_trace.reports import load_reporter
from dds_trace.reports.book.book import Book


@pytest.fixture(scope="session")
def chromium():
    """One browser."""
    with open_browser() as browser:
        yield browser


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
