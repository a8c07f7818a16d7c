import json
import webbrowser
from dataclasses import replace
from functools import cache

import pytest
from analyses import HOSTILE, Measured, make_analysis
from four_campaigns import CAMPAIGNS
from visible_text import Page

from dds_trace import OptionError, compare
from dds_trace.extensions.live.notebook import MOST_CHARACTERS, first_screen
from dds_trace.extensions.live.plotting import NAMES
from dds_trace.reports.book.book import Book
from dds_trace.reports.figures.table import drawn_figures

HARMLESS = {
    *("div", "p", "b", "br", "ul", "li", "table", "caption", "thead", "tbody", "tr", "th", "td", "span", "code")
}


def test_the_first_screen_has_the_table_and_takes_the_grounds_own_colours():
    text = CAMPAIGNS["demo"]()._repr_html_()
    screen = Page(text)
    assert screen.open == []
    assert {"b", "table"} <= set(screen.tags) <= HARMLESS
    # The ground and the ink are the notebook's own, light or dark.
    styles = screen.values("style")
    assert not any("background" in style for style in styles)
    assert {style for style in styles if "color" in style} <= {"color:#e5484d"}
    assert "569 µs / 828 µs" in screen.text


@cache
def of_500_with_itself():
    campaign = CAMPAIGNS["500 groups"]()
    return compare(campaign, campaign)


@pytest.mark.thorough
def test_25_cells_of_the_largest_campaigns_stay_below_300_kb():
    first, second = CAMPAIGNS["study"](), CAMPAIGNS["500 groups"]()
    both = compare(first, first), of_500_with_itself()
    outputs = [(repr(shown), shown._repr_html_()) for shown in (first, second, *both)]
    assert max(len(text) for text, _ in outputs) <= 300
    assert len(repr(first.details)) <= 4000
    for text, html in outputs:
        cell = {"data": {"text/plain": [text], "text/html": html.splitlines(keepends=True)}}
        assert 25 * len(json.dumps(cell, ensure_ascii=False).encode()) < 300_000
        assert Page(html).open == []


def test_a_comparison_shows_its_answer_a_row_a_result_and_what_is_left_out():
    campaign = CAMPAIGNS["500 groups"]()
    html = of_500_with_itself()._repr_html_()
    text = " ".join(Page(html).texts)
    assert text.startswith("Both sides are the same recordings")
    rows = html.count("<tr ")
    assert html.count("<svg") == 1
    assert f"And {len(campaign.summary) - rows} more results." in text
    apart = compare(campaign, make_analysis(Measured([1_000_000] * 3, payload_bytes=77)))
    assert "no result in common" in apart._repr_html_()
    assert "<table" not in apart._repr_html_()


def test_what_does_not_fit_is_counted():
    places = [f"a-device-with-the-name-{number}" for number in range(60)]
    analysis = make_analysis(
        *(
            Measured([1_000_000] * 3, ping_device=place, relay_device=place, payload_bytes=size)
            for place in places
            for size in (1000, 2000, 3000)
        )
    )
    text = analysis._repr_html_()
    assert len(text) <= MOST_CHARACTERS
    assert Page(text).open == []
    shown = sum(f"{place}," in text or f"{place}<" in text for place in places)
    assert f"And {60 - text.count('<tbody>')} more links." in text
    assert shown


def test_strings_of_traces_stay_strings_and_short():
    hostile = make_analysis(
        Measured([1_000_000] * 3, bridge="".join(HOSTILE), domain_mode="different"), title="".join(HOSTILE) * 90
    )
    text = first_screen(hostile)
    assert "<script" not in text
    assert len(text) <= MOST_CHARACTERS
    assert first_screen(replace(hostile, title="")).startswith("<div>")


def plotted():
    """Two sizes and rates on two devices, with and without a bridge, which loses one message in four of the large size."""
    lossy = [2_000_000, 3_000_000, 4_000_000, "lost_outbound"]
    return make_analysis(
        *(
            Measured(
                lossy if bridge == "builtin" and size == 1_000_000 else [factor * (1_000_000 + size)] * 4,
                ping_device=device,
                relay_device=device,
                bridge=bridge,
                domain_mode="same" if bridge == "none" else "different",
                payload_bytes=size,
                rate_hz=rate,
            )
            for device, factor in (("pi3", 3), ("pi4", 1))
            for bridge in ("none", "builtin")
            for size in (33_000, 1_000_000)
            for rate in (5.0, 10.0)
        )
    )


