"""Numbers of a sentence, which a test asserts; its words stand in tests/data/sentences.json; reports as text."""

import re

from dds_trace.extensions.gates.report import ComparisonReport
from dds_trace.reports.book.book import Book
from dds_trace.reports.reporters import load_reporter


def numbers(sentence: str) -> list[float]:
    """The numbers of a sentence in their order; none of those within a name, such as p99."""
    return [float(found.replace(",", "")) for found in re.findall(r"(?<![\w.#])[+-]?\d[\d,]*(?:\.\d+)?", sentence)]


def report_as(kind, analysis) -> str:
    return load_reporter(kind).render(Book(analysis, shows_all=True))


def comparison_as(kind, info, comparison=None, title="main → branch", **options) -> str:
    return load_reporter(kind).render(ComparisonReport(info, comparison, title, **options))
