import pytest
from four_campaigns import CAMPAIGNS

from dds_trace.reports.book.book import Book
from dds_trace.reports.figures.costs import domain_difference_plan
from dds_trace.reports.figures.figure import MOST_LINES, facet_panels
from dds_trace.reports.figures.lines import LATENCY_BY_RATE, LATENCY_BY_SIZE

pytestmark = pytest.mark.browser

# Every line of every panel as plotly is told to draw it: figure, panel, line, look. A symbol counts only where marks are drawn, a dash
# only where a line is; a hollow mark and a bar crossed out are lost messages, and no look of a line.
LOOKS = """() => blocks.flatMap(({name, drawn}) => drawn.data.filter(t => t.meta).flatMap(t => {
    const one = (values, left) => [...new Set([values].flat().map(left))];
    const looks = t.type === 'bar' ? one(t.marker.pattern?.shape ?? '', s => s).filter(s => s !== 'x') : t.mode.includes('markers') ? one(t.marker.symbol, s => s.replace('-open', '')) : [''];
    const rim = t.type === 'bar' || !t.mode.includes('markers') || t.marker.line.color === t.marker.color ? '' : 'rim';
    return looks.map(look => [name, t.xaxis + t.yaxis, t.meta, [t.marker.color, look, t.type === 'bar' || !t.mode.includes('lines') ? '' : t.line.dash, rim].join()]);
}))"""

LOOKS_A_LINE = {"host_load": 2, "percentile_curve": 2}
"""Figure -> most looks of one line there: the ping's device and the relay's; a curve and the marks on it."""

PANELS = """name => { const { plan } = DATA.figures[name];
    const points = plan.groups.map(group => ({group, value: 1}));
    return spread(chosenFacet(plan.facet), points).map(p => [p.title, p.lines.map(l => [l.option, l.points.map(q => q.x), l.points.map(q => q.group)])]); }"""


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_no_panel_has_more_lines_than_seven_and_each_looks_like_no_other(reader, pages, name):
    tab = reader.open(pages(name))
    for theme in ("light", "dark"):
        tab.evaluate(f"document.documentElement.dataset.theme = '{theme}'")
        tab.evaluate("for (const block of blocks) { block.spoil(); block.plan(); }")
        looks: dict[tuple[str, str], dict[str, set[str]]] = {}
        for figure, panel, line, look in tab.evaluate(LOOKS):
            if figure not in ("breakdown", "wire_cost", "one_way"):  # of parts of a time, not of series
                looks.setdefault((figure, panel), {}).setdefault(line, set()).add(look)
        assert {"domain_difference", "percentile_curve"} <= {figure for figure, _ in looks} or name == "demo"
        for where, lines in looks.items():
            assert len(lines) <= MOST_LINES, where
            told = [look for own in lines.values() for look in own]
            assert len(set(told)) == len(told), (where, lines)
            assert max(map(len, lines.values())) <= LOOKS_A_LINE.get(where[0], 1), (where, lines)
        legends = tab.evaluate(
            "blocks.filter(b => b.drawn.legend).map(b => b.drawn.legend.options.map(o => { const l = lookOf(b.drawn.legend.dimension, o); return [l.color, l.symbol, l.dash, l.tint].join(); }))"
        )
        assert all(len(set(options)) == len(options) for options in legends)
    assert reader.complaints == []


@pytest.mark.thorough
def test_the_page_spreads_groups_as_python_does(reader, pages):
    book = Book(CAMPAIGNS["study"]())
    tab = reader.open(pages("study"))

    def shown(name):
        return [(title, [(o, tuple(x), tuple(g)) for o, x, g in lines]) for title, lines in tab.evaluate(PANELS, name)]

    def told(panels):
        return [(panel.title, [(line.line, line.x, line.groups) for line in panel.lines]) for panel in panels]

    bars = domain_difference_plan(book)
    assert shown("latency_by_rate") == told(LATENCY_BY_RATE.info(book).panels)
    assert shown("latency_by_size") == told(LATENCY_BY_SIZE.info(book).panels)
    assert shown("domain_difference") == told(facet_panels(book, bars["facet"], bars["groups"].__contains__))
    titles = [title for title, _ in shown("latency_by_rate")]
    assert titles[:5] == [
        *(f"{size}, laptop-a → laptop-b, wired" for size in ("33 KB", "145 KB", "1 MB", "4 MB")),
        "33 KB, laptop-a → laptop-b, wireless",
    ]
    tab.locator("#more > summary").click()
    tab.locator("#choose-panels").select_option("device")
    tab.locator("#choose-lines").select_option("link")
    assert shown("latency_by_rate") == told(LATENCY_BY_RATE.info(book, panels="device", lines="link").panels)


