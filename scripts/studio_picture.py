"""The picture of `dds-trace studio` for the documentation: a browser asks, waits for a real search of some minutes, and saves its file.

python scripts/studio_picture.py
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright
from screenshots import IMAGES, browser_program, taken

FORM = {"size": "145KB", "rate": "8", "deadline": "200ms", "link": "wifi-54", "minutes": "6"}
PATIENCE_MS = 600_000


def main() -> int:
    """Take the picture; return 1 where the search gave no file."""
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as driver:
        command = [str(Path(sys.executable).with_name("dds-trace")), "studio", "--port", "0", "--out", "runs"]
        studio = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True)
        try:
            assert studio.stdout is not None
            address = re.search(r"http://\S+", studio.stdout.readline())
            assert address is not None
            browser = driver.chromium.launch(executable_path=browser_program(), args=["--headless", "--no-sandbox"])
            tab = browser.new_page(viewport={"width": 1000, "height": 1400})
            tab.goto(address[0])
            tab.locator("[name=link] option").nth(1).wait_for(state="attached")
            for name, text in FORM.items():
                field = tab.locator(f"[name={name}]")
                field.select_option(text) if name == "link" else field.fill(text)
            tab.locator(".primary").click()
            tab.locator("#sentence:not(:empty)").wait_for(timeout=PATIENCE_MS)
            height = tab.evaluate("document.querySelector('#answer').getBoundingClientRect().bottom + scrollY + 16")
            (IMAGES / "studio.webp").write_bytes(taken(tab, {"x": 0, "y": 0, "width": 1000, "height": height}))
            if not tab.locator("#files").is_visible():
                return 1
            with tab.expect_download() as download:
                tab.locator("#save").click()
            return int(not Path(download.value.path()).stat().st_size)
        finally:
            studio.terminate()
            studio.wait()


if __name__ == "__main__":
    sys.exit(main())
