"""The page as a reader meets it: Debian's Chromium, headless, driven by Playwright."""

import json
import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
from dataclasses import replace
from functools import partial

import polars as pl
import pytest
from analyses import EVERY_ANALYSIS, HOSTILE, MS, Measured, make_analysis
from browser import AXE_RULES, Reader, violations
from campaigns import write_runs
from card_bags import timer, write
from four_campaigns import CAMPAIGNS
from page_reader import EVERY_PAGE
from pyarrow.parquet import read_schema
from roundtrip_frames import in_runs
from wording import comparison_as

from dds_trace.analyzer.verdicts.job import Job
from dds_trace.base.printable import printable
from dds_trace.base.units import format_duration, format_quantity, format_rate, format_ratio
from dds_trace.extensions.bags.analyze import analyze_topics
from dds_trace.extensions.bags.report import BagReport
from dds_trace.extensions.campaigns.recommend import recommend_settings
from dds_trace.extensions.gates.compare import compare_roundtrips
from dds_trace.extensions.gates.info import comparison_info
from dds_trace.extensions.live.live import Watcher, WatchOptions
from dds_trace.reports.book.book import Book
from dds_trace.reports.reporters import load_reporter

pytestmark = pytest.mark.browser

BYTES_PER_S = {"GB/s": 1e9, "MB/s": 1e6, "KB/s": 1e3, "B/s": 1}


@pytest.mark.keeps(2)
@pytest.mark.parametrize("name", EVERY_PAGE)
def test_every_page_is_drawn_without_a_complaint_or_a_request(reader, pages, name):
    tab = reader.open(pages(name))
    rows, misfits, growth = reader.draw_all_as_planned()
    assert (misfits, growth) == ([], 0)
    assert rows > 5 or name not in CAMPAIGNS
    empty = tab.evaluate("blocks.filter(b => b.drawn.data.length === 0).map(b => b.name)")
    assert empty == []
    assert tab.locator(".figure .plot svg.main-svg").count() >= tab.locator(".figure").count()
    assert tab.locator(".headline").inner_text() != ""
    assert reader.complaints == []
    assert [url for url in reader.requests if not url.startswith(("file:", "data:", "blob:"))] == []


def test_without_a_result_no_heading_and_no_button_is_without_its_part(reader, pages):
    tab = reader.open(pages("empty folder"))
    assert tab.locator("h2:visible").all_inner_texts() == ["What was measured", "The answer"]
    assert tab.locator("button:visible").all_inner_texts() == ["Dark theme"]
    assert not tab.evaluate("isPaper()"), "nothing varies as the paper's figures do"


@pytest.mark.parametrize("width", [390, 1360])
def test_texts_of_the_chart_of_dots_are_level_and_of_one_size(read_with, pages, width):
    one = read_with(viewport={"width": width, "height": 844})
    tab = one.open(pages("demo"))
    one.draw_all()
    texts = "[...document.querySelectorAll('#figure-dots :is(.xtick text, .bartext)')].map(t => t.getAttribute('transform') ?? '')"
    turned = tab.evaluate(texts)
    assert len(turned) >= 2
    assert not [text for text in turned if re.search(r"rotate\((?!0\D)|scale\(0", text)]
    assert tab.evaluate("(e => e.scrollWidth - e.clientWidth)(document.querySelector('#recording .scroll'))") <= 0


def test_without_scripts_no_heading_is_empty_and_no_link_leads_nowhere(chromium, pages):
    tab = chromium.new_page(java_script_enabled=False)
    tab.goto(pages("demo"))
    headings = tab.locator("h2:visible").all_inner_texts()
    assert headings == ["What was measured", "The answer", "How it was recorded"]
    for link in tab.locator("nav a:visible").all():
        assert tab.locator(link.get_attribute("href")).is_visible()
    tab.close()


def test_hostile_strings_stay_text(reader, pages):
    tab = reader.open(pages("hostile strings"))
    reader.draw_all()
    for block in range(tab.locator(".as-table").count()):
        tab.locator(".as-table").nth(block).evaluate("details => { details.open = true; }")
    shown = tab.locator("body").inner_text()
    for text in HOSTILE:
        assert printable(text) in shown
    assert tab.evaluate("window.pwned") is None
    assert tab.locator("img[src=x]").count() == 0
    assert tab.locator("a[href*='evil']").count() == 0, "plotly makes links of <a> in labels"
    assert tab.title() == f"{HOSTILE[0]} - latency report"
    assert reader.complaints == []


