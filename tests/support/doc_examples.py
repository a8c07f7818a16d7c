"""The examples of the pages of docs/: fenced blocks, and lines of commands wherever they stand."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"
PAGES = [path for path in sorted(DOCS.rglob("*.md")) if "results" not in path.parts]

FENCE = re.compile(r"^```(?P<language>\w+)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)
OPTIONS_IN_TEXT = re.compile(r"`(dds-[a-z]+ [^`]*--[a-z][^`]*)`")
COMMAND = re.compile(
    r"^(?: {4}(?:\w+'s device +)?)?(?P<line>dds-(?:trace|record|bridge|sweep|analyze) .+)$", re.MULTILINE
)


@dataclass(frozen=True)
class Example:
    page: Path
    language: str
    text: str

    @property
    def name(self) -> str:
        return str(self.page.relative_to(DOCS))


def examples(language: str, page: Path | None = None) -> Iterator[Example]:
    for path in PAGES if page is None else [page]:
        for found in FENCE.finditer(path.read_text(encoding="utf-8").replace("\\\n", "")):
            if found["language"] == language:
                yield Example(path, language, found["text"])


def command_lines() -> Iterator[tuple[Path, str]]:
    """Every line of a block, fenced or indented, that calls one of our programs, without its comment."""
    for path in PAGES:
        for found in COMMAND.finditer(re.sub(r" *\\\n *", " ", path.read_text(encoding="utf-8"))):
            yield path, re.sub(r"\s+#.*$", "", found["line"])


def lines_in_text() -> list[str]:
    """Every command with options within a sentence of the README or a page of docs/, its results included."""
    texts = [path.read_text(encoding="utf-8") for path in (DOCS.parent / "README.md", *sorted(DOCS.rglob("*.md")))]
    return list(dict.fromkeys(" ".join(line.split()) for text in texts for line in OPTIONS_IN_TEXT.findall(text)))
