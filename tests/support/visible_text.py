"""What is in an HTML page, and the text of a report that a reader meets."""

import html
import re
from html.parser import HTMLParser

VOID = {"br", "hr", "img", "input", "link", "meta"}


class Page(HTMLParser):
    """Elements with their attributes, texts, and the elements that were not closed in order."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.texts, self.open = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))
        self.open += [tag] if tag not in VOID else []

    def handle_endtag(self, tag):
        self.open = self.open[:-1] if self.open[-1:] == [tag] else [*self.open, f"/{tag}"]

    def handle_data(self, data):
        self.texts.append(data)

    @property
    def tags(self):
        return [tag for tag, _ in self.elements]

    @property
    def text(self):
        return "".join(self.texts)

    def values(self, name):
        return {given[name] for _, given in self.elements if name in given}


def visible_text(report):
    """Include a page's labels for the blind; leave out its scripts and data, which draw the rest."""
    kept = re.sub(r"<(script|style)\b.*?</\1>", " ", report, flags=re.DOTALL)
    labels = " ".join(re.findall(r'(?:aria-label|title)="([^"]*)"', kept))
    return html.unescape(f"{re.sub(r'<[^>]+>', ' ', kept)} {labels}")
