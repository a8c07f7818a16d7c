"""One browser, one tab and one set of pages for all browser tests of a worker: Playwright takes no second one beside it."""

import pytest
from browser import Reader, open_browser


@pytest.fixture(scope="session")
def chromium():
    with open_browser() as browser:
        yield browser


@pytest.fixture(scope="session")
def show(tmp_path_factory):
    """Puts a page where readers find all of them: a browser compiles a script again that stands at another address."""
    path = tmp_path_factory.mktemp("pages") / "page.html"

    def address_of(page):
        path.write_text(page, encoding="utf-8")
        return path.as_uri()

    return address_of


@pytest.fixture(scope="session")
def pages(show):
    """Name of an analysis -> the address of its report, until the next is asked for."""
    from page_reader import rendered  # the analyses, which only these tests load

    return lambda name: show(rendered(name, "html"))


@pytest.fixture(scope="session")
def tab(chromium):
    return chromium.new_page()


@pytest.fixture
def new_tab(chromium):
    context = chromium.new_context()
    yield context.new_page()
    context.close()


@pytest.fixture
def read_with(tab):
    readers = []

    def begin(**options):
        readers.append(Reader(tab, **options))
        return readers[-1]

    yield begin
    for one in readers:
        one.leave()


@pytest.fixture
def reader(read_with):
    return read_with()