def test_a_filter_acts_on_every_figure_and_table_and_on_the_address(reader, pages):
    tab = reader.open(pages("small campaign"))
    reader.draw_all()
    names = tab.evaluate("blocks.map(b => b.name)")
    before = {name: tab.evaluate("n => blocks.find(b => b.name === n).drawn.rows.length", name) for name in names}
    marks_before = reader.marks("vendor_comparison")
    assert marks_before == 32
    tab.locator("[data-filter=vendor] summary").click()
    tab.get_by_label("Zenoh", exact=True).check()
    reader.draw_all()
    after = {name: tab.evaluate("n => blocks.find(b => b.name === n).drawn.rows.length", name) for name in names}
    assert all(0 < after[name] < before[name] for name in names)
    assert reader.marks("vendor_comparison") == 16
    assert tab.locator(".count").inner_text() == "16 of 32 results"
    tab.locator("#groups-table tbody tr").nth(16).wait_for(state="detached")  # the figures in sight come first
    assert tab.locator("#groups-table tbody tr").count() == 16
    assert tab.evaluate("location.hash") == "#vendor=Zenoh"
    tab.locator("#reset").click()
    reader.draw_all()
    assert reader.marks("vendor_comparison") == marks_before
    assert reader.complaints == []


def test_a_linked_view_opens_as_it_was(reader, pages):
    tab = reader.open(
        pages("small campaign") + "#vendor=Zenoh&domain=same&metric=rtt&statistic=p99&cell=IMU+296+B+at+20+Hz"
    )
    assert tab.locator(".count").inner_text() == "8 of 32 results"
    assert tab.locator("#choose-metric").input_value() == "rtt"
    assert tab.locator("#choose-statistic").input_value() == "p99"
    assert tab.locator("#choose-cell option:checked").inner_text() == "IMU 296 B at 20 Hz"
    tab.evaluate("location.hash = '#vendor=Fast+DDS'")
    tab.locator(".count").filter(has_text="16 of 32 results").wait_for()
    assert tab.locator("#choose-metric").input_value() == "latency"


def test_a_link_within_the_page_keeps_the_view_and_opens_its_finding(reader, pages):
    tab = reader.open(pages("small campaign") + "#vendor=Zenoh")
    finding = tab.locator("#warning-size_step")
    assert finding.get_attribute("open") is None
    tab.locator(".counts a", has_text="Size step").click()
    assert finding.get_attribute("open") is not None
    assert tab.evaluate("document.activeElement.parentElement.id") == "warning-size_step"
    assert tab.evaluate("location.hash") == "#vendor=Zenoh"
    assert tab.locator(".count").inner_text() == "16 of 32 results"


@pytest.mark.parametrize("viewport", [(1280, 800), (390, 844)])
def test_the_first_screen_says_what_was_measured_what_came_out_and_what_is_doubtful(read_with, pages, viewport):
    width, height = viewport
    one = read_with(viewport={"width": width, "height": height})
    tab = one.open(pages("small campaign"))
    seen = [".headline", ".counts .warning", ".counts .info", ".brief" if width < 960 else ".measured dl"]
    for part in seen:
        box = tab.locator(part).bounding_box()
        assert box is not None, part
        assert box["y"] + box["height"] <= height, part
    assert tab.evaluate("document.documentElement.scrollWidth") <= width, "nothing sticks out to the side"


def test_a_recommendation_stands_first_and_does_not_stick_out_on_a_phone(read_with, show):
    analysis = EVERY_ANALYSIS["small campaign"]()
    rows = [(ns, 5000 + place * 100) for place, ns in enumerate((MS, 40 * MS))]
    frame = pl.concat(
        in_runs([ns + n * 37 % 101 for n in range(300)], run_id=run_id, setting=f"a_long_setting={run_id},tuned=true")
        for ns, run_id in rows
    )
    recommendation = recommend_settings(frame, Job("binary", 33_000, 10.0, 50 * MS, 0.9))
    details = replace(analysis.details, recommendation=recommendation)
    page = load_reporter("html").render(Book(replace(analysis, details=details)))
    one = read_with(viewport={"width": 390, "height": 844})
    tab = one.open(show(page))
    assert "the deadline of 50\N{NO-BREAK SPACE}ms" in tab.locator(".headline").first.inner_text()
    assert [text[0] for text in tab.locator(".advice li").all_inner_texts()] == ["✓", "✗"]
    assert tab.evaluate("document.documentElement.scrollWidth") <= 390


