import re
from zipfile import ZipFile

import pytest
from waiting import wait_until

pytestmark = pytest.mark.browser

PAGE_PX, COLUMN_PX = 933, 500  # 247 and 132 mm

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


# [figure, text, px] of texts beyond their picture or on another, ticks that an axis has twice, legends above a fifth of the height.
CUT = """async ({mm, drawn}) => {
    const wrong = [];
    for (const block of blocks.filter(({name}) => !drawn || drawn.includes(name)).filter(block => (block.plan(), block.drawn.data.length)))
        for (const picture of picturesOf(block, "", {mm})) {
            const place = document.body.appendChild(document.createElement("div"));
            place.innerHTML = await svgOf(picture);
            const frame = place.firstElementChild.getBoundingClientRect();
            const isShare = text => /^[\\d.]+ %$/.test(text.textContent) && text.closest(".annotation"); // on its own ground, next to its mark
            const texts = [...place.querySelectorAll("text")].filter(text => !isShare(text));
            const boxes = texts.map(text => [text.textContent, text.getBoundingClientRect()]).filter(([, box]) => box.width);
            const on = (a, b) => Math.min(Math.min(a.right, b.right) - Math.max(a.left, b.left), Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top));
            boxes.forEach(([text, box], at) => {
                const over = Math.max(frame.left - box.left, box.right - frame.right, frame.top - box.top, box.bottom - frame.bottom);
                if (over > 1) wrong.push([block.name, text, Math.round(over)]);
                for (const [other, its] of boxes.slice(at + 1)) if (on(box, its) > 3) wrong.push([block.name, text + " on " + other, Math.round(on(box, its))]);
            });
            for (const key of Object.keys(picture.layout).filter(key => /axis/.test(key) && picture.layout[key].tickmode !== "array")) {
                const ticks = [...place.querySelectorAll(`.${key.replace("axis", "")}tick text`)].map(text => text.textContent);
                if (new Set(ticks).size < ticks.length) wrong.push([block.name, ticks.join(), 0]);
            }
            const legend = place.querySelector(".legend .bg")?.getBoundingClientRect().height || 0;
            if (legend > 0.2 * frame.height) wrong.push([block.name, "legend", Math.round(100 * legend / frame.height)]);
            place.remove();
        }
    return wrong;
}"""


DRAWN = [("small campaign", None), ("demo", None), ("study", ["latency_by_rate", "bridge_cost"])]


@pytest.mark.parametrize(("name", "drawn"), DRAWN)
def test_texts_are_whole_apart_and_once_and_legends_low_in_the_widths_of_print(reader, pages, name, drawn):
    tab = reader.open(pages(name))
    for mm in (84, 174):
        assert tab.evaluate(CUT, {"mm": mm, "drawn": drawn}) == [], mm
    assert reader.complaints == []


@pytest.mark.parametrize(("name", "drawn"), DRAWN[::2])
def test_texts_of_figures_fit_a_phone(read_with, pages, name, drawn):
    one = read_with(viewport={"width": 390, "height": 844})
    assert one.open(pages(name)).evaluate(CUT, {"mm": None, "drawn": drawn}) == []
    assert one.complaints == []


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


@pytest.mark.thorough
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
    assert [one for one in pictures if one[1] > (COLUMN_PX if choice == "column" else PAGE_PX)] == []
    assert [one for one in pictures if one[2]] == []


@pytest.mark.thorough
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
        assert name == f"figures-{kind}.zip"
        with ZipFile(path) as archive:
            assert archive.testzip() is None
            assert len(archive.namelist()) == tab.locator("[data-figure]").count()
            assert all(archive.read(one).startswith(first) for one in archive.namelist())
    name, boxes, _, _ = printed_by(tab, tab.locator("[data-save-all=pdf]").click)
    assert (name, len(boxes)) == ("figures", tab.locator("[data-figure]").count())
    assert reader.complaints == []


def test_latex_has_a_caption_for_each_page_of_the_pdf_and_its_signs_escaped(reader, pages):
    tab = reader.open(pages("demo"))
    assert tab.evaluate("latexOf", "%_&#{}$\\→") == r"\%\_\&\#\{\}\$\textbackslash{}$\to$"
    name, path = saved_by(tab, tab.locator("[data-save-all=tex]").click)
    text = path.read_text(encoding="utf-8")
    assert name == "figures.tex"
    assert [*map(int, re.findall(r"page=(\d+)\]", text))] == [*range(1, 1 + tab.locator("[data-figure]").count())]
    captions = re.findall(r"\\caption\{(.*)\}\n", text)
    assert len(captions) == len(set(re.findall(r"\\label\{(.+)\}", text)))
    assert not [one for one in captions if re.search(r"(?<!\\)[%_&#]", one) or " messages in " not in one]
    assert reader.complaints == []


def printed_by(tab, click):
    tab.evaluate("window.isPrinted = false; window.print = () => { window.isPrinted = true; }; 0")  # 0: no function
    click()
    wait_until(lambda: tab.evaluate("window.isPrinted"))
    name, words = tab.title(), tab.locator(".sheet").all_text_contents()
    data = tab.pdf(prefer_css_page_size=True)
    assert tab.locator("#sheets").count() == 0
    boxes = re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", data)
    return name, [tuple(map(float, box)) for box in boxes], words, data


def test_a_picture_as_pdf_is_a_page_of_vectors_of_its_size_with_its_fonts(reader, pages):
    tab = reader.open(pages("demo"))
    tab.locator("#save-width").select_option("column")
    tab.locator("#figure-ecdf .fold").evaluate("fold => { fold.open = true; }")
    before = tab.title()
    name, boxes, (words,), data = printed_by(tab, tab.locator("#figure-ecdf [data-save=pdf]").click)
    height_px = tab.evaluate("picturesOf(blocks.find(b => b.name === 'ecdf'))[0].layout.height")
    assert name.startswith("dds-trace-ecdf")
    assert tab.title() == before
    assert boxes == [pytest.approx([84 / 25.4 * 72, height_px * 0.75], abs=1.5)]
    assert "Planned messages, Binary 33" in words
    assert b"/Subtype /Image" not in data, "vectors"
    assert b"/FontFile" in data, "a journal wants its fonts in the file"
    assert reader.complaints == []


@pytest.mark.thorough
def test_the_paper_is_four_figures_with_captions_and_versions(reader, pages):
    tab = reader.open(pages("study"))
    before = tab.evaluate("JSON.stringify(view)")
    name, boxes, words, _ = printed_by(tab, tab.locator("#save-paper").click)
    assert name == "paper"
    assert len(boxes) == len(words), "no picture breaks"
    assert {number for one in words for number in re.findall(r"Figure (\d)", one)} == set("1234")
    assert all("dds-trace 0." in one for one in words)
    assert all(box == pytest.approx([595, 842], abs=1) for box in boxes)
    assert "Cyclone DDS" in words[0]
    assert tab.evaluate("JSON.stringify(view)") == before
    assert reader.complaints == []
