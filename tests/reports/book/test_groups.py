from dataclasses import replace

import pytest
from analyses import MS, Measured, make_analysis
from wording import numbers

from dds_trace.reports.book.book import Book
from dds_trace.reports.book.facets import facets_info, filters_info
from dds_trace.reports.book.groups import Cell, group_labels, groups_info, setting_word
from dds_trace.reports.book.recording import OwnCost, own_costs
from dds_trace.reports.html.styles import choice_styles
from dds_trace.reports.reporters import load_reporter


def labels_of(*measured):
    return list(groups_info(make_analysis(*measured)).labels)


def test_a_label_names_only_what_differs():
    assert labels_of(Measured([MS])) == ["Fast DDS"]
    assert labels_of(Measured([MS]), Measured([MS], rate_hz=20.0)) == ["Fast DDS"]
    assert labels_of(Measured([MS]), Measured([MS], bridge="builtin", domain_mode="different")) == [
        "Fast DDS, same domain",
        "Fast DDS, through our built-in bridge",
    ]
    assert labels_of(Measured([MS]), Measured([MS], reliability="best_effort")) == [
        "Fast DDS, best_effort",
        "Fast DDS, reliable",
    ]
    assert labels_of(Measured([MS]), Measured([MS], ping_device="pi-three")) == [
        "Fast DDS, pi-one → pi-two",
        "Fast DDS, pi-three → pi-two",
    ]


def test_the_label_of_a_group_is_its_cell_and_what_sets_its_series_apart():
    def labelled(*measured):
        return set(group_labels(groups_info(make_analysis(*measured))).values())

    bridged = Measured([MS], bridge="builtin", domain_mode="different")
    assert labelled() == set()
    zenoh = Measured([MS], vendor="zenoh", relay_vendor="zenoh")
    message = "Binary 33 KB at 10 Hz"
    assert labelled(Measured([MS])) == {message}
    assert labelled(Measured([MS]), bridged) == {f"{message}, same domain", f"{message}, through our built-in bridge"}
    assert labelled(Measured([MS]), zenoh) == {f"{message}, Fast DDS", f"{message}, Zenoh"}


def test_a_pair_of_vendors_is_named_as_a_pair():
    assert labels_of(Measured([MS], relay_vendor="cyclonedds")) == ["Fast DDS → Cyclone DDS"]


def test_series_and_cells_are_sorted_as_people_read():
    groups = groups_info(
        make_analysis(
            Measured([MS], data_type="imu", payload_bytes=296),
            Measured([MS], payload_bytes=4_000_000),
            Measured([MS], payload_bytes=33_000, vendor="zenoh", relay_vendor="zenoh"),
            Measured([MS], payload_bytes=33_000),
        )
    )
    assert groups.cells == (Cell("binary", 33_000, 10.0), Cell("binary", 4_000_000, 10.0), Cell("imu", 296, 10.0))
    assert groups.labels == ("Fast DDS", "Zenoh")
    assert [cell.label for cell in groups.cells] == [
        "Binary 33 KB at 10 Hz",
        "Binary 4 MB at 10 Hz",
        "IMU 296 B at 10 Hz",
    ]


def test_a_configuration_is_named_once():
    plain = "link=x(y)"
    files = [f"PROFILES={name}.xml#{number:08x},configuration={name},{plain}" for number, name in enumerate("ab")]
    assert [*map(setting_word([plain, *files]), [plain, *files])] == ["", "a.xml", "b.xml"]
    assert setting_word([plain, other := "configuration=c," + plain])(other) == "configuration=c"


def styles_of(*measured):
    return choice_styles(facets_info(groups_info(make_analysis(*measured))))


def test_a_vendor_keeps_its_colour_whoever_else_was_measured():
    alone = styles_of(Measured([MS], vendor="zenoh"))
    among = styles_of(*(Measured([MS], vendor=name) for name in ("cyclonedds", "fastdds", "new", "zenoh")))
    assert alone[0] == among[2]
    assert len({style.light for style in among}) == 4


def test_ways_differ_by_dash_and_twins_by_symbol():
    styles = styles_of(
        Measured([MS]),
        Measured([MS], bridge="builtin", domain_mode="different"),
        Measured([MS], reliability="best_effort"),
    )
    assert [(style.dash, style.symbol) for style in styles] == [
        ("solid", "circle"),
        ("solid", "hexagon"),
        ("dash", "star"),
    ]


def test_a_choice_looks_alike_at_every_place_and_like_no_other():
    bridges = ("none", "builtin", "builtin-zenoh", "zenoh-bridge-dds", "fastddsrouter")
    measured = [
        Measured([MS], vendor=vendor, bridge=bridge, domain_mode="same" if bridge == "none" else "different", connectivity=link,
                 setting=setting)
        for vendor in ("fastdds", "cyclonedds", "connext", "zenoh", "new", "other")
        for bridge in bridges
        for link, setting in (("wired", "link=100m(x),load=emulated-pi3"), ("wireless", "link=air(x)"))
    ]  # fmt: skip
    facets = facets_info(groups_info(make_analysis(*measured)))
    assert len(facets.dimensions["choice"].options) == len(facets.choices) == 30
    assert facets.dimensions["place"].options == ("pi-one → pi-two, emulated-pi3, wired", "pi-one → pi-two, wireless")
    styles = choice_styles(facets)
    assert len({(style.light, style.symbol, style.dash) for style in styles}) == 30
    assert len({(style.dark, style.symbol, style.dash) for style in styles}) == 30


