"""The sections of the report of an analysis."""

from __future__ import annotations

from ..blocks import MARKDOWN, Block, Facts, Heading, Points, Section, Sentence
from .contents import Contents
from .findings import finding_block
from .groups import LATENCY_MEANING, group_labels
from .recommendation import advice_blocks
from .results import clocks, costs, results, wire
from .screen import screen
from .sizes import HOW_TO_READ, size_block
from .topics import topic_sections


def sections(book: Contents) -> list[Section]:
    answer, labels = book.answer, group_labels(book.groups)
    findings: list[Block] = [finding_block(kind, labels) for kind in book.findings]
    return [
        Section([Heading(f"Latency report: {book.overview.title}", 1)]),
        Section([*advice_blocks(book.advice)], media=MARKDOWN),
        Section([Sentence(answer.headline, "headline"), Points(answer.points)]),
        *([Section([size_block(book.sizes), Sentence(HOW_TO_READ, "soft")])] if book.sizes else []),
        Section([Points(answer.remarks), *([Sentence(answer.rule, "soft")] if answer.rule else [])]),
        *topic_sections(book.analysis),
        Section(
            [
                Heading("What was measured", media=MARKDOWN),
                Facts([(fact.label, fact.value) for fact in book.overview.facts]),
                Sentence(LATENCY_MEANING, media=MARKDOWN),
            ]
        ),
        Section(
            [Heading("Findings", media=MARKDOWN), *(findings or [Sentence("Nothing doubtful was found.", "soft")])]
        ),
        Section([*results(book)]),
        Section([*costs(book), *wire(book), *clocks(book)], media=MARKDOWN),
        *screen(book),
    ]
