import random
from dataclasses import replace
from itertools import chain

import polars as pl
import pytest
from analyses import BRIDGED, EVERY_ANALYSIS, MS, Measured, make_analysis

from dds_trace.analyzer.details import details_not_requested
from dds_trace.analyzer.model.detail_frames import FAN_OUT_SCHEMA
from dds_trace.reports.book.book import Book
from dds_trace.reports.book.numbers import curves_info, intervals_info, values_info
from dds_trace.reports.figures import lines
from dds_trace.reports.figures.breakdown import MeanPart, breakdown_plan
from dds_trace.reports.figures.clocks import ClockPair, clock_plan, one_way_plan
from dds_trace.reports.figures.costs import bridge_cost_plan, domain_difference_plan, dots_plan
from dds_trace.reports.figures.distribution import HeatmapPanel, distribution_plan, heatmap_plan, run_spread_plan
from dds_trace.reports.figures.figure import MOST_LINES, Facet, Faceted, Line, Panel, facet_panels
from dds_trace.reports.figures.host_load import DeviceLoad, host_load_plan
from dds_trace.reports.figures.own_times import Receivers, fan_out_plan
from dds_trace.reports.figures.table import FIGURES, drawn_figures
from dds_trace.reports.figures.timeline import GroupTimeline, timeline_plan
from dds_trace.reports.html.page import json_island


@pytest.fixture
def campaign():
    """Group 0 is bridged; 1 to 3 are in the same domain; 4 is Zenoh. Series: same 0, bridged 1, Zenoh 2."""
    return make_analysis(
        Measured([3 * MS, 5 * MS], **BRIDGED),
        Measured([1 * MS, 2 * MS]),
        Measured([1 * MS, 1 * MS], rate_hz=20.0),
        Measured([8 * MS, 8 * MS], payload_bytes=67_000),
        Measured([1 * MS, "lost_return"], vendor="zenoh", relay_vendor="zenoh"),
    )


def test_values_are_those_of_the_summary(campaign):
    values = values_info(campaign)
    assert values.times_ns["latency"]["p50"] == (4_000_000, 1_500_000, 1_000_000, 8_000_000, 1_000_000)
    assert values.times_ns["latency"]["max"] == (5_000_000, 2_000_000, 1_000_000, 8_000_000, 1_000_000)
    assert values.times_ns["rtt"]["p50"] == (8_100_000, 3_100_000, 2_100_000, 16_100_000, 2_100_000)
    assert values.times_ns["response"]["mean"] == (8_120_000, 3_120_000, 2_120_000, 16_120_000, 2_120_000)
    assert values.times_ns["intermediate"]["min"] == (100_000,) * 5
    assert values.times_ns["latency"]["p90"] == (None,) * 5
    assert values.plain["received_ratio"] == (1.0, 1.0, 1.0, 1.0, 0.5)
    assert values.plain["lost_return"] == (0, 0, 0, 0, 1)


def test_latency_by_rate_has_a_panel_per_size_with_two_rates(campaign):
    line_same, line_bridged, line_zenoh = (
        Line(0, (10.0, 20.0), (1, 2)),
        Line(1, (10.0,), (0,)),
        Line(2, (10.0,), (4,)),
    )
    assert lines.LATENCY_BY_RATE.info(Book(campaign)) == Faceted(
        Facet("rate", "size", "choice"), (Panel("33 KB", (line_same, line_bridged, line_zenoh)),)
    )


def test_latency_by_size_has_a_panel_per_rate_with_two_sizes(campaign):
    curves = (Line(0, (33_000.0, 67_000.0), (1, 3)), Line(1, (33_000.0,), (0,)), Line(2, (33_000.0,), (4,)))
    by_size = Faceted(Facet("size", "rate", "choice"), (Panel("10 Hz", curves),))
    assert lines.LATENCY_BY_SIZE.info(Book(campaign)) == by_size
    # The relay is measured in every group, and a transfer rate takes two replies, which Zenoh did not get.
    assert lines.RELAY_TIME.info(Book(campaign)) == by_size
    assert lines.TRANSFER_BY_SIZE.info(Book(campaign)).panels == (Panel("10 Hz", curves[:2]),)
    assert lines.TRANSFER_BY_RATE.info(Book(campaign)).panels == (
        Panel("33 KB", (Line(0, (10.0, 20.0), (1, 2)), Line(1, (10.0,), (0,)))),
    )


