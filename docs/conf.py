"""The site of the documentation, built by `just docs`: Sphinx reads the pages as they stand here (MyST), Furo is its look.

Sphinx because it is kept for the long run: Material for MkDocs ends in May 2027, its successor Zensical has no release 1 yet.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

from docutils import nodes

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "src")]

from dds_trace import __version__ as version  # noqa: E402 - found by the line above

project = "dds-trace"
release = version
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "generated"]
root_doc = "index"
html_theme = "furo"
html_title = f"dds-trace {version}"
html_static_path = ["site.css", "search.js"]
html_css_files = ["site.css"]
html_js_files = ["search.js"]
html_copy_source = False
html_show_copyright = False
html_show_search_summary = (
    False  # summaries are fetched, which a browser refuses a page of a local folder; search.js has its own
)

myst_heading_anchors = 4  # as GitHub links headings
highlight_language = "none"  # an indented block is a command or output; code says its language
default_role = "code"  # a docstring's `name` is code
nitpicky = False  # types of other packages have no page here

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
napoleon_google_docstring = True
napoleon_use_ivar = True

DIARIES = ("results/coverage", "results/flows", "results/fan-out", "results/calls", "results/advise", "results/explain")
"""Pages on experiments of our own: linked and found by search, not in the navigation."""


def _read(app: Any, doctree: Any) -> None:
    name = app.env.docname
    if name in DIARIES:
        app.env.metadata[name]["orphan"] = True
    if "Wi-Fi" in doctree.astext():  # which the search takes for two words
        doctree.insert(0, nodes.meta("", name="keywords", content="wifi, wlan"))


OUTSIDE = re.compile(r"\[([^\]]+)\]\(((?:\.\./)+benchmarks/[\w-]+\.md)(?:#[\w-]+)?\)")
"""A link to a page of benchmarks/, which is no part of the site: it comes with the site as a file."""


def _link_files(_app: Any, _name: str, text: list[str]) -> None:
    text[0] = OUTSIDE.sub(r"{download}`\1 <\2>`", text[0])


def _write_texts(app: Any, error: Exception | None) -> None:
    if error is None and app.builder.format == "html":
        texts = {name: " ".join(app.env.get_doctree(name).astext().split()) for name in sorted(app.env.found_docs)}
        path = Path(app.outdir, "_static", "texts.js")
        path.write_text(f"const PAGE_TEXTS = {json.dumps(texts)};\n", encoding="utf-8")


def setup(app: Any) -> None:
    """Connect what this site adds."""
    app.connect("source-read", _link_files)
    app.connect("doctree-read", _read)
    app.connect("build-finished", _write_texts)
