import re
import zlib
from zipfile import ZipFile

import pytest

pytestmark = pytest.mark.browser

PAGE_PX = 933
"""247 mm."""

SVGS = """name => Promise.all(picturesOf(blocks.find(b => b.name === name)).map(svgOf))"""

# [figure, height, how many whiskers end beyond their axis] of each picture.
WHISKERS = """() => blocks.filter(block => (block.plan(), block.drawn.data.length)).flatMap(block => picturesOf(block).map(({data, layout}) => {
    const beyond = data.flatMap(trace => ["x", "y"].flatMap(letter => {
        const [bars, axis] = [trace[`error_${letter}`], layout[(trace[`${letter}axis`] || letter).replace(letter, `${letter}axis`)]];
        if (!bars?.array || !axis.range) return [];
        const [low, high] = axis.type === "log" ? axis.range.map(end => 10 ** end) : axis.range;
        const slack = 1e-9 * Math.abs(high);
        return trace[letter].filter((value, at) => value !== null && bars.array[at] + bars.arrayminus[at] > 0
            && (value + bars.array[at] > high + slack || value - bars.arrayminus[at] < low - slack));
    }));
    return [block.name, layout.height, beyond.length];
}))"""


def labels_of(svg):
    notes = re.findall(r'<text class="annotation-text.*?</text>', svg)
    return ["".join(re.findall(r">([^<]+)<", note)) for note in notes if "bold" in note]


def saved_by(tab, click):
    with tab.expect_download() as download:
        click()
    return download.value.suggested_filename, download.value.path()


def test_pictures_have_the_widths_of_print_on_white_in_any_theme(read_with, pages):
    one = read_with(color_scheme="dark")
    tab = one.open(pages("small campaign"))
    tab.evaluate("for (const block of blocks) block.fold.open = true")
    for width, mm in (("column", 84), ("page", 174)):
        tab.locator("#save-width").select_option(width)
        figure = tab.locator("[data-figure]:has([data-panel]:not([hidden]))").first
        figure.locator("[data-panel]").select_option(index=2)
        svg = saved_by(tab, figure.locator("[data-save=svg]").click)[1].read_text(encoding="utf-8")
        assert re.search(rf'<svg[^>]* width="{mm}mm" height="[0-9.]+mm"', svg)
        assert "rgb(255, 255, 255)" in svg, "white ground"
        assert len(set(re.findall(r'class="subplot (x\w*)"', svg))) == 1
    png = saved_by(tab, figure.locator("[data-save=png]").click)[1].read_bytes()
    assert abs(int.from_bytes(png[16:20], "big") - 174 / 25.4 * 600) < 10, "600 dots an inch"
    assert tab.evaluate("document.documentElement.dataset.theme") == "dark"
    assert one.complaints == []


@pytest.mark.parametrize("figure", ["latency_by_rate", "latency_by_size", "domain_difference"])
@pytest.mark.parametrize(("choice", "is_paper"), [("page", True), ("page", False), ("column", True)])
def test_a_picture_of_the_study_is_a_grid_on_pages_with_each_label_once(reader, pages, figure, choice, is_paper):
    tab = reader.open(pages("study"))
    if is_paper:
        tab.locator("#paper").click()
    tab.locator("#save-width").select_option(choice)
    links, columns, panels = set(), set(), 0
    for svg in tab.evaluate(SVGS, figure):
        labels = labels_of(svg)
        assert len(labels) == len(set(labels))
        assert not [label for label in labels if "…" in label]
        own = {label for label in labels if "wire" in label}
        links |= own
        columns |= set(labels) - own
        panels += len(set(re.findall(r'class="subplot (x\w*)"', svg)))
    assert len(links) == 6
    assert sum(label.endswith("wireless") for label in links) == 3
    assert panels == len(links) * len(columns)
    assert reader.complaints == []


@pytest.mark.parametrize("choice", ["screen", "column", "page"])
@pytest.mark.parametrize("name", ["demo", "study"])
def test_no_picture_is_higher_than_a_page_and_no_whisker_leaves_its_panel(reader, pages, name, choice):
    tab = reader.open(pages(name))
    tab.locator("#save-width").select_option(choice)
    pictures = tab.evaluate(WHISKERS)
    assert len({figure for figure, _, _ in pictures}) >= (4 if name == "demo" else 12)
    assert [one for one in pictures if one[1] > PAGE_PX] == []
    assert [one for one in pictures if one[2]] == []


def test_the_papers_figures_on_the_page_are_that_grid_too(reader, pages):
    tab = reader.open(pages("study"))
    tab.locator("#paper").click()
    reader.draw_all()
    rows = tab.locator("#figure-latency_by_rate .row")
    labels = rows.locator(".annotation-text").all_text_contents()
    assert rows.count() == 1
    assert sum("DDS, " in one for one in labels) == 4, "each column once"
    assert [one for one in labels if "wireless" in one] == [
        f"{d}-a → {d}-b, wireless" for d in ("laptop", "pi3", "pi4")
    ]
    tab.locator("#paper").click()
    reader.draw_all()
    assert rows.count() > 1