def test_an_address_with_nonsense_shows_everything(reader, pages):
    tab = reader.open(pages("small campaign") + "#vendor=nobody&metric=__proto__&cell=x&%%%")
    assert tab.locator(".count").inner_text() == "32 results"
    assert reader.complaints == []


def test_metric_and_statistic_change_the_numbers(reader, pages):
    tab = reader.open(pages("small campaign"))
    reader.draw_all()
    value = "blocks.find(b => b.name === 'vendor_comparison').drawn.rows.find(row => row[1] === 33000)[4]"
    median = tab.evaluate(value)
    tab.locator("#choose-statistic").select_option("p99")
    reader.draw_all()
    assert tab.evaluate(value) > median
    tab.locator("#choose-metric").select_option("intermediate")
    reader.draw_all()
    assert tab.evaluate(value) == 81_650, "the relay of this campaign takes 80 µs and 50 ns per KB"
    tab.locator("#choose-statistic").select_option("p99_9")
    reader.draw_all()
    assert "too few messages" in tab.locator("#figure-vendor_comparison .note").text_content()


@pytest.fixture(scope="module")
def lossy_report():
    ramp = [MS + 10_000 * number for number in range(40)]
    bridged = [*ramp[:30], *["lost_return"] * 10]
    others = (Measured(ramp[:1], rate_hz=float(rate)) for rate in range(11, 23))  # too many for the chart of dots
    analysis = make_analysis(
        Measured(ramp), Measured(bridged, bridge="builtin", domain_mode="different", unsent=10), *others
    )
    return load_reporter("html").render(Book(analysis))


@pytest.fixture
def lossy_page(show, lossy_report):
    return show(lossy_report)


def drawn(reader, name):
    return reader.tab.evaluate(
        "n => { const d = blocks.find(b => b.name === n).drawn;"
        " return d.rows.map(row => Object.fromEntries(d.columns.map((c, place) => [c.label, row[place]]))); }",
        name,
    )


def test_the_ecdf_is_of_the_planned_messages(reader, lossy_page):
    reader.open(lossy_page)
    reader.draw_all()
    last_shares = {row["Setup"]: (row["Share of planned"], row["Share of received"]) for row in drawn(reader, "ecdf")}
    assert last_shares == {"Fast DDS, same domain": (100, 100), "Fast DDS, through our built-in bridge": (60, 100)}
    assert reader.tab.locator("#figure-ecdf .annotation-text", has_text="messages, ").count() == 1
    medians = {row["Setup"]: row["Latency"] for row in drawn(reader, "ecdf") if row["Share of planned"] == 30}
    assert medians == {"Fast DDS, same domain": 1_110_000, "Fast DDS, through our built-in bridge": 1_140_000}
    assert reader.complaints == []


def test_tables_say_what_their_numbers_rest_on_and_what_was_received(reader, lossy_page, sentences):
    tab = reader.open(lossy_page)
    reader.draw_all()
    tab.locator("#all-columns").check()
    heads = tab.locator("#groups-table thead th").all_inner_texts()
    rows = {
        cells[3]: dict(zip(heads, cells, strict=True))
        for line in tab.locator("#groups-table tbody tr").all()
        for cells in [line.locator("td").all_inner_texts()]
    }
    assert "p99 95 % high" not in heads, "none has it, and a column of dashes is left out"
    bridged = rows["Fast DDS, through our built-in bridge"]
    counts = ("Runs", "Planned", "Sent", "Unsent", "Received")
    assert [bridged[name] for name in counts] == ["1", "50", "40", "10", "60 %"]
    for tail in ("p90", "p99", "p99.9"):
        assert bridged[f"{tail} interval"].startswith("rests on 1 run ("), tail
    assert "burst" in bridged["p90 interval"]
    (cost,) = drawn(reader, "bridge_cost")
    assert (cost["Received"], cost["Runs"]) == ("100 % → 75 %", "3 and 3")  # made without rows of what was never sent
    (pair,) = drawn(reader, "domain_difference")
    assert pair["Received"] == "100 % → 60 %"
    (of_size,) = {row["Interval"] for row in drawn(reader, "vendor_comparison")} - {""}
    assert of_size.startswith("rests on 1 run (")
    sentences(bridged["p90 interval"], of_size)
    assert reader.complaints == []