@pytest.mark.thorough
def test_the_papers_figures_are_one_click(reader, pages):
    tab = reader.open(pages("study"))
    tab.locator("#paper").click()
    assert tab.evaluate("location.hash") == "#panels=vendor&lines=size"
    drawn = tab.evaluate(
        "(() => { const { drawn } = blocks.find(b => b.name === 'latency_by_rate');"
        " return [drawn.panels, drawn.legend.options.map(o => lookOf(drawn.legend.dimension, o).label)]; })()"
    )
    assert drawn == [24, ["33 KB", "145 KB", "1 MB", "4 MB"]], "2 vendors, 2 ways, 6 places; a line per size"
    first = tab.evaluate("blocks.find(b => b.name === 'latency_by_rate').drawn.titles[0].title")
    assert first.startswith("Fast DDS, laptop-a")
    tab.locator("#paper").click()
    assert tab.evaluate("location.hash") in ("", "#")


def test_losses_are_seen_on_marks_bars_and_curves(reader, pages):
    tab = reader.open(pages("lossy machine"))
    tab.evaluate("for (const block of blocks) block.plan()")
    hollow = """name => blocks.find(b => b.name === name).drawn.data
        .flatMap(t => [t.marker?.symbol].flat().filter(s => s && s.endsWith('-open'))).length"""
    lossy = tab.evaluate("DATA.curves.shares.filter(share => share < 0.99).length")
    assert lossy > 5
    for figure in ("latency_by_rate", "latency_by_size", "vendor_comparison", "received", "relay_time"):
        assert tab.evaluate(hollow, figure) == lossy, figure
    beside = tab.evaluate(
        "blocks.find(b => b.name === 'latency_by_rate').drawn.layout.annotations.filter(a => / %$/.test(a.text)).length"
    )
    assert beside == lossy
    # At 20 Hz zenoh-bridge-dds lost more than half of 4 MB: its bar says so and is no time; the table says lost.
    bars = tab.evaluate(
        "blocks.find(b => b.name === 'domain_difference').drawn.data.flatMap(t => t.text.filter(text => / %$/.test(text)).length)"
    )
    assert sum(bars) == lossy
    rows = tab.evaluate("blocks.find(b => b.name === 'domain_difference').drawn.rows.filter(row => row[5] === 'lost')")
    assert len(rows) >= 4
    assert all(row[3].startswith("Fast DDS, through zenoh-bridge") and row[6] == "lost" for row in rows)
    assert "hollow" in tab.locator("#figure-latency_by_rate .note").text_content()
    columns = tab.evaluate("blocks.find(b => b.name === 'ecdf').drawn.columns.map(c => c.label)")
    assert columns[4] == "Share of planned"


@pytest.mark.thorough
def test_a_legend_switches_a_line_off_and_shows_one_alone(reader, pages):
    tab = reader.open(pages("lossy machine"))
    traces = "blocks.find(b => b.name === 'latency_by_rate').drawn.data.map(t => t.meta)"
    tab.locator("#figure-latency_by_rate .fold").evaluate("fold => { fold.open = true; }")
    reader.draw_all()
    button = tab.locator("#figure-latency_by_rate .legend button").nth(1)
    line = button.get_attribute("data-line")
    assert line in tab.evaluate(traces)
    button.hover()
    faded = "[...document.querySelectorAll('#figure-latency_by_rate .trace')].filter(t => t.style.opacity === '0.15').length"
    assert tab.evaluate(faded) == 6 * 6, "six panels, and of seven lines one stays"
    button.click()
    assert line not in tab.evaluate(traces)
    assert tab.locator(f"#figure-latency_by_size [data-line='{line}']").get_attribute("aria-pressed") == "false"
    tab.locator(f"#figure-latency_by_rate [data-line='{line}']").click()
    assert line in tab.evaluate(traces)