def test_the_papers_panel_is_one_vendor_way_and_place_with_a_line_per_size(campaign):
    (panel,) = lines.LATENCY_BY_RATE.info(Book(campaign), panels="vendor", lines="size").panels
    assert panel == Panel("Fast DDS, same domain", (Line(0, (10.0, 20.0), (1, 2)), Line(1, (10.0,), (3,))))


def test_rows_are_places_and_no_panel_has_more_lines_than_can_be_told_apart():
    vendors = [f"vendor {number}" for number in range(9)]
    book = Book(
        make_analysis(
            *(
                Measured([MS], vendor=name, relay_vendor=name, rate_hz=rate_hz, connectivity=link)
                for name in vendors
                for rate_hz in (10.0, 20.0)
                for link in ("wired", "wireless")
            )
        )
    )
    panels = lines.LATENCY_BY_RATE.info(book).panels
    assert [(panel.title, len(panel.lines)) for panel in panels] == [
        ("wired (1 of 2)", 5),
        ("wired (2 of 2)", 4),
        ("wireless (1 of 2)", 5),
        ("wireless (2 of 2)", 4),
    ]
    assert MOST_LINES == 7
    # Along the places: the same vendors, now one position for each link.
    assert {line.x for panel in lines.BY_DEVICE.info(book).panels for line in panel.lines} == {(0.0, 1.0)}


def test_vendor_comparison_puts_groups_of_one_cell_above_one_another(campaign):
    # Cells: 33 KB at 10 Hz, 33 KB at 20 Hz, 67 KB at 10 Hz.
    curves = (Line(0, (0.0, 1.0, 2.0), (1, 2, 3)), Line(1, (0.0,), (0,)), Line(2, (0.0,), (4,)))
    everything = Faceted(Facet("plane", "way", "choice"), (Panel("Binary", curves),))
    assert lines.VENDOR_COMPARISON.info(Book(campaign)) == everything
    assert lines.RECEIVED.info(Book(campaign)) == everything


def test_a_panel_without_a_loss_is_left_out_of_what_was_received():
    lossy = Measured([MS, "lost_return"], data_type="string", payload_bytes=100)
    assert [panel.title for panel in lines.RECEIVED.info(Book(make_analysis(Measured([MS]), lossy))).panels] == [
        "String"
    ]
    assert lines.RECEIVED.info(Book(make_analysis(Measured([MS])))).panels == ()


def test_transfer_rate_stands_over_size_times_rate(campaign):
    # Zenoh's one reply spans no time and has no transfer rate.
    curves = (Line(0, (330_000.0, 660_000.0, 670_000.0), (1, 2, 3)), Line(1, (330_000.0,), (0,)))
    assert lines.TRANSFER_RATE.info(Book(campaign)).panels == (Panel("Binary", curves),)


def test_domain_difference_pairs_equal_groups(campaign):
    plan = domain_difference_plan(Book(campaign))
    assert (plan["pairs"], plan["groups"]) == ([(1, 0)], [0, 1])


def test_bars_are_of_the_messages_planned():
    """Of ten planned: 4 ms is the median of all if one is lost, and the median is lost if six are."""
    ramp = [n * MS for n in range(1, 10)]
    some, most = Measured([*ramp, "lost_return"]), Measured([*ramp[:4], *["lost_return"] * 6], **BRIDGED)
    planned = domain_difference_plan(Book(make_analysis(some, most)))["planned"]
    bridged, home = planned[0]["latency"], planned[1]["latency"]
    assert (home["p50"], home["max"]) == (pytest.approx(5 * MS, rel=2e-3), None)
    assert (bridged["p50"], bridged["min"]) == (None, pytest.approx(MS, rel=2e-3))
    assert "p99" not in home, "ten messages have no p99"


def test_domain_difference_pairs_no_unlike_groups():
    unlike = make_analysis(Measured([MS]), Measured([MS], reliability="best_effort", **BRIDGED))
    assert domain_difference_plan(Book(unlike)) is None


