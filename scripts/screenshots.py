"""Pictures of the report for the documentation, taken by the machine's own Chromium: `just screenshots`.

    python scripts/screenshots.py                      # all of them, into docs/images/
    python scripts/screenshots.py ecdf first-screen    # some

Each picture is of a real campaign that docs/results/ keeps: `loopback` as its stored page, which `just results` opens too,
the others as their traces, analyzed and drawn by the present code.
"""

from __future__ import annotations

import argparse
import base64
import gzip
import shutil
import sys
import tarfile
import tempfile
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from playwright.sync_api import sync_playwright
from stored_report import put_back

from dds_trace.analyzer import analyze
from dds_trace.reports import load_reporter
from dds_trace.reports.book.book import Book

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

TOP = Path(__file__).parents[1]
IMAGES, RESULTS = TOP / "docs" / "images", TOP / "docs" / "results"
QUALITY = 80
"""Of WebP, 0 to 100: text stays sharp, a picture has 20 to 100 KB."""


@dataclass(frozen=True)
class Picture:
    """What is taken: which campaign, which part of its page.

    Attributes:
        campaign: folder of docs/results/.
        select: CSS selector of the part; empty for the first screen.
        width: of the window, in CSS pixels.
        cell: words of the combination that is chosen at Messages; empty for the page's own choice.
    """

    campaign: str
    select: str = ""
    width: int = 1000
    cell: str = ""


def _figure(name: str, campaign: str, cell: str = "") -> Picture:
    return Picture(campaign, f"#figure-{name}", cell=cell)


LINK_CELL = "145 KB at 40 Hz"
"""What the link of `emulated-link` carries with trouble: 46 of its 54 Mbit/s."""

PICTURES: Mapping[str, Picture] = {
    "first-screen": Picture("loopback"),
    "figures/vendor_comparison": _figure("vendor_comparison", "loopback"),
    "figures/latency_by_rate": _figure("latency_by_rate", "emulated-link"),
    "figures/latency_by_size": _figure("latency_by_size", "loopback"),
    "figures/domain_difference": _figure("domain_difference", "loopback"),
    "figures/bridge_cost": _figure("bridge_cost", "loopback"),
    "figures/heatmap": _figure("heatmap", "emulated-link"),
    "figures/received": _figure("received", "loopback"),
    "figures/transfer_rate": _figure("transfer_rate", "emulated-link"),
    "figures/sustainable": _figure("sustainable", "emulated-link"),
    "figures/breakdown": _figure("breakdown", "loopback"),
    "figures/wire_cost": _figure("wire_cost", "emulated-link"),
    "figures/sent_again": _figure("sent_again", "emulated-link", LINK_CELL),
    "figures/first_message": _figure("first_message", "emulated-link"),
    "figures/one_way": _figure("one_way", "emulated-link"),
    "figures/clock": _figure("clock", "two-clocks"),
    "figures/percentile_curve": _figure("percentile_curve", "loopback", "502 KB"),
    "figures/ecdf": _figure("ecdf", "loopback", "502 KB"),
    "figures/timeline": _figure("timeline", "emulated-link", LINK_CELL),
    "figures/host_load": _figure("host_load", "loopback", "502 KB"),
}
"""File below docs/images/, without .webp -> what is on it; one for each figure of the report."""


def page_of(campaign: str) -> str:
    """Return the page of a campaign of docs/results/ as HTML."""
    traces = RESULTS / campaign / "traces.tar.xz"
    if traces.is_file():
        with tempfile.TemporaryDirectory() as folder, tarfile.open(traces) as archive:
            archive.extractall(Path(folder, campaign), filter="data")
            return load_reporter("html").render(Book(analyze(Path(folder, campaign))))
    return put_back(gzip.decompress((RESULTS / campaign / "report.html.gz").read_bytes()).decode())


def take(wanted: Iterable[str], out: Path) -> None:
    """Take pictures, each campaign's page opened once.

    Args:
        wanted: names of `PICTURES`.
        out: folder of the pictures.
    """
    of_campaign: dict[str, list[str]] = defaultdict(list)
    for name in wanted:
        of_campaign[PICTURES[name].campaign].append(name)
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=program, args=["--headless", "--no-sandbox"])
        for campaign, names in of_campaign.items():
            path = Path(folder) / "report.html"
            path.write_text(page_of(campaign), encoding="utf-8")
            for name in names:
                tab = browser.new_page(viewport={"width": PICTURES[name].width, "height": 900})
                tab.goto(path.as_uri())
                taken = out / f"{name}.webp"
                taken.parent.mkdir(parents=True, exist_ok=True)
                taken.write_bytes(_shot(tab, PICTURES[name]))
                print(f"{taken} {taken.stat().st_size / 1000:.0f} KB")
                tab.close()
        browser.close()


def _shot(tab: Any, picture: Picture) -> bytes:
    """Return a picture of an open page as WebP, which Playwright itself does not write."""
    tab.locator(".count").filter(has_text="group").wait_for()
    clip = {"x": 0, "y": 0, "width": picture.width, "height": 900}
    if picture.cell:
        cells = tab.locator("#choose-cell option").all_text_contents()
        tab.locator("#choose-cell").select_option(label=next(cell for cell in cells if picture.cell in cell))
    tab.evaluate(IN_PLACE)
    if picture.select:
        part = tab.locator(picture.select)
        part.scroll_into_view_if_needed()
        part.locator("svg").first.wait_for()
        tab.wait_for_timeout(300)  # a figure that is drawn may move the ones below
        clip = tab.evaluate(BOX, picture.select)
    shot = tab.context.new_cdp_session(tab).send(
        "Page.captureScreenshot",
        {"format": "webp", "quality": QUALITY, "captureBeyondViewport": True, "clip": {**clip, "scale": 1}},
    )
    return base64.b64decode(shot["data"])


IN_PLACE = """() => {
  for (const part of document.querySelectorAll("body *")) {
    if (getComputedStyle(part).position === "sticky") part.style.position = "static";
  }
}"""
"""Lets the menus that stay in view scroll away: they would lie over a figure."""

BOX = """select => {
  const box = document.querySelector(select).getBoundingClientRect();
  return { x: box.x + scrollX, y: box.y + scrollY, width: box.width, height: box.height };
}"""
"""Where a part lies on the page, in CSS pixels."""


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("names", nargs="*", help="ecdf, first-screen ...; all of them without")
    parser.add_argument("--out", type=Path, default=IMAGES)
    given = parser.parse_args()
    wanted = [name for name in PICTURES if not given.names or name.rpartition("/")[2] in given.names]
    if not wanted:
        print(f"screenshots: no such picture; there are {', '.join(PICTURES)}", file=sys.stderr)
        return 2
    take(wanted, given.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
