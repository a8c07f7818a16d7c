import re

import pytest
from browser import Reader
from waiting import wait_until

pytestmark = pytest.mark.browser

SHIFTS = """
window.shifted = 0;
new PerformanceObserver(list => {
    for (const entry of list.getEntries()) if (!entry.hadRecentInput) window.shifted += entry.value;
}).observe({type: "layout-shift", buffered: true});
"""


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["demo", "lossy machine"])
def test_links_land_where_they_say_and_nothing_shifts(new_tab, pages, name):
    one = Reader(new_tab)
    one.tab.add_init_script(SHIFTS)
    # A slow reader paints while the page is still being read.
    one.tab.context.new_cdp_session(one.tab).send("Emulation.setCPUThrottlingRate", {"rate": 6})
    tab = one.open(pages(name))
    height, while_read = tab.evaluate("[document.documentElement.scrollHeight, window.shifted]")
    for target in ("table", "figures", "recording", "cell"):
        tab.locator(f"nav a[href='#{target}']").click()
        tab.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")  # it has scrolled
        landed = f"document.getElementById('{target}').getBoundingClientRect().top"
        bottom = tab.evaluate("scrollY + innerHeight >= document.documentElement.scrollHeight - 2")
        first = tab.evaluate(landed)
        tab.evaluate("new Promise(done => setTimeout(done, 300))")
        assert abs(tab.evaluate(landed) - first) < 2, "what is drawn on the way moves nothing"
        assert bottom or -2 < first < 140, target
    # What a click draws is no shift within half a second of it, and on a slow machine comes later.
    clicked = tab.evaluate("window.shifted") - while_read
    tab.evaluate("for (const block of blocks) block.draw()")
    assert abs(tab.evaluate("document.documentElement.scrollHeight") - height) < 100
    assert tab.evaluate("window.shifted") - clicked < 0.05
    assert one.complaints == []


@pytest.mark.parametrize("name", ["demo", "lossy machine"])
def test_the_table_of_sizes_begins_on_the_first_screen(reader, pages, name):
    tab = reader.open(pages(name))
    assert tab.evaluate("document.querySelector('table.sizes').getBoundingClientRect().top") < 1000
    assert tab.locator(".first a[href='#recording']").count() == 1


def test_back_undoes_a_filter_and_closes_a_group(reader, pages):
    tab = reader.open(pages("small campaign"))
    tab.locator("[data-filter=vendor] summary").click()
    tab.get_by_label("Zenoh", exact=True).check()
    count = tab.locator(".count")
    count.filter(has_text="16 of 32 results").wait_for()
    tab.locator(".sizes a[data-group]").first.click()
    tab.locator("dialog#group[open]").wait_for()
    assert "group=" in tab.evaluate("location.hash")
    tab.go_back()
    tab.locator("dialog#group").wait_for(state="hidden")
    assert count.inner_text() == "16 of 32 results"
    tab.go_back()
    count.filter(has_text=re.compile("^32 results$")).wait_for()
    assert reader.complaints == []


