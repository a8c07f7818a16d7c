"""Options of commands that write reports: where the traces are, what is written, and the page that is shown."""

from __future__ import annotations

import glob
import html
import os
import re
import shutil
import subprocess
from collections.abc import Collection, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer
from typer.models import OptionInfo

from dds_trace.base import limits
from dds_trace.base.errors import BackendUnavailableError, MissingEventsError
from dds_trace.base.streams import say
from dds_trace.reports.reporters import REPORT_MODULES

from .program import argument, option, starting


def expand_paths(texts: Sequence[str]) -> list[Path]:
    paths: list[Path] = []
    for text in texts:
        limits.check(limits.INPUT, text, "PATH")
        if not glob.has_magic(text) or Path(text).exists() or "://" in text:
            paths.append(Path(text))
            continue
        matches = sorted(glob.glob(text, recursive=True))  # noqa: PTH207 - pathlib's takes no absolute pattern
        if not matches:
            raise MissingEventsError(f"{text}: no file or folder matches; give the folder with the traces")
        paths += map(Path, matches)
    return paths


BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
FIGURE_WIDTHS_MM = {"pdf": 174, "pdf-column": 84}
"""Kind of `--figures` -> the width of a page or a column of a paper."""


def print_figures(page: Path, kind: str) -> list[Path]:
    """Print a report's figures as pages of a PDF next to it, with their LaTeX, by a browser without a window; returns both files.

    Raises:
        BackendUnavailableError: no browser is installed, or it wrote nothing within two minutes.
    """
    from dds_trace.analyzer.exports.kinds import write_text_file

    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    if program is None:
        raise BackendUnavailableError(
            f"--figures {kind} needs Chromium (apt-get install chromium-headless-shell); the page's own buttons save as PDF"
        )
    pdf = page.with_name(f"figures{kind.removeprefix('pdf')}.pdf")
    pdf.unlink(missing_ok=True)
    address = f"{page.absolute().as_uri()}?figures={FIGURE_WIDTHS_MM[kind]}"
    options = ["--headless", "--disable-gpu", "--no-pdf-header-footer", "--virtual-time-budget=60000"]
    options += ["--no-sandbox"] * (os.geteuid() == 0)  # root has none
    command = [program, *options, f"--print-to-pdf={pdf.absolute()}", "--dump-dom", address]
    page_text = b""
    with suppress(subprocess.TimeoutExpired):
        page_text = subprocess.run(command, check=False, capture_output=True, timeout=120).stdout
    latex = re.search(r'<pre id="latex" hidden="">(.*?)</pre>', page_text.decode("utf-8", "replace"), re.DOTALL)
    if latex is None or not pdf.is_file():
        raise BackendUnavailableError(f"{program} printed no {pdf.name}; open {page} and use its button PDF")
    return [pdf, write_text_file(pdf.with_suffix(".tex"), html.unescape(latex[1]))]


DESKTOP_VARIABLES = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")


def kinds_of(table: Collection[str], name: str, help_: str) -> OptionInfo:
    def check(kinds: list[str] | None) -> list[str] | None:
        for kind in kinds or ():
            if kind not in table:
                of_foxglove = " --derived-mcap writes what Foxglove reads." if "foxglove" in kind.lower() else ""
                raise typer.BadParameter(f"{kind!r} is not one of {', '.join(map(repr, table))}.{of_foxglove}")
        return kinds

    return option(name, f"{help_}: {', '.join(table)}; repeatable.", callback=check, autocompletion=starting(table))


Paths = Annotated[
    list[str],
    argument(
        "PATH...",
        "Folders with traces at any depth, .mcap files, rosbag2 folders, or patterns such as 'runs/*/pi4*.mcap'.",
    ),
]
Reports = Annotated[
    list[str] | None, kinds_of(REPORT_MODULES, "--report KIND", "Report to write in addition to the answer")
]
Out = Annotated[
    Path | None, option("--out FOLDER", "Folder for all files. Default: analysis/ in the common folder of all traces")
]
ShowsAll = Annotated[bool, option("--all", "Print findings and tables of all results, too, and the answer last.")]
Opens = Annotated[bool, option("--open", "Write the HTML report and open it in a browser.")]


def show_page(pages: list[Path], *, open_it: bool) -> None:
    import webbrowser

    for page in pages:
        has_desktop = any(map(os.environ.get, DESKTOP_VARIABLES))
        if open_it and not (has_desktop and webbrowser.open(page.absolute().as_uri())):
            say("no desktop here: open the file below in a browser, here or copied to another machine")
        print(page.absolute().as_uri())
