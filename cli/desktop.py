"""Opens a page in the browser of whoever sits before this machine, where there is a desktop."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

DESKTOP_VARIABLES = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")
"""Any of these is set where a browser can show something: without one, `webbrowser` may start a text browser in this terminal."""


def open_page(page: Path) -> None:
    """Open a page in the default browser; where that cannot be, print a line to stderr that says so."""
    import webbrowser

    if any(map(os.environ.get, DESKTOP_VARIABLES)) and webbrowser.open(page.absolute().as_uri()):
        return
    print(
        "no desktop here: open the file below in a browser, here or copied to another machine",
        file=sys.stderr,
    )
