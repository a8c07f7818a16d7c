"""Chromium, a tab of it as a reader of a page has it, and the rules of accessibility."""

import shutil
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import pytest
from waiting import PATIENCE_S

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)

WINDOW = {"width": 1360, "height": 900}

PROGRAMS = ("chromium-headless-shell", "chromium", "chromium-browser")
"""The shell is Chromium's engine without the windows around it: the same pages for half the processor time."""


@contextmanager
def open_browser():
    """Chromium for a block; Playwright gives it a fresh profile. Where there is none, the test is skipped by name."""
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        pytest.skip("Chromium is not installed (apt-get install chromium-headless-shell)")
    playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=program, args=list(FLAGS), timeout=PATIENCE_S * 1000)
        yield browser
        browser.close()


class Reader:
    """Notes what a reader of the page in a tab should never meet: errors, requests, dialogs.

    Args:
        tab: read by one reader after the other: the scripts of a page cost three seconds of processor time in a new tab, and
            nothing in one that has compiled them before.
        viewport: size of the window in px.
        color_scheme: what the system of the reader prefers.
    """

    def __init__(self, tab, *, viewport=WINDOW, color_scheme="light"):
        self.tab = tab
        tab.set_viewport_size(viewport)
        tab.emulate_media(color_scheme=color_scheme)
        tab.set_default_timeout(PATIENCE_S * 1000)  # a machine that is busy with other tests is slow, not wrong
        self.complaints = []
        self.requests = []
        self._notes = {
            "console": lambda message: self.complaints.append(message.text),
            "pageerror": lambda error: self.complaints.append(str(error)),
            "dialog": lambda dialog: self.complaints.append(f"dialog {dialog.message}"),
            "request": lambda request: self.requests.append(request.url),
        }
        for event, note in self._notes.items():
            tab.on(event, note)

    def leave(self):
        for event, note in self._notes.items():
            self.tab.remove_listener(event, note)
        self.tab.evaluate("try { localStorage.clear(); } catch { /* an empty page has none */ }")
        self.tab.goto("about:blank")

    def open(self, address):
        self.tab.goto(address)
        # Playwright's wait_for_function would need eval, which the page forbids.
        self.tab.locator(".count").filter(has_text="result").wait_for(state="attached")
        self.tab.locator("#groups-table table").wait_for(state="attached")  # comes last
        return self.tab

    def draw_all(self):
        self.tab.evaluate("for (const block of blocks) block.draw()")

    def draw_all_as_planned(self):
        """Draw every figure; returns the number of rows of panels, those not as high as their rooms, and how much the page grew.

        Also of what is folded: `clientHeight` is 0 there, and the room is the planned one when it is opened.
        """
        self.tab.evaluate("for (const block of blocks) block.plan()")
        height = "document.documentElement.scrollHeight"
        planned = self.tab.evaluate(height)
        self.draw_all()
        heights = self.tab.evaluate(
            """() => blocks.flatMap(({name, rows, plot}) => rows.map(({layout}, place) => {
                const row = plot.children[place];
                return [name, layout.height, row.clientHeight || layout.height, row.querySelector(".main-svg").height.baseVal.value];
            }))"""
        )
        misfits = [one for one in heights if not one[1] == one[2] == one[3]]
        return len(heights), misfits, self.tab.evaluate(height) - planned

    def marks(self, figure):
        return self.tab.evaluate(
            "name => document.querySelectorAll(`#figure-${name} .plot svg :is(.point, .hm image)`).length", figure
        )


AXE_HOMES = tuple(  # axe-core comes inside this package; it is read, never imported
    str(Path(folder) / "axe.min.js")
    for folder in getattr(find_spec("axe_playwright_python"), "submodule_search_locations", None) or ()
)
AXE_RULES = "['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa', 'best-practice']"


def violations(tab, where, rules=AXE_RULES):
    """What axe-core finds against WCAG AA and its best practice, or some of their rules, in a part of the page."""
    axe = next((Path(home) for home in AXE_HOMES if home and Path(home).is_file()), None)
    if axe is None:
        pytest.skip("axe-core is not here (pip install axe-playwright-python)")
    tab.evaluate(axe.read_text(encoding="utf-8"))
    options = f"{{runOnly: {rules}, resultTypes: ['violations']}}"  # what passes is megabytes
    found = tab.evaluate(f"async () => (await axe.run({where}, {options})).violations")
    return [(each["id"], [node["html"][:200] for node in each["nodes"]]) for each in found]