def test_a_mark_a_tile_a_row_a_finding_and_the_headline_open_their_group(reader, pages):
    tab = reader.open(pages("lossy machine"))
    title = tab.locator("#group-title")
    worst = tab.evaluate(
        "Array.from({length: DATA.groups.count}, (_, g) => g)"
        ".sort((a, b) => DATA.values.plain.received_ratio[a] - DATA.values.plain.received_ratio[b])[0]"
    )

    def opened(by):
        by()
        tab.locator("dialog#group[open]").wait_for()
        said = title.inner_text()
        figures = tab.locator("#group-figures h3").all_inner_texts()
        assert figures[:2] == tab.evaluate(
            "GROUP_FIGURES.filter(n => DATA.figures[n]).slice(0, 2).map(n => DATA.figures[n].title)"
        )
        assert tab.locator("#group-figures .row").count() == len(tab.locator("#group-figures h3").all()), (
            "one row a figure"
        )
        assert tab.locator("#group-runs tbody tr").count() == 1, "the fixture has the rows of one run of each group"
        tab.keyboard.press("Escape")
        tab.locator("dialog#group").wait_for(state="hidden")
        return said

    headline = opened(tab.locator(".headline a").click)
    assert headline.startswith(tab.evaluate(f"cellOf({worst}).label"))
    links = [int(link.get_attribute("data-group")) for link in tab.locator(".findings a[data-group]").all()[:3]]
    ratio = tab.evaluate("groups => groups.map(g => DATA.values.plain.received_ratio[g])", links)
    assert ratio == sorted(ratio), "worst first"
    row = tab.locator("#groups-table tbody tr").nth(4)
    names = row.locator("td").all_inner_texts()[:4]
    assert opened(row.locator("td").nth(6).click).endswith(names[3])
    assert opened(row.locator("button").click).endswith(names[3])
    for figure in tab.evaluate("blocks.filter(b => b.drawn.data.some(t => t.hovertext)).map(b => b.name)"):
        found = tab.evaluate(
            "name => { const { drawn } = blocks.find(b => b.name === name);"
            " const trace = drawn.data.find(t => t.hovertext && [t.hovertext].flat(2).some(h => h));"
            " const at = t => Array.isArray(t.hovertext[0]) ? [0, t.hovertext[0].findIndex(h => h)] : t.hovertext.findIndex(h => h);"
            " return groupOfPoint({data: trace, pointNumber: at(trace)}); }",
            figure,
        )
        assert found is not None or figure == "clock", figure
    tab.locator("#figure-heatmap .fold").evaluate("fold => { fold.open = true; }")
    tab.evaluate("document.querySelector('#figure-heatmap .plot').scrollIntoView({block: 'center'})")
    tile = tab.locator("#figure-heatmap .plot .row .nsewdrag").first
    tile.wait_for(state="attached")
    assert opened(lambda: tile.click(position={"x": 60, "y": 20}))
    assert reader.complaints == []


def test_the_theme_is_remembered_where_the_browser_allows_it(new_tab, pages):
    one = Reader(new_tab, color_scheme="light")
    tab = one.open(pages("demo"))
    tab.locator("#theme").click()
    allowed = tab.evaluate("remembered()") == "dark"
    one.open(pages("demo"))
    assert tab.evaluate("document.documentElement.dataset.theme") == ("dark" if allowed else "light")
    tab.evaluate("Object.defineProperty(window, 'localStorage', { get() { throw new Error('refused'); } })")
    assert tab.evaluate("remembered('light')") is None
    assert one.complaints == []


def test_a_narrower_window_draws_narrower_figures(reader, pages):
    tab = reader.open(pages("demo"))
    block = "blocks.find(b => b.name === 'timeline')"
    assert tab.evaluate(f"{block}.drawn.layout.width") > 500
    tab.set_viewport_size({"width": 420, "height": 800})
    wait_until(lambda: tab.evaluate(f"{block}.drawn.layout.width") < 420)
    assert tab.evaluate("document.documentElement.scrollWidth") <= 420


@pytest.mark.keeps(1)
@pytest.mark.parametrize(("name", "paper"), [("demo", "A4"), ("lossy machine", "Letter")])
def test_paper_is_whole(reader, pages, name, paper):
    tab = reader.open(pages(name))
    tab.evaluate("document.getElementById('all-columns').click(); void (window.back = toPaper())")
    shown = "[...document.querySelectorAll('%s')].filter((one) => one.getClientRects().length).length"
    assert tab.evaluate(shown % ".figure:has(> .fold:not([open]))") == 0, "a closed heading says nothing on paper"
    assert tab.evaluate(shown % "#figures .figure") >= 2
    assert tab.evaluate(shown % ".findings details[open]") == 0
    room = 703 if paper == "A4" else 725  # px between margins of 12 mm
    over = tab.evaluate(
        "room => [...document.querySelectorAll('main *')].filter(e => e.getClientRects().length && !e.closest('svg, .unseen')"
        " && e.getBoundingClientRect().right > room).map(e => e.outerHTML.slice(0, 90))",
        room,
    )
    assert over == [], "no column sticks out"
    rows = tab.evaluate("[...document.querySelectorAll('.plot .row')].map(row => row.clientHeight)")
    assert rows
    assert max(rows) < 950, "a row of panels fits on a page, and does not break"
    heads = tab.evaluate("[...document.querySelectorAll('#groups-table table')].map(t => t.tHead.innerText)")
    tab.evaluate("back()")
    columns = tab.locator("#groups-table thead th").all_inner_texts()
    assert len(heads) > 1
    assert all(any(column in head for head in heads) for column in columns)
    assert tab.locator("#groups-table table").count() == 1
    assert tab.evaluate("blocks.every(block => block.drawn)")
    assert reader.complaints == []


