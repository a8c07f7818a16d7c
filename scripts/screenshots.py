"""Pictures of the report for the documentation, taken by the machine's own Chromium: `just screenshots`.

    python scripts/screenshots.py                      # all of them, into docs/images/
    python scripts/screenshots.py ecdf first-screen    # some

Each picture is of a real campaign, or of two together, whose traces docs/results/ keeps: analyzed and drawn by the present code.
"""

from __future__ import annotations

import argparse
import base64
import os
import re
import shutil
import sys
import tarfile
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from playwright.sync_api import sync_playwright

from dds_trace.analyzer.pipeline import analyze
from dds_trace.extensions.bags.analyze import analyze_topics
from dds_trace.extensions.bags.report import BagReport
from dds_trace.reports.book.book import Book
from dds_trace.reports.reporters import load_reporter

if TYPE_CHECKING:
    from collections.abc import Mapping

TOP = Path(__file__).parents[1]
IMAGES, RESULTS = TOP / "docs" / "images", TOP / "docs" / "results"
READING = TOP / "docs" / "reading-the-report.md"
QUALITY = 80
"""Of WebP, 0 to 100: text stays sharp, a picture has 20 to 100 KB."""


TWO_LINKS = "gallery+emulated-link"

BAG = "drive"

UP_TO_1_MB = "loopback-4MB"
"""Without 4 MB, at which one setup lost messages: then a headline is of losses, and the picture is to show a winner."""

CAMPAIGNS = (
    "loopback",
    "gallery",
    TWO_LINKS,
    "emulated-link",
    "two-clocks",
    "flows",
    "fan-out",
    "outages",
    "two-machines",
    BAG,
)
"""Folders of docs/results/, joined by + where they are analyzed together; where the first has no such figure, the next is looked at."""


@dataclass(frozen=True)
class Picture:
    """What is taken: which campaign, which part of its page.

    Attributes:
        campaign: one of `CAMPAIGNS`.
        select: CSS selector of the part; empty for the first screen.
        width: of the window, in CSS pixels.
        cell: label of the message that is selected; empty for the one that the page selects.
    """

    campaign: str
    select: str = ""
    width: int = 1000
    cell: str = ""


LINK_CELL = "145 KB at 40 Hz"
"""What the link of `emulated-link` carries with trouble: 46 of its 54 Mbit/s."""

CAMPAIGN_OF: Mapping[str, tuple[str, str]] = {
    "dots": ("emulated-link", ""),
    "by_device": (TWO_LINKS, ""),
    "wire_cost": ("emulated-link", ""),
    "sent_again": ("emulated-link", LINK_CELL),
    "first_message": ("emulated-link", ""),
    "one_way": ("emulated-link", ""),
    "clock": ("two-clocks", ""),
    "percentile_curve": ("gallery", "502 KB"),
    "ecdf": ("gallery", "502 KB"),
    "timeline": ("emulated-link", LINK_CELL),
    "host_load": ("gallery", "502 KB"),
    "interference": ("flows", ""),
    "fan_out": ("fan-out", ""),
    "recovery": ("outages", ""),
}
"""Figure -> campaign and message that show it well; others are taken of `gallery`."""


def pictures() -> dict[str, Picture]:
    """Return file below docs/images/, without .webp -> what is on it: the first screen, and each figure that is explained."""
    names = re.findall(r"^### .+ \(`(\w+)`\)$", READING.read_text(encoding="utf-8"), re.MULTILINE)
    found = {
        "first-screen": Picture(UP_TO_1_MB, width=1360),
        "topics": Picture("two-machines", "#topics", width=1300),
        "bag": Picture(BAG, "main", width=1000),
    }
    for name in names:
        campaign, cell = CAMPAIGN_OF.get(name, ("gallery", ""))
        found[f"figures/{name}"] = Picture(campaign, f"#figure-{name}", cell=cell)
    return found