def test_a_bridge_is_short_at_the_end_of_a_line_and_has_its_vendor_only_where_two_are_bridged():
    bridged = {"bridge": "builtin", "domain_mode": "different"}
    one = facets_info(groups_info(make_analysis(Measured([MS]), Measured([MS], **bridged))))
    assert one.dimensions["choice"].short == ("Fast DDS", "built-in")
    two = make_analysis(Measured([MS], **bridged), Measured([MS], vendor="zenoh", relay_vendor="zenoh", **bridged))
    assert facets_info(groups_info(two)).dimensions["choice"].options == ("Fast DDS", "Zenoh")
    four = make_analysis(
        *(
            Measured([MS], vendor=name, relay_vendor=name, **way)
            for name in ("fastdds", "zenoh")
            for way in ({}, bridged)
        )
    )
    assert facets_info(groups_info(four)).dimensions["choice"].short == (
        "Fast DDS",
        "Fast DDS, built-in",
        "Zenoh",
        "Zenoh, built-in",
    )


def test_only_what_varies_can_be_filtered():
    groups = groups_info(
        make_analysis(
            Measured([MS], rate_hz=100.0),
            Measured([MS], rate_hz=20.0, payload_bytes=1_000_000),
            Measured([MS], rate_hz=20.0, payload_bytes=67_000),
        )
    )
    size, rate = filters_info(groups)
    assert (size.key, [option.label for option in size.options]) == ("size", ["33 KB", "67 KB", "1 MB"])
    assert (rate.key, [option.value for option in rate.options]) == ("rate", ["20", "100"])
    by_group = {groups.cell_of(group).label: (size.index[i], rate.index[i]) for i, group in enumerate(groups.groups)}
    assert by_group == {
        "Binary 33 KB at 100 Hz": (0, 1),
        "Binary 67 KB at 20 Hz": (1, 0),
        "Binary 1 MB at 20 Hz": (2, 0),
    }


def test_settings_are_listed_by_number():
    lengths = ("0.3s", "2s", "12s", "120s")
    labels = labels_of(*(Measured([MS], setting=f"outage={length}") for length in reversed(lengths)))
    assert labels == [f"Fast DDS, outage={length}" for length in lengths]


FLOOR = {"median_ns": 400_000, "p99_ns": 1_200_000, "messages": 50}
COST = {"record_median_ns": 900, "record_p99_ns": 2000}


def analysis_of(extras, *measured):
    analysis = make_analysis(*(measured or (Measured([MS]),)))
    held = [replace(session, extra=extra) for session, extra in zip(analysis.sessions, extras, strict=False)]
    return replace(analysis, sessions=(*held, *(replace(one, extra={}) for one in analysis.sessions[len(held) :])))


def facts(analysis):
    return {fact.label: fact.value for fact in Book(analysis).overview.facts}


def test_of_several_sessions_the_slowest_counts(sentences):
    slower = {"recorder_cost": {**COST, "record_p99_ns": 5000}, "client_library_floor": {**FLOOR, "messages": 20}}
    slower |= {"single_executor_floor": {"median_ns": 470_000}, "own_cost": {"cpu_ns": 7, "duration_ns": 200}}
    analysis = analysis_of([{"recorder_cost": COST, "client_library_floor": FLOOR}, slower])
    assert own_costs(analysis) == (OwnCost("fastdds", "ros2", 900, 5000, 400_000, 1_200_000, 20, 470_000),)
    assert numbers(facts(analysis)["Cost of measuring"]) == [900, 5, 400, 1.2, 70, 3.5]
    sentences(facts(analysis)["Cost of measuring"])
    sides = [replace(one, host={"middleware": {"executor": "events"}}) for one in analysis.sessions]
    assert "events executor" in Book(replace(analysis, sessions=sides)).answer.sentences[-1][1]


def test_of_several_middlewares_the_slowest_is_told_in_one_line(sentences):
    analysis = analysis_of(
        [
            {"client_library_floor": {**FLOOR, "median_ns": 90_000}},
            {"client_library_floor": FLOOR},
            {"client_library_floor": {**FLOOR, "median_ns": 70_000}},
        ],
        Measured([MS], vendor="zenoh", backend="zenoh", relay_device=None),
        Measured([MS], vendor="cyclonedds", relay_device=None),
        Measured([MS], vendor="cyclonedds", backend="cyclonedds", relay_device=None),
    )
    assert numbers(facts(analysis)["Cost of measuring"]) == [400, 1.2]
    sentences(facts(analysis)["Cost of measuring"])
    assert {(cost.vendor, cost.backend): cost.floor_median_ns for cost in own_costs(analysis)} == {
        ("cyclonedds", "cyclonedds"): 90_000,
        ("cyclonedds", "ros2"): 400_000,
        ("zenoh", "zenoh"): 70_000,
    }


@pytest.mark.parametrize("extra", [{}, {"client_library_floor": None}, {"client_library_floor": {"median_ns": "x"}}])
def test_what_was_not_measured_is_not_shown(extra):
    assert own_costs(analysis_of([extra])) == ()
    assert "Cost of measuring" not in facts(analysis_of([extra]))


@pytest.mark.parametrize("kind", ["html", "md", "terminal", "json"])
def test_every_report_has_both(kind):
    book = Book(analysis_of([{"recorder_cost": COST, "client_library_floor": FLOOR}]), shows_all=True)
    text = load_reporter(kind).render(book)
    words = " ".join(text.split())
    assert "recording an event 900 ns" in words
    assert "from a node to itself 400" in words