def test_the_table_is_searched_and_its_first_columns_stay(reader, pages):
    tab = reader.open(pages("lossy machine"))
    tab.locator("#all-columns").check()
    tab.locator("#groups-search").fill("ros2dds 4 MB")
    tab.locator("#groups-found").filter(has_text="3 of 126 results").wait_for()
    assert tab.locator("#groups-table tbody tr").count() == 3
    tab.locator("#groups-search").fill("")
    tab.locator("#groups-table tbody tr").nth(125).wait_for(state="attached")
    place = "document.querySelector('#groups-table tbody td').getBoundingClientRect().left"
    before = tab.evaluate(place)
    tab.evaluate("document.querySelector('#groups-table .scroll').scrollLeft = 600")
    assert tab.evaluate(place) == before


def test_what_is_seen_answers_before_the_rest_is_drawn(reader, pages):
    """The bar in seconds: `just bench-report`. Here: a change draws nothing but rows of panels that can be seen."""
    tab = reader.open(pages("lossy machine"))
    tab.locator("#figure-latency_by_rate, [data-figure]").first.scroll_into_view_if_needed()
    seen, drawn, rows = tab.evaluate(
        "() => { const real = Plotly.react; const drawn = [];"
        " Plotly.react = (row, ...rest) => { drawn.push(row); return real(row, ...rest); };"
        " change(() => { view.statistic = 'p90'; });"
        " Plotly.react = real;"
        " return [drawn.every(isOnScreen), drawn.length, document.querySelectorAll('.plot .row').length]; }"
    )
    assert seen
    assert 0 < drawn < rows / 3


def test_a_browser_that_cannot_unpack_says_so(new_tab, pages):
    one = Reader(new_tab)
    one.tab.add_init_script("delete window.DecompressionStream")
    one.tab.goto(pages("demo"))
    said = one.tab.locator("#cannot-unpack")
    said.wait_for()
    assert "browser of 2023 or later" in said.inner_text()
    assert one.tab.locator(".sizes").count() == 1, "the answer and its table need no script"


@pytest.mark.parametrize(("width", "height"), [(1360, 900), (390, 844)])
def test_verdict_picture_and_best_setup_are_on_the_first_screen(read_with, pages, width, height):
    tab = read_with(viewport={"width": width, "height": height}).open(pages("small campaign"))
    for part in (".headline", ".glance .dot >> nth=0", ".glance .value.strong >> nth=0"):
        box = tab.locator(part).bounding_box()
        assert box["y"] + box["height"] <= height, part
        assert box["x"] + box["width"] <= width, part
    if width > 1000:
        assert tab.locator("table.sizes").first.bounding_box()["y"] < height / 2


@pytest.mark.thorough
def test_p99_is_beside_the_median_by_a_switch_and_both_open_their_result(reader, pages):
    tab = reader.open(pages("study"))
    assert not tab.locator(".p99").first.is_visible()
    tab.get_by_label("p99 next to the median").check()
    assert tab.locator(".p99").first.is_visible()
    tab.locator("table.sizes td a").first.click()
    assert tab.locator("#group").is_visible()


def test_the_page_has_five_sizes_of_type(reader, pages):
    tab = reader.open(pages("small campaign"))
    reader.draw_all()
    sizes = tab.evaluate(
        """() => [...new Set([...document.querySelectorAll("body *")]
            .filter(part => [...part.childNodes].some(node => node.nodeType === 3 && node.data.trim()) && part.checkVisibility())
            .map(part => getComputedStyle(part).fontSize))]"""
    )
    assert sorted(map(float, (size.removesuffix("px") for size in sizes))) == [12, 14, 16, 20, 24]
