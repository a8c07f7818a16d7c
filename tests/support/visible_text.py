"""The text of an HTML report that a reader meets."""

import html
import re


def visible_text(report):
    """Include a page's labels for the blind; leave out its scripts and data, which draw the rest."""
    kept = re.sub(r"<(script|style)\b.*?</\1>", " ", report, flags=re.DOTALL)
    labels = " ".join(re.findall(r'(?:aria-label|title)="([^"]*)"', kept))
    return html.unescape(f"{re.sub(r'<[^>]+>', ' ', kept)} {labels}")
