import struct
import sys
import xml.etree.ElementTree as ET

import pytest
from analyses import EVERY_ANALYSIS, HOSTILE
from four_campaigns import CAMPAIGNS

from dds_trace import __version__
from dds_trace.reports.book.book import Book
from dds_trace.reports.card import BOLD_CHARACTER, CHARACTER, EDGE, HEIGHT, WIDTH, render, write_card

EVERY_CARD = {**EVERY_ANALYSIS, **CAMPAIGNS}
SVG = "{http://www.w3.org/2000/svg}"


def texts(book):
    return ET.fromstring(render(book)).findall(f"{SVG}text")


@pytest.mark.parametrize("name", EVERY_CARD)
def test_every_card_is_whole_and_within_its_edges(name):
    book = Book(EVERY_CARD[name]())
    assert render(book) == render(Book(EVERY_CARD[name]()))
    bounds = []
    for text in texts(book):
        x, y, size = (float(text.get(key)) for key in ("x", "y", "font-size"))
        width = len(text.text or "") * size * (BOLD_CHARACTER if text.get("font-weight") else CHARACTER)
        left = x - width if text.get("text-anchor") == "end" else x
        assert EDGE - 0.5 <= left <= left + width <= WIDTH - EDGE + 0.5, text.text
        assert size <= y <= HEIGHT - 8
        assert size >= 12
        bounds.append((left, left + width, y - 0.75 * size, y + 0.1 * size, text.text))
    for place, (left, right, top, bottom, words) in enumerate(bounds):
        for other in bounds[place + 1 :]:
            apart = right <= other[0] or other[1] <= left or bottom <= other[2] or other[3] <= top
            assert apart, (words, other[-1])
    for circle in ET.fromstring(render(book)).findall(f"{SVG}circle"):
        assert EDGE < float(circle.get("cx")) <= WIDTH - EDGE


@pytest.mark.parametrize("name", ["lossy machine", "study", "demo"])
def test_the_card_has_sentence_losses_rows_place_and_date_and_ends_with_versions(name, sentences):
    *words, versions = (text.text for text in texts(Book(CAMPAIGNS[name]())))
    sentences(*words)
    assert versions.startswith(f"dds-trace {__version__}")


def test_the_fastest_is_first_and_farthest_left_and_what_was_lost_has_no_dot():
    book = Book(CAMPAIGNS["lossy machine"]())
    rows = [text for text in texts(book) if text.get("text-anchor") == "end"][1:]
    dots = [float(dot.get("cx")) for dot in ET.fromstring(render(book)).findall(f"{SVG}circle")]
    assert dots == sorted(dots)
    assert len(dots) == len(rows) - 1
    assert [bool(row.get("font-weight")) for row in rows] == [True, *[False] * 5]
    assert rows[-1].text == "lost"


def test_hostile_names_stay_text():
    drawn = render(Book(EVERY_ANALYSIS["hostile strings"]()))
    assert "<script" not in drawn
    assert not [text for text in HOSTILE if "<" in text and text in drawn]


def test_both_files_have_the_size_that_a_preview_shows(tmp_path):
    said = []
    svg, png = write_card(Book(CAMPAIGNS["demo"]()), tmp_path, said.append)
    assert ET.parse(svg).getroot().attrib["viewBox"] == f"0 0 {WIDTH} {HEIGHT}" == "0 0 1200 630"
    assert struct.unpack(">II", png.read_bytes()[16:24]) == (WIDTH, HEIGHT)
    assert not said


def test_without_matplotlib_one_line_says_how_to_get_it(tmp_path, monkeypatch, sentences):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    said = []
    assert write_card(Book(CAMPAIGNS["demo"]()), tmp_path, said.append) == [tmp_path / "card.svg"]
    sentences(*said)
    assert not (tmp_path / "card.png").exists()
