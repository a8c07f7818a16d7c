"""Reports of a comparison of two sides: `info` says it in words, the others write it.

`info` ranks the groups, worst first; `words` spells numbers; `terminal`, `markdown`, `junit`, `document` (JSON) and `page`
(HTML, with its `drawings`) write, each with a `render`.
"""

from . import document, junit, markdown, page, terminal
from .info import comparison_info

__all__ = ["comparison_info", "document", "junit", "markdown", "page", "terminal"]