def test_a_figure_has_the_panels_names_and_numbers_of_the_report():
    analysis = plotted()
    figure = analysis.plot("latency_by_size", panels="device", statistic="p50")
    assert [note.text for note in figure.layout.annotations] == ["pi3, 5 Hz", "pi4, 5 Hz", "pi3, 10 Hz", "pi4, 10 Hz"]
    same, bridged, *rest = figure.data
    assert len(rest) == 2 * 4 - 2
    assert [trace.name for trace in figure.data if trace.showlegend] == [same.name, bridged.name]
    assert bridged.name.endswith("through our built-in bridge")
    rows = analysis.summary.filter(ping_device="pi3", rate_hz=5.0).sort("payload_bytes")
    for trace, bridge in ((same, "none"), (bridged, "builtin")):
        own = rows.filter(bridge=bridge)
        assert list(trace.x) == own["payload_bytes"].to_list()
        assert list(trace.y) == [value / 1e6 for value in own["latency_p50_ns"]]
    assert bridged.marker.opacity == (1.0, 0.35), "what lost messages is faded"
    assert "75 % received" in bridged.hovertext[1]
    assert figure.layout.xaxis.ticktext == ("33 KB", "1 MB")
    by_rate = analysis.plot("latency_by_rate", metric="rtt", panels="bridge")
    assert by_rate.layout.yaxis.title.text.startswith("Round trip, median of all")
    assert {note.text.split(", ")[0] for note in by_rate.layout.annotations} == {
        "same domain",
        "through our built-in bridge",
    }


def lines_of_page(analysis):
    """Name -> plan of every figure of lines or marks that the page has."""
    made, _ = drawn_figures(Book(analysis))
    return {figure.name: plan for figure, plan in made if figure.kind == "lines"}


def test_every_figure_of_lines_on_the_page_is_plotted_with_the_same_groups():
    analyses = plotted(), CAMPAIGNS["lossy machine"]()
    of_page = [lines_of_page(analysis) for analysis in analyses]
    assert set().union(*of_page) == set(NAMES)
    for analysis, plans in zip(analyses, of_page, strict=True):
        for name, plan in plans.items():
            figure = analysis.plot(name)
            assert sum(len(trace.x) for trace in figure.data) == len(plan["groups"]), name
            assert len({trace.legendgroup for trace in figure.data}) > 1, name


def test_figures_of_other_things_than_times_show_them_in_their_unit():
    analysis = plotted()
    lossy = 4  # of 16 groups, three in four came back
    assert sorted(value for trace in analysis.plot("received").data for value in trace.y)[:lossy] == [75] * lossy
    kept = [value for trace in analysis.plot("sustainable").data for value in trace.y]
    assert min(kept) == pytest.approx(75)
    assert all(line.mode == "markers" for line in analysis.plot("received").data)
    rates = analysis.plot("transfer_by_size", panels="device")
    assert rates.layout.yaxis.title.text == "Transfer rate (MB/s)"
    expected = sorted(analysis.summary["transfer_rate_bytes_per_s"] / 1e6)
    assert sorted(value for trace in rates.data for value in trace.y) == pytest.approx(expected)
    relay = analysis.plot("relay_time", metric="rtt")
    assert relay.layout.yaxis.title.text.startswith("Time in relay, median"), "its times are always those"
    places = analysis.plot("by_device").layout.xaxis
    assert list(places.tickvals) == [0, 1]
    assert [text.split(",")[0] for text in places.ticktext] == ["pi3", "pi4"]


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"name": "latency"}, "no figure 'latency'; choose from latency_by_rate, latency_by_size"),
        ({"name": "latency_by_size", "panels": "colour"}, "no panels 'colour'; choose from size, rate, device"),
        ({"name": "latency_by_size", "metric": "lag"}, "no metric 'lag'"),
        ({"name": "latency_by_size", "statistic": "p98"}, "no statistic 'p98'"),
        ({"name": "latency_by_size"}, "no data type was measured with two message sizes at one rate"),
        ({"name": "received"}, "every message was received"),
        ({"name": "vendor_comparison", "statistic": "p99_9"}, "no result has a value of"),
    ],
)
def test_what_cannot_be_drawn_is_one_line(how, said):
    alone = make_analysis(Measured([1_000_000] * 3))
    with pytest.raises(OptionError, match=said):
        alone.plot(**how)


def test_show_writes_the_report_and_opens_it(tmp_path, monkeypatch):
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    path = CAMPAIGNS["demo"]().show(tmp_path / "new")
    assert path == tmp_path / "new" / "report.html"
    assert opened == [path.as_uri()]
    assert "<!doctype html>" in path.read_text(encoding="utf-8").lower()
