import re
import subprocess
import sys
from pathlib import Path

import pytest
from visible_text import Page
from waiting import PATIENCE_S

import dds_trace
from dds_trace.analyzer.findings.table import all_checks
from dds_trace.analyzer.model.columns import ROUNDTRIP_COLUMNS, SUMMARY_COLUMNS
from dds_trace.recorder import errors

pytestmark = pytest.mark.thorough  # the site is built

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"

LOADED = {"script": "src", "img": "src", "iframe": "src", "source": "srcset", "video": "src", "link": "href"}
"""Element -> attribute that makes a browser load something; an `a` is followed by a person alone."""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the built site; warnings are errors, as in `just docs`."""
    pytest.importorskip("sphinx", reason="the extra [docs] is not installed")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "--quiet", "--fail-on-warning", "--keep-going", "-d", folder / "cache"]
    built = subprocess.run([*command, DOCS, folder / "html"], capture_output=True, text=True, check=False)
    assert (built.returncode, built.stderr) == (0, "")
    return folder / "html"


def read(path):
    return Page(path.read_text(encoding="utf-8"))


def test_no_page_loads_anything_from_the_network(site):
    elements = [element for path in site.rglob("*.html") for element in read(path).elements]
    loads = {
        given[LOADED[tag]]
        for tag, given in elements
        if LOADED.get(tag) in given and given.get("rel") not in ("next", "prev", "index", "search")
    }
    assert len(loads) > 10
    assert {load for load in loads if "//" in load} == set()
    styles = "\n".join(path.read_text(encoding="utf-8") for path in site.rglob("*.css"))
    assert re.findall(r"(?:@import|url\()\s*['\"]?(?:https?:)?//[^)]*", styles) == []


def test_diaries_of_experiments_are_not_in_the_navigation(site):
    text = (site / "index.html").read_text(encoding="utf-8")
    navigation = text[text.index('class="sidebar-tree"') : text.index("</aside>")]
    assert "how-to/ci.html" in navigation
    assert [page for page in ("results/coverage", "results/explain") if page in navigation] == []


def test_every_page_of_the_folder_is_a_page_of_the_site(site):
    pages = {path.relative_to(DOCS).with_suffix(".html") for path in DOCS.rglob("*.md")}
    assert {str(page) for page in pages if not (site / page).is_file()} == set()


def test_the_reference_has_every_name_of_the_code(site):
    reference = {path.stem: read(path) for path in (site / "reference").glob("*.html")}
    shown = {anchor.replace("-", "_") for anchor in reference["findings"].values("id") if anchor}
    assert {check.code for check in all_checks()} - shown == set()
    names = set(dds_trace.__all__) - {"__version__"}
    assert {f"dds_trace.{name}" for name in names} - reference["python"].values("id") == set()
    for column in (*ROUNDTRIP_COLUMNS, *SUMMARY_COLUMNS):
        assert column.name in reference["columns"].text
    for option in ("bridge_peer", "--print-config", "--deadline", "--fail-if", "--host"):
        assert option in reference["commands"].text
    assert errors.LossesError.__name__ in reference["exit-codes"].text


@pytest.mark.browser
def test_a_reader_searches_it_from_the_folder(site, new_tab):
    requests, complaints = [], []
    new_tab.set_default_timeout(PATIENCE_S * 1000)
    new_tab.on("request", lambda request: requests.append(request.url))
    new_tab.on("console", lambda message: complaints.append(message.text))
    new_tab.on("pageerror", lambda error: complaints.append(str(error)))
    new_tab.goto((site / "index.html").as_uri())
    new_tab.locator("input[name=q]").first.fill("heartbeat_bound_recovery")
    new_tab.keyboard.press("Enter")
    first = new_tab.locator("#search-results li a").first
    first.wait_for()
    assert "findings" in first.get_attribute("href")
    new_tab.locator("input[name=q]").first.fill("wifi")
    new_tab.keyboard.press("Enter")
    found = new_tab.locator("#search-results li", has=new_tab.locator("a[href^='tutorials/two-devices']"))
    excerpt = found.locator(".excerpt")
    excerpt.wait_for()
    assert "Wi-Fi" in excerpt.inner_text()
    assert "<" not in excerpt.inner_text()
    assert complaints == []
    assert {request for request in requests if not request.startswith(("file:", "data:"))} == set()