def test_tables_sort_by_number(reader, pages):
    tab = reader.open(pages("small campaign"))
    medians = EVERY_ANALYSIS["small campaign"]().summary["latency_p50_ns"]
    tab.locator("#all-columns").check()
    heading = tab.locator("#groups-table th", has_text="Latency median")
    place = tab.locator("#groups-table th").all_inner_texts().index("Latency median")
    first = tab.locator("#groups-table tbody tr").first.locator("td").nth(place)
    heading.get_by_role("button").click()
    assert heading.get_attribute("aria-sort") == "ascending"
    assert first.inner_text() == format_duration(medians.min())
    heading.get_by_role("button").press("Enter")
    assert heading.get_attribute("aria-sort") == "descending"
    assert first.inner_text() == format_duration(medians.max())


@pytest.mark.parametrize(("descending", "order"), [(False, ["2", "10", "-"]), (True, ["10", "2", "-"])])
def test_missing_values_stay_last(reader, pages, descending, order):
    tab = reader.open(pages("one message"))
    shown = tab.evaluate(
        """descending => {
            const place = document.body.appendChild(element("div"));
            showTable(place, "t", [{label: "x"}], [[10], [null], [2]], {sorting: {column: 0, descending}});
            return [...place.querySelectorAll("td")].map(cell => cell.textContent);
        }""",
        descending,
    )
    assert shown == order


def test_the_keyboard_is_enough(reader, pages):
    tab = reader.open(pages("small campaign"))
    tab.locator("[data-filter=data] summary").focus()
    tab.keyboard.press("Enter")
    tab.keyboard.press("Tab")
    tab.keyboard.press("Space")
    assert tab.evaluate("location.hash") == "#data=binary"
    tab.keyboard.press("Escape")
    assert tab.locator("[data-filter=data]").get_attribute("open") is None
    assert tab.evaluate("document.activeElement.textContent") == "Data: Binary"


@pytest.mark.thorough
def test_figures_download(reader, pages):
    tab = reader.open(pages("small campaign"))
    reader.draw_all()  # a figure that is drawn when it is scrolled to would move the button away from the pointer
    saved = {}
    names = {"latency_by_size": "by-size-latency-p50", "heatmap": "heatmap", "timeline": "timeline"}
    for figure, name in names.items():
        tab.locator(f"#figure-{figure} .fold").evaluate("fold => { fold.open = true; }")
        for kind in ("csv", "svg", "png"):
            with tab.expect_download() as download:
                tab.locator(f"#figure-{figure} [data-save={kind}]").click()
            assert download.value.suggested_filename == f"dds-trace-{name}.{kind}"
            saved[kind] = download.value.path().read_bytes()
        assert saved["csv"].decode("utf-8-sig").startswith('"Data","Size (bytes)","Rate (Hz)","Setup"')
        assert saved["svg"].startswith(b"<svg")
        assert saved["png"].startswith(b"\x89PNG")
    assert reader.complaints == []


def test_csv_has_no_formula(reader, pages):
    tab = reader.open(pages("hostile strings"))
    for text in ("=1+1", "+1", "-1", "@SUM(A1)", "\t=1", " =1"):
        assert tab.evaluate("text => csvField(text)", text) == f'"\'{text}"'
    assert tab.evaluate("csvField('a\"b')") == '"a""b"'
    assert tab.evaluate("csvField(-1.5)") == "-1.5"
    assert tab.evaluate("csvField(null)") == ""


def test_page_and_python_write_numbers_alike(reader, pages):
    tab = reader.open(pages("one message"))
    values = [0, 7, 812, 999.4, 999.6, 1000, 1254, 999_600, 1.254e6, 1.2e8, 6.1e10, -383_000, 99_999.5, 0.004]
    for name, function in (
        ("formatNs", format_duration),
        ("formatHz", format_rate),
        ("formatBytesPerS", partial(format_quantity, units=BYTES_PER_S)),
    ):
        assert tab.evaluate(f"values => values.map({name})", values) == [function(value) for value in values]
    ratios = [0, 1, 0.5, 0.99999, 0.00001, 0.9967, 0.123456]
    assert tab.evaluate("values => values.map(formatRatio)", ratios) == [format_ratio(value) for value in ratios]
    assert tab.evaluate("[formatNs(null), formatRatio(null), formatCount(null)]") == ["-", "-", "-"]