def test_every_bridge_is_compared_with_the_same_domain():
    both = make_analysis(
        Measured([MS]), Measured([MS], **BRIDGED), Measured([MS], bridge="zenoh-bridge-dds", domain_mode="different")
    )
    # Sorted by bridge: builtin 0, none 1, zenoh-bridge-dds 2.
    assert domain_difference_plan(Book(both))["pairs"] == [(1, 0), (1, 2)]


def test_heatmap_has_a_plane_per_series_with_two_tiles(campaign):
    tiles = ((33_000, 10.0, 1), (33_000, 20.0, 2), (67_000, 10.0, 3))
    assert heatmap_plan(Book(campaign)) == {"panels": [HeatmapPanel("Binary: Fast DDS, same domain", tiles)]}


def test_breakdown_stacks_the_parts_of_the_response(campaign):
    without_relay = Measured([MS], relay_device=None)
    assert breakdown_plan(Book(make_analysis(without_relay))) is None
    plan = breakdown_plan(Book(campaign))
    assert [panel.title for panel in facet_panels(Book(campaign), plan["facet"])] == [
        "Fast DDS, same domain",
        "Fast DDS, through our built-in bridge",
        "Zenoh, same domain",
    ]
    # Group 1: latencies of 1 and 2 ms, the way out 50 and 100 µs longer, the way back as much shorter.
    assert plan["parts"][1] == [
        MeanPart("waiting_ns", 20_000, 0),
        MeanPart("outbound_ns", 1_575_000, 50_000),
        MeanPart("relay_ns", 100_000, 0),
        MeanPart("return_ns", 1_425_000, 50_000),
    ]


def test_one_way_shows_both_ways_with_the_clock_bound(campaign):
    way = one_way_plan(Book(campaign))["ways"][1]
    assert (way.outbound_ns["p50"], way.return_ns["p50"], way.bound_ns) == (1_575_000, 1_425_000, 50_000)
    assert (way.outbound_ns["max"], way.return_ns["p90"]) == (2_100_000, None)


def test_bridge_cost_is_the_difference_with_its_interval():
    mixed = [n * 1000 for n in random.Random(1).sample(range(20), 20)]
    analysis = make_analysis(
        Measured([MS + ns for ns in mixed], connectivity="wireless"),
        Measured([3 * MS + ns for ns in mixed], connectivity="wireless", **BRIDGED),
    )
    plan = bridge_cost_plan(Book(analysis))
    ((group, cell),) = plan["cells"].items()
    cost = cell.costs["p50"]
    # Sorted by bridge: builtin is group 0. Samples of the bridge in the run (0 to 1.9 s): 30 % each.
    assert (plan["groups"], group) == ([0], 0)
    assert cell.bridge_cpu_percent == 30.0
    assert cost.ratio == pytest.approx(3, rel=0.02)
    assert cost.ratio_low <= cost.ratio <= cost.ratio_high
    assert (cost.difference_ns, cost.verdict) == (2 * MS, "slower")
    # Three runs a way that spread by 3 %: Welch's t on their logarithms reaches 8 % of 3 ms.
    assert 1.8 * MS <= cost.low_ns <= 2 * MS <= cost.high_ns <= 2.2 * MS
    assert "p99" not in cell.costs


def test_sustainable_needs_two_rates_and_one_that_was_not_kept_up(campaign):
    # 33 KB was sent at 10 and 20 Hz; 67 KB at one rate. Zenoh lost every other message.
    assert [panel.title for panel in lines.SUSTAINABLE.info(Book(campaign)).panels] == ["33 KB"]
    kept_up = make_analysis(Measured([MS, MS]), Measured([MS, MS], rate_hz=20.0))
    assert lines.SUSTAINABLE.info(Book(kept_up)).panels == ()


def test_the_spread_of_runs_is_how_far_their_interval_reaches():
    mixed = [MS + n * 1000 for n in random.Random(1).sample(range(20), 20)]
    analysis = make_analysis(Measured(mixed, runs=3), Measured([MS], rate_hz=20.0))
    plan = run_spread_plan(Book(analysis))
    (row,) = analysis.details.intervals.filter(metric="latency", percentile="p50", group=0).to_dicts()
    assert plan["reaches"]["p50"] == {0: pytest.approx((row["high_ns"] / row["low_ns"]) ** 0.5 - 1, abs=1e-5)}
    assert plan["groups"] == [0]