def test_all_figures_are_saved_as_one_zip(reader, pages):
    tab = reader.open(pages("demo"))
    for kind, first in (("svg", b"<svg"), ("png", b"\x89PNG")):
        name, path = saved_by(tab, tab.locator(f"[data-save-all={kind}]").click)
        assert name == f"dds-trace-figures-{kind}.zip"
        with ZipFile(path) as archive:
            assert archive.testzip() is None
            assert len(archive.namelist()) == tab.locator("[data-figure]").count()
            assert all(archive.read(one).startswith(first) for one in archive.namelist())
    name, path = saved_by(tab, tab.locator("[data-save-all=pdf]").click)
    assert (name, len(Pdf(path).pages)) == ("dds-trace-figures.pdf", tab.locator("[data-figure]").count())
    assert reader.complaints == []


class Pdf:
    """The objects of a PDF by number, each found where its table of contents says, and what its pages draw."""

    def __init__(self, path):
        data = path.read_bytes()
        table = int(re.search(rb"startxref\n(\d+)\n%%EOF\n$", data)[1])
        places = [int(one) for one in re.findall(rb"(\d{10}) 00000 n", data[table:])]
        self.objects = {}
        for number, place in enumerate(places, 1):
            start = b"%d 0 obj\n" % number
            assert data.startswith(start, place)
            self.objects[number] = data[place + len(start) : data.index(b"endobj", place)]
        self.pages = [one for one in self.objects.values() if b"/Type /Page " in one]
        self.images = [one for one in self.objects.values() if b"/Subtype /Image" in one]

    def drawn(self, page):
        content = self.objects[int(re.search(rb"/Contents (\d+) 0 R", page)[1])]
        return zlib.decompress(content.partition(b"stream\n")[2].rpartition(b"\nendstream")[0]).decode("latin-1")

    def words(self, page):
        return " ".join(re.findall(r"\((.*?)\) Tj", self.drawn(page)))

    def box(self, page):
        return [float(end) for end in re.search(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", page).groups()]


def test_a_picture_as_pdf_is_a_file_of_vectors_of_its_size(reader, pages):
    tab = reader.open(pages("demo"))
    tab.locator("#save-width").select_option("column")
    tab.locator("#figure-ecdf .fold").evaluate("fold => { fold.open = true; }")
    name, path = saved_by(tab, tab.locator("#figure-ecdf [data-save=pdf]").click)
    pdf, height_px = Pdf(path), tab.evaluate("picturesOf(blocks.find(b => b.name === 'ecdf'))[0].layout.height")
    (page,) = pdf.pages
    assert name.startswith("dds-trace-ecdf")
    assert pdf.box(page) == pytest.approx([84 / 25.4 * 72, height_px * 0.75], abs=1.5)
    assert pdf.images == [], "vectors"
    assert "Planned messages, Binary 33" in pdf.words(page)
    assert "\\205" not in pdf.words(page), "no label is cut"
    assert pdf.drawn(page).count(" l\n") > 40, "curves"
    assert reader.complaints == []


def test_the_paper_is_one_click_four_figures_with_captions_and_versions(reader, pages):
    tab = reader.open(pages("study"))
    before = tab.evaluate("JSON.stringify(view)")
    name, path = saved_by(tab, tab.locator("#save-paper").click)
    pdf = Pdf(path)
    words = [pdf.words(page) for page in pdf.pages]
    assert name == "paper.pdf"
    assert {number for one in words for number in re.findall(r"Figure (\d)", one)} == set("1234")
    assert all("dds-trace 0." in one for one in words)
    assert all(pdf.box(page) == [595, 842] for page in pdf.pages)
    assert "Cyclone DDS" in words[0]
    assert "\\256" in words[0], "the arrow between two devices, in the font Symbol"
    assert pdf.images == []
    assert tab.evaluate("JSON.stringify(view)") == before
    assert reader.complaints == []


def test_a_name_that_no_font_of_pdf_has_is_a_picture_of_it(reader, pages):
    tab = reader.open(pages("demo"))
    ops = tab.evaluate("""async () => { const pdf = new Pdf(), page = {ops: "", images: []};
        await pdf.drawSvg(page, '<svg xmlns="http://www.w3.org/2000/svg" width="90" height="20"><text y="12">車 → b</text></svg>', "");
        return [page.images.length, runsOf("a → b (µ)", false)]; }""")
    assert ops == [1, [[0, "a ", "a "], [2, "\\256", "→"], [0, " b \\050\\265\\051", " b (µ)"]]]
