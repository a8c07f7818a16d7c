import struct
import sys
import xml.etree.ElementTree as ET

import pytest
from analyses import EVERY_ANALYSIS, HOSTILE
from four_campaigns import CAMPAIGNS

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


def test_the_card_has_the_verdict_the_dots_the_place_and_the_date():
    book = Book(CAMPAIGNS["lossy machine"]())
    words = [text.text for text in texts(book)]
    bold = " ".join(text.text for text in texts(book) if text.get("font-weight"))
    assert bold.startswith("In the same domain: at every size (33 KB to 4 MB) Zenoh is fastest at the median")
    rows = words[words.index("Zenoh") :]
    times = [float(text.get("cx")) for text in ET.fromstring(render(book)).findall(f"{SVG}circle")]
    assert times == sorted(times)  # the fastest first
    assert rows[:4] == ["Zenoh", "6.56 ms", "Cyclone DDS", "10 ms"]
    assert rows[rows.index("Fast DDS through zenoh-bridge-dds") + 1] == "lost"
    assert any(text.text.startswith("4.04 % of the messages were lost") for text in texts(book))
    assert "Measured on vm, loopback" in words
    assert words[1] == "2026-09-21 14:13 UTC"
    assert words[-1].startswith("dds-trace ")


def test_a_verdict_of_many_devices_names_how_many():
    words = " ".join(text.text for text in texts(Book(CAMPAIGNS["study"]())))
    assert "For the others see the table (3 pairs of devices and links)" in words
    assert "5 more pairs of devices and links in the report" in words


def test_hostile_names_stay_text():
    drawn = render(Book(EVERY_ANALYSIS["hostile strings"]()))
    assert "<script" not in drawn
    assert not [text for text in HOSTILE if "<" in text and text in drawn]


def test_both_files_have_the_size_that_a_preview_shows(tmp_path):
    told = []
    svg, png = write_card(Book(CAMPAIGNS["demo"]()), tmp_path, told.append)
    assert ET.parse(svg).getroot().attrib["viewBox"] == f"0 0 {WIDTH} {HEIGHT}" == "0 0 1200 630"
    assert struct.unpack(">II", png.read_bytes()[16:24]) == (WIDTH, HEIGHT)
    assert not told


def test_without_matplotlib_one_line_says_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    told = []
    assert write_card(Book(CAMPAIGNS["demo"]()), tmp_path, told.append) == [tmp_path / "card.svg"]
    assert told == ["card.png needs matplotlib: pip install 'dds-trace[card]'; card.svg is written"]
    assert not (tmp_path / "card.png").exists()