def page_of(campaign: str) -> str:
    """Return the page of a campaign, one of `CAMPAIGNS`, as HTML."""
    with tempfile.TemporaryDirectory() as folder:
        names, _, size = campaign.partition("-4") if campaign == UP_TO_1_MB else (campaign, "", "")
        title = Path(folder, names.partition("+")[0])
        for name in names.split("+"):
            for traces in sorted((RESULTS / name).glob("*.tar.xz")):
                with tarfile.open(traces) as archive:
                    archive.extractall(title / name, filter="data")
        for trace in title.rglob("*-4MB_*") if size else ():
            trace.unlink()
        if campaign == BAG:
            here = Path.cwd()
            os.chdir(title / BAG)  # the page names the path as it is given
            try:
                return load_reporter("html").render(BagReport(analyze_topics([Path(BAG)])))
            finally:
                os.chdir(here)
        return load_reporter("html").render(Book(analyze(title)))


def take(wanted: Mapping[str, Picture], out: Path) -> list[str]:
    """Take pictures; return the names of those that no campaign has.

    Args:
        wanted: name -> picture, of `pictures`.
        out: folder of the pictures.
    """
    missing = []
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=browser_program(), args=["--headless", "--no-sandbox"])
        for name, picture in wanted.items():
            for campaign in dict.fromkeys([picture.campaign, *CAMPAIGNS]):
                file = Path(folder) / f"{campaign}.html"
                if not file.is_file():
                    file.write_text(page_of(campaign), encoding="utf-8")
                shot = _shot(browser, file.as_uri(), picture)
                if shot is not None:
                    path = out / f"{name}.webp"
                    path.parent.mkdir(parents=True, exist_ok=True)
                    path.write_bytes(shot)
                    print(f"{path} {len(shot) / 1000:.0f} KB, of {campaign}")
                    break
            else:
                missing.append(name)
        browser.close()
    return missing


def _shot(browser: Any, address: str, picture: Picture) -> bytes | None:
    """Return a picture of a page as WebP; None where the page has no such part."""
    # What is in view is drawn: a window as high as any figure.
    height = 2400 if picture.select else 1000
    tab = browser.new_page(viewport={"width": picture.width, "height": height})
    try:
        tab.goto(address)
        if picture.campaign != BAG:
            tab.locator(".count").filter(has_text="result").wait_for(state="attached")
        cells = tab.locator("#choose-cell option").all_text_contents()
        chosen = next((cell for cell in cells if picture.cell and picture.cell in cell), None)
        if chosen is not None:
            tab.locator("#choose-cell").select_option(label=chosen)
        tab.evaluate(IN_PLACE)
        clip = {"x": 0, "y": 0, "width": picture.width, "height": height}
        if picture.select:
            part = tab.locator(picture.select)
            if not part.count():
                return None
            part.locator(".fold:not([open])").evaluate_all("folds => { for (const fold of folds) fold.open = true; }")
            part.scroll_into_view_if_needed()
            if picture.select.startswith("#figure"):
                part.locator("svg").first.wait_for()
            tab.wait_for_timeout(500)  # a figure that is drawn may move the ones below
            clip = tab.evaluate(BOX, picture.select)
        return taken(tab, clip)
    finally:
        tab.close()


def browser_program() -> str | None:
    """Return the machine's own Chromium."""
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "chromium-headless-shell"))), None)


def taken(tab: Any, clip: Mapping[str, float]) -> bytes:
    """Return a part of a page as WebP, which Playwright itself does not write."""
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
    known = {name.rpartition("/")[2]: name for name in pictures()}
    if unknown := set(given.names) - set(known):
        print(f"screenshots: no picture {', '.join(sorted(unknown))}; there are {', '.join(known)}", file=sys.stderr)
        return 2
    asked = {name: pictures()[name] for short, name in known.items() if not given.names or short in given.names}
    missing = take(asked, given.out)
    if missing:
        print(f"screenshots: on no page of {', '.join(CAMPAIGNS)}: {', '.join(missing)}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