def test_axes_and_titles_say_what_they_show(reader, pages):
    tab = reader.open(pages("500 groups"))
    tab.evaluate("for (const block of blocks) block.plan()")
    tab.locator("#choose-metric").select_option("rtt")
    tab.locator("#choose-statistic").select_option("max")
    tab.evaluate("for (const block of blocks) block.plan()")
    block = "blocks.find(b => b.name === 'latency_by_rate')"
    assert tab.evaluate(f"{block}.title()").endswith("frequency, maximum of all received messages")
    assert tab.evaluate(f"{block}.fileName()") == "dds-trace-by-rate-rtt-max"
    ticks = tab.evaluate(f"{block}.drawn.layout.yaxis.ticktext")
    assert ticks
    assert all(tick.split(" ")[1] in ("ns", "µs", "ms", "s") for tick in ticks)
    upright = "drawn.layout.annotations.find(a => a.textangle === -90).text"
    assert "(log scale)" in tab.evaluate(f"{block}.{upright}")
    received = "blocks.find(b => b.name === 'received')"
    assert tab.evaluate(f"{received}.drawn.layout.yaxis.range[0]") > 0
    assert "axis starts at" in tab.evaluate(f"{received}.{upright}")
    ends = tab.evaluate(f"{block}.drawn.layout.annotations.filter(a => a.x === 1).map(a => a.text)")
    assert {"Fast DDS", "Cyclone DDS, built-in"} <= set(ends)


def test_a_bridge_costs_a_ratio_with_the_difference_beside_it(reader, pages):
    tab = reader.open(pages("lossy machine"))
    tab.evaluate("for (const block of blocks) block.plan()")
    layout = tab.evaluate("blocks.find(b => b.name === 'bridge_cost').drawn.layout")
    assert (layout["yaxis"]["type"], layout["yaxis2"]["type"]) == ("log", "linear")
    assert [a["text"] for a in layout["annotations"] if a["text"].startswith("<b>")] == [
        "<b>Times as long</b>",
        "<b>Difference</b>",
    ]
    assert tab.evaluate("blocks.find(b => b.name === 'breakdown').drawn.layout.yaxis.range") == [0, 100]


def test_a_few_groups_are_one_chart(reader, pages):
    tab = reader.open(pages("demo"))
    names = tab.evaluate("blocks.map(b => b.name)")
    reader.draw_all()
    assert names[0] == "dots"
    assert not {"latency_by_rate", "received", "domain_difference"} & set(names)
    assert tab.locator("#figure-dots .point").count() == 6 + 6, "a dot and a bar of the share received for each group"
    assert " of the same domain" in tab.locator("#figure-dots").text_content()


@pytest.mark.keeps(1)
@pytest.mark.parametrize(("width", "most"), [(1360, 7_000), (390, 12_000)])
def test_a_page_of_126_groups_is_no_longer_than_it_has_to_be(read_with, pages, width, most):
    one = read_with(viewport={"width": width, "height": 900})
    tab = one.open(pages("lossy machine"))
    one.draw_all()
    tab.evaluate("showGroups()")
    assert tab.evaluate("document.documentElement.scrollHeight") <= most
    assert tab.evaluate("document.documentElement.scrollWidth") <= width


@pytest.mark.parametrize(
    ("name", "opened"), [("study", "vendor_comparison"), ("lossy machine", "latency_by_size"), ("demo", "dots")]
)
def test_the_figure_of_what_the_campaign_varies_is_open_and_few_panels_are(reader, pages, name, opened):
    tab = reader.open(pages(name))
    open_ones = tab.evaluate(
        "blocks.filter(b => b.fold.open && b.article.closest('#figures')).map(b => (b.plan(), [b.name, b.drawn.panels]))"
    )
    assert opened in dict(open_ones)
    assert not {"latency_by_rate", "latency_by_size", "vendor_comparison"} & dict(open_ones).keys() - {opened}
    assert max(dict(open_ones).values()) <= 9


@pytest.mark.thorough
def test_controls_are_one_row_and_a_filter_says_what_it_leaves_as_it_is(reader, pages):
    tab = reader.open(pages("study"))
    tops = tab.evaluate(
        "[...document.getElementById('filters').children].filter(e => e.checkVisibility()).map(e => e.getBoundingClientRect().top)"
    )
    assert max(tops) - min(tops) < 12
    assert not tab.locator("#of-all").is_visible()
    tab.locator("#more > summary").click()
    tab.locator("#more [data-filter=link] summary").click()
    tab.get_by_label("wired", exact=True).check()
    assert tab.locator("#of-all").is_visible()
    assert tab.locator(".count").inner_text() == "192 of 384 results"
    assert "active" in tab.locator("#more").get_attribute("class")