def test_a_few_groups_are_one_chart_in_place_of_figures_with_a_dot_each(campaign):
    assert dots_plan(Book(campaign))["groups"] == [1, 0, 4, 2, 3], "by message, then setup"
    made, left_out = drawn_figures(Book(campaign))
    assert made[0][0].name == "dots"
    assert {figure.name for figure, reason in left_out if "so few results" in reason} >= {
        "latency_by_rate", "latency_by_size", "domain_difference", "vendor_comparison", "received",
    }  # fmt: skip
    many = Book(EVERY_ANALYSIS["small campaign"]())
    assert dots_plan(many) is None
    assert "dots" not in {figure.name for figure, _ in chain(*drawn_figures(many))}


def test_clock_shows_offsets_since_the_first():
    (pair,) = clock_plan(Book(make_analysis(Measured([MS, MS]))))["pairs"]
    assert pair.title.split(": ") == ["pi-one → pi-two", "drift +20 ± 1 ppm"]
    assert pair == ClockPair(pair.title, 500, (0.0, 10.0), (0, 200_000), (50_000, 50_000), (0, 0))


NO_LINK = ((None, None), (None, None))


def test_host_load_is_that_of_the_run():
    # 0 s to 1.1 s after the wall anchor; samples at 0, 1, 2 s.
    analysis = make_analysis(Measured([MS] * 12, connectivity="wireless"))
    assert host_load_plan(Book(analysis))["groups"] == {
        0: (
            DeviceLoad("ping", (0.0, 1.0), (20.0, 21.0), (-50.0, -51.0), *NO_LINK),
            DeviceLoad("relay", (0.0, 1.0), (40.0, 41.0), (-50.0, -51.0), *NO_LINK),
        )
    }


def test_intervals_are_by_group():
    mixed = [MS + n * 1000 for n in random.Random(1).sample(range(20), 20)]
    intervals = intervals_info(make_analysis(Measured(mixed), Measured([MS], rate_hz=20.0)))
    # Student's price leaves 16 of 20 independent: the 4th of 16 (binomial), so the 4th of 20, and the 4th from above.
    assert intervals.ends("latency", "p50", 0) == (1_003_000, 1_016_000)
    assert intervals.ends("latency", "p50", 1) == (None, None)
    assert all(intervals.is_within_runs("latency", "p50", group) for group in (0, 1))


def test_outages_are_marked_on_the_timeline():
    analysis = make_analysis(Measured([*[MS] * 10, *["lost_return"] * 5, *[MS] * 10]))
    ((start, end),) = timeline_plan(Book(analysis))["outages"][0]
    # Messages 10 to 14 were due at 1.0 to 1.4 s; the next one came back 2.1 ms after 1.5 s (and 20 µs late).
    assert start == 1.0
    assert 1.5 <= end <= 1.51


def test_without_details_the_figures_that_need_them_say_so(campaign):
    plain = replace(campaign, details=details_not_requested())
    left_out = {figure.name for figure in FIGURES if figure.plan(Book(plain)) is None}
    of_wire = "first_message sent_again wire_cost"
    of_details = "breakdown bridge_cost clock fan_out host_load interference one_way recovery run_spread"
    assert left_out == {"by_device", *of_wire.split(), *of_details.split()}


def test_curves_are_the_inverse_of_the_histogram():
    # 1, 2, ... 100 ms: the share q of the messages stays below or reaches q * 100 ms.
    curves = curves_info(make_analysis(Measured([n * MS for n in range(1, 101)])))
    at = dict(zip(curves.levels, curves.values_ns["latency"][0], strict=False))
    assert at[0.0] == 1 * MS
    assert at[0.5] == 50 * MS
    assert at[0.85] == 85 * MS
    assert at[0.9] == 90 * MS
    assert at[0.99] == 99 * MS
    assert max(at) == 0.99, "p99.9 of 100 messages is not known"