def test_dark_follows_the_system_and_the_button(read_with, pages):
    one = read_with(color_scheme="dark")
    tab = one.open(pages("small campaign"))
    ground = "getComputedStyle(document.body).backgroundColor"
    dark = tab.evaluate(ground)
    assert tab.locator("#theme").inner_text() == "Light theme", "a button says what it does"
    tab.locator("#theme").click()
    assert tab.evaluate(ground) != dark
    assert tab.locator("#theme").inner_text() == "Dark theme"
    assert one.complaints == []


def printed_lines(tab, path):
    """The lines of each page on A4, from the top: where each begins and ends, of the width, and its text."""
    path.write_bytes(tab.pdf(format="A4"))
    found = subprocess.run(["pdftotext", "-bbox-layout", path, "-"], capture_output=True, text=True, check=True).stdout
    for page in ET.fromstring(found.replace(' xmlns="', ' was="')).iter("page"):
        width, lines = float(page.get("width")), sorted(page.iter("line"), key=lambda line: float(line.get("yMax")))
        ends = [[float(line.get(end)) / width for end in ("xMin", "xMax")] for line in lines]
        yield [(*at, " ".join(word.text for word in line.iter("word"))) for at, line in zip(ends, lines, strict=True)]


@pytest.mark.keeps(1)
@pytest.mark.skipif(
    shutil.which("pdftotext") is None, reason="pdftotext is not installed (apt-get install poppler-utils)"
)
@pytest.mark.parametrize(("name", "most"), [("small campaign", 20), ("demo", 8), ("study", 20)])
def test_print_is_few_pages_without_an_empty_column_or_a_heading_alone(reader, pages, tmp_path, name, most):
    tab = reader.open(pages(name))
    printed = list(printed_lines(tab, tmp_path / "printed.pdf"))
    assert 3 <= len(printed) <= most
    headings = {" ".join(text.split()) for text in tab.locator("h2, h3").all_text_contents()}
    assert [lines[-1] for lines in printed if lines[-1][2] in headings] == [], "a heading is alone at the end of a page"
    ends = [(min(left for left, _, _ in lines), max(right for _, right, _ in lines)) for lines in printed[:-1]]
    assert [end for end in ends if not end[0] < 0.5 < end[1]] == [], "a column is empty"
    tab.evaluate("void (window.back = toPaper())")
    assert tab.evaluate("document.querySelector('.findings')?.clientHeight ?? 0") <= 2 * 1032, "px of two pages"
    tab.evaluate("back()")
    assert tab.locator("#groups-table tbody tr").count() > 0
    assert tab.evaluate("blocks.every(block => block.drawn)")
    assert reader.complaints == []


def test_the_menu_leads_to_every_section_on_a_phone(read_with, pages):
    one = read_with(viewport={"width": 390, "height": 844})
    tab = one.open(pages("small campaign"))
    links = tab.locator("nav a").all()
    assert [link.inner_text() for link in links] == [
        "Findings",
        "My job",
        "Figures",
        "One message",
        "Table",
        "Recording",
    ]
    for link in links:
        box = link.bounding_box()
        assert 0 <= box["x"] <= box["x"] + box["width"] <= 390
        link.click()
        top = "id => document.querySelector(id).getBoundingClientRect().top"
        assert -1 <= tab.evaluate(top, link.get_attribute("href")) < 844 / 2 or link is links[-1]


AXE_PAGES = [
    ("small campaign", "light", 1360),
    ("small campaign", "dark", 1360),
    ("small campaign", "light", 420),
    ("hostile strings", "light", 1360),
    ("empty folder", "light", 1360),
    ("demo", "light", 420),
    ("lossy machine", "dark", 1360),
]

# Rows with the same elements, classes and styles have the same contrasts, which take most of axe's time.
ONE_ROW_OF_A_KIND = """for (const body of document.querySelectorAll("tbody")) {
    const kinds = new Set();
    for (const [place, row] of [...body.rows].entries()) {
        const parts = [row, ...row.querySelectorAll("*")].map(e => e.localName + e.getAttribute("class") + e.getAttribute("style"));
        const kind = [place % 2, ...parts].join();
        if (kinds.has(kind)) row.remove();
        kinds.add(kind);
    }
}"""


