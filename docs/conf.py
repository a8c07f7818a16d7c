"""The site of the documentation, built by `just docs`: Sphinx reads the pages as they stand here (MyST), Furo is its look.

Sphinx because it is kept for the long run: Material for MkDocs ends in May 2027, its successor Zensical has no release 1 yet.
"""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "src")]

from dds_trace import __version__ as version  # noqa: E402 - found by the line above

project = "dds-trace"
release = version
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "generated"]
root_doc = "index"
html_theme = "furo"
html_title = f"dds-trace {version}"
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_copyright = False
html_show_search_summary = False  # summaries are fetched, which a browser refuses a page of a local folder

myst_heading_anchors = 4  # as GitHub links headings
highlight_language = "none"  # an indented block is a command or output; code says its language
default_role = "code"  # a docstring's `name` is code
nitpicky = False  # types of other packages have no page here

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
napoleon_google_docstring = True
napoleon_use_ivar = True