def test_the_share_received_is_of_the_messages_planned():
    # Group 0: 3 of 4 published came back, 2 more never left. Group 1: nothing is missing.
    lossy = Measured([MS, MS, 2 * MS, "lost_return"], unsent=2)
    shares = curves_info(make_analysis(lossy, Measured([MS, MS], rate_hz=20.0))).shares
    assert shares == (0.5, 1.0)


def test_levels_are_ascending_and_hold_the_named_percentiles():
    levels = curves_info(make_analysis()).levels
    assert list(levels) == sorted(set(levels))
    assert {0.5, 0.9, 0.99, 0.999, 0.9999} <= set(levels)


def test_one_message_makes_no_curve():
    assert distribution_plan(Book(make_analysis(Measured([MS])))) is None
    assert distribution_plan(Book(make_analysis(Measured([MS, MS])))) == {}


def test_timeline_marks_losses_at_the_time_they_were_due():
    analysis = make_analysis(Measured([MS, "lost_outbound", 3 * MS, "lost_return"]))
    group = GroupTimeline(0, (0.0, 0.2), (1_000_000, 3_000_000), (2_100_000, 6_100_000), (0.1, 0.3), (1, 1))
    assert timeline_plan(Book(analysis)) == {"groups": {0: group}, "decimated": False, "outages": {}}


def test_a_thinned_timeline_keeps_extremes_and_counts_losses(monkeypatch):
    monkeypatch.setattr("dds_trace.reports.figures.timeline.POINTS_IN_PAGE", 10)
    monkeypatch.setattr("dds_trace.reports.figures.timeline.FEWEST_POINTS", 10)
    messages = [MS + n for n in range(1000)]
    messages[333], messages[666] = 500 * MS, 1
    group = timeline_plan(Book(make_analysis(Measured([*messages, *["lost_unknown"] * 100]))))["groups"][0]
    assert len(group.elapsed_s) <= 10
    assert {500 * MS, 1} <= set(group.latency_ns)
    assert sum(group.lost_count) == 100
    assert len(group.lost_count) <= 10


@pytest.mark.parametrize("name", EVERY_ANALYSIS)
def test_every_figure_accepts_every_analysis(name):
    analysis = EVERY_ANALYSIS[name]()
    for figure in FIGURES:
        json_island(figure.plan(Book(analysis)))


def test_every_figure_says_in_a_sentence_how_to_read_it_and_why_it_is_left_out():
    for figure in FIGURES:
        assert figure.how_to_read.endswith(".")
        assert figure.how_to_read.count(". ") == 0, "one sentence"
        assert figure.nothing.endswith(".")


def test_nothing_empty_is_drawn_and_names_are_unique():
    empty, lost = (Book(EVERY_ANALYSIS[name]()) for name in ("empty folder", "nothing came back"))
    assert not [figure.name for figure in FIGURES if figure.plan(empty) is not None]
    assert len({figure.name for figure in FIGURES}) == len(FIGURES)
    drawn_of_lost = [figure.name for figure in FIGURES if figure.plan(lost) is not None]
    assert drawn_of_lost == ["received", "timeline", "host_load"]


def drawn(*rows):
    analysis = make_analysis(*(Measured([MS], setting=f"hosts={n},relays={n},tuned=true") for n in (2, 5)))
    frame = pl.DataFrame([dict.fromkeys(FAN_OUT_SCHEMA) | row for row in rows], FAN_OUT_SCHEMA)
    return fan_out_plan(Book(replace(analysis, details=replace(analysis.details, fan_out=frame))))


def row(group, receivers, **times):
    named = {f"{name}_p50_ns": time_ns for name, time_ns in times.items()}
    return {"group": group, "receivers": receivers, "senders": 1, **named}


def test_results_that_differ_only_in_the_number_are_one_line():
    plan = drawn(row(1, 5, first_receiver=MS, last_receiver=4 * MS), row(0, 2, first_receiver=MS, last_receiver=2 * MS))
    ((name, points),) = plan["lines"].items()
    assert name.endswith("tuned=true")
    assert points == (Receivers(0, 2, MS, 2 * MS, None), Receivers(1, 5, MS, 4 * MS, None))
    assert plan["of"] == "Relays"


def test_with_one_relay_the_pings_are_counted():
    assert drawn(row(0, 1), row(1, 1))["of"] == "Pings"


def test_without_rows_there_is_none():
    assert drawn() is None