@pytest.mark.keeps(1)
@pytest.mark.parametrize(("name", "scheme", "width"), AXE_PAGES)
def test_axe_finds_nothing_against_wcag_aa(read_with, pages, name, scheme, width):
    """Contrasts of rows that look alike are left to the slow test, which takes each of them."""
    tab = opened_for_axe(read_with, pages(name), scheme, width)
    assert violations(tab, OUTSIDE_PLOTS, f"{AXE_RULES}, rules: {{'color-contrast': {{enabled: false}}}}") == []
    tab.evaluate(ONE_ROW_OF_A_KIND)
    assert violations(tab, OUTSIDE_PLOTS, "['color-contrast']") == []


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    ("name", "scheme", "width"),
    [
        *AXE_PAGES,
        *((name, "light", 1360) for name in ("lossy machine", "study", "500 groups")),
        *((name, "dark", 420) for name in ("lossy machine", "study", "500 groups")),
    ],
)
def test_axe_finds_nothing_in_any_row(read_with, pages, name, scheme, width):
    assert violations(opened_for_axe(read_with, pages(name), scheme, width), OUTSIDE_PLOTS) == []


# Each plot has a label and a table, and thousands of marks that axe has no rule for.
OUTSIDE_PLOTS = "{exclude: ['.plot svg']}"


def opened_for_axe(read_with, address, scheme, width):
    one = read_with(color_scheme=scheme, viewport={"width": width, "height": 900})
    tab = one.open(address)
    one.draw_all()
    tab.evaluate(
        "for (const details of document.querySelectorAll("
        "'.first details, #recording details, #figure-heatmap details, .filter:first-child')) details.open = true"
    )
    return tab


@pytest.mark.keeps(1)
@pytest.mark.parametrize("name", ["lossy machine", "study"])
@pytest.mark.parametrize(("scheme", "width"), [("light", 1360), ("dark", 420)])
def test_axe_finds_nothing_in_the_first_screen_of_a_campaign_with_losses(read_with, pages, name, scheme, width):
    one = read_with(color_scheme=scheme, viewport={"width": width, "height": 900})
    tab = one.open(pages(name))
    tab.evaluate("for (const details of document.querySelectorAll('.first details')) details.open = true")
    assert violations(tab, "{include: ['.first']}") == []
    assert tab.evaluate("document.documentElement.scrollWidth") <= width, "nothing sticks out to the side"
    assert tab.locator(".sizes .lost").count() > 0
    assert tab.locator(".headline").inner_text().partition("% of the messages were lost")[1]


@pytest.mark.parametrize(("scheme", "width"), [("light", 1360), ("dark", 420)])
def test_the_page_of_a_comparison_is_as_clean_and_keeps_the_theme(read_with, chromium, tmp_path, scheme, width):
    places = {"bridge": "builtin", "domain_mode": "different"}, {"payload_bytes": 7}
    base, new = (
        pl.concat([in_runs([MS, None, MS], **places[0]), *(in_runs([ms] * 40, **one) for one in places)])
        for ms in (MS, 2 * MS)
    )
    found = compare_roundtrips(base, new)
    path = tmp_path / "compared.html"
    path.write_text(comparison_as("html", comparison_info(found)), encoding="utf-8")
    one = read_with(color_scheme=scheme, viewport={"width": width, "height": 900})
    one.tab.goto(path.as_uri())
    tab = one.tab
    tab.evaluate("for (const details of document.querySelectorAll('details')) details.open = true")
    assert violations(tab, "document") == []
    assert tab.evaluate("document.documentElement.scrollWidth") <= width, "nothing sticks out to the side"
    assert tab.locator("tr svg.curve").count() == 2 * 2
    ground = "getComputedStyle(document.body).backgroundColor"
    before = tab.evaluate(ground)
    tab.locator("#theme").click()
    assert tab.evaluate(ground) != before
    assert (one.complaints, one.requests) == ([], [path.as_uri()])
    without_scripts = chromium.new_page(java_script_enabled=False)
    without_scripts.goto(path.as_uri())
    assert not without_scripts.locator("#theme").is_visible(), "no dead button"
    without_scripts.close()


@pytest.mark.parametrize("width", [390, 1280])
def test_names_of_topics_are_whole_on_a_phone(read_with, show, tmp_path, width):
    topics = ["/imu", "/robot_1/front_left_camera/image_rect_color/compressed", "/" + "very_long_name" * 6]
    bag = write(tmp_path / "x.mcap", {name: timer(20, 30, without=[(5, 7)]) for name in topics})
    one = read_with(viewport={"width": width, "height": 800})
    one.tab.goto(show(load_reporter("html").render(BagReport(analyze_topics(bag)))))
    script = "all => all.map(cell => [cell.firstChild.data, cell.getBoundingClientRect().right, cell.scrollWidth - cell.clientWidth])"
    cells = one.tab.locator("tbody th, .row-note").evaluate_all(script)
    assert [text.strip() for text, *_ in cells if text.strip().startswith("/")] == topics
    assert [text for text, right, hidden in cells if right > width or hidden > 0] == []
    assert one.tab.evaluate("document.documentElement.scrollWidth") == width
    assert (violations(one.tab, "document"), one.complaints) == ([], [])


def test_all_results_are_saved_as_parquet_and_csv(reader, pages):
    tab = reader.open(pages("demo"))
    with tab.expect_download() as download:
        tab.locator("#save-parquet").click()
    assert download.value.suggested_filename == "summary.parquet"
    assert pl.read_parquet(download.value.path()).equals(CAMPAIGNS["demo"]().summary)
    described = read_schema(download.value.path())
    assert described.field("latency_p50_ns").metadata[b"unit"] == b"ns"
    assert all(field.metadata[b"meaning"] for field in described)
    with tab.expect_download() as download:
        tab.locator("#save-groups").click()
    assert download.value.suggested_filename == "dds-trace-groups.csv"
    lines = download.value.path().read_text(encoding="utf-8-sig").splitlines()
    assert len(lines) == 1 + 6
    assert lines[0].startswith('"Data","Size (bytes)","Rate (Hz)","Setup","Runs"')


def test_a_watched_page_is_renewed_in_place(reader, tmp_path):
    write_runs(tmp_path, [1])
    watcher = Watcher(WatchOptions(tmp_path))
    with watcher.serving():
        watcher.refresh()
        tab = reader.open(watcher.address + "#metric=rtt")
        tab.evaluate("window.loaded = 'once'")
        tab.evaluate("lookForNewer()")
        tab.locator("#theme").click()
        tab.evaluate("document.querySelector('#recording details').open = true")
        tab.locator("#groups-search").fill("binary")
        tab.evaluate("document.getElementById('table').scrollIntoView()")
        top = "document.getElementById('table').getBoundingClientRect().top"
        before = tab.evaluate(top)
        (tmp_path / "state.json").write_text(
            json.dumps({"cells": {"a": {"status": "complete"}}, "planned": 3, "left_s": 360})
        )
        write_runs(tmp_path, [2])
        watcher.refresh()
        tab.evaluate("lookForNewer()")
        tab.locator(".measured", has_text="in 2 runs").wait_for(state="attached")
        assert tab.evaluate("window.loaded") == "once", "no reload"
        assert tab.evaluate("DATA.runs.length") == 2
        assert abs(tab.evaluate(top) - before) < 2, "the scroll stays"
        assert tab.evaluate("document.documentElement.dataset.theme") == "dark"
        assert tab.evaluate("document.querySelector('#recording details').open")
        assert tab.locator("#groups-search").input_value() == "binary"
        assert tab.locator("#choose-metric").input_value() == "rtt"
        done, ago, left = tab.locator("#progress").inner_text().split(", ")
        assert done == "1 of 3"
        assert re.fullmatch(r"about [56] min left", left)
        assert re.fullmatch(r"\d+ s ago", ago)
        tab.locator("#choose-statistic").select_option("p90")
        assert "statistic=p90" in tab.evaluate("location.hash"), "the renewed page answers"
        assert reader.complaints == []
        assert all(url.startswith((watcher.address, "data:")) for url in reader.requests)


FIRST_PAINT = """() => new Promise(resolve => new PerformanceObserver(list => {
    const painted = list.getEntriesByName("first-contentful-paint");
    if (painted.length) resolve(painted[0].startTime);
}).observe({type: "paint", buffered: true}))"""


@pytest.mark.thorough
def test_a_campaign_of_the_paper_paints_as_soon_as_a_page_of_one_message(chromium, pages):
    """Nothing is drawn from its rows before; in turns and the quickest of each, since other programs share the machine."""
    painted_ms = {"one message": [], "500 groups": []}
    for name in (*painted_ms,) * 3:
        one = Reader(chromium.new_page())
        one.tab.goto(pages(name))
        painted_ms[name].append(one.tab.evaluate(FIRST_PAINT))
        one.tab.context.close()
    assert min(painted_ms["500 groups"]) < 4 * min(painted_ms["one message"])
