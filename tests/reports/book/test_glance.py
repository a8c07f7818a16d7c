import pytest
from analyses import MS, ZENOH, Measured, around, make_analysis
from four_campaigns import CAMPAIGNS

from dds_trace.reports.book.book import Book
from dds_trace.reports.book.sizes import MOST_ROWS, _scale


def test_one_place_has_a_block_for_each_size_and_a_slower_setup_lies_further_right():
    sizes = (33_000, 1_000_000)
    measured = [
        Measured(around(ms * MS), payload_bytes=size, **own) for size in sizes for ms, own in ((4, {}), (1, ZENOH))
    ]
    glance = Book(make_analysis(*measured)).glance
    assert glance.columns == ("wireless",) or len(glance.columns) == 1
    assert [name for name, _ in glance.blocks] == ["Binary 33 KB", "Binary 1 MB"]
    for _, (fast_dds, zenoh) in glance.blocks:
        (slow,), (fast,) = fast_dds.dots, zenoh.dots
        assert 0 <= fast.low <= fast.at <= fast.high < slow.low <= slow.at <= slow.high <= 100
        assert fast_dds.choice != zenoh.choice
    places = [at for at, _ in glance.ticks]
    assert len(places) > 1
    assert places == sorted(places)
    assert all(0 <= at <= 100 for at in places)


@pytest.mark.parametrize(
    ("low", "high", "most", "times"),
    [
        (80_000, 2 * MS, 4, [1e5, 1e6]),
        (1_000, 10_000 * MS, 4, [1e3, 1e5, 1e7, 1e9]),
        (2 * MS, 60 * MS, 4, [3e6, 1e7, 3e7]),
        (103 * MS, 112 * MS, 4, [103e6, 112e6]),
        (1_000, 10_000 * MS, 2, [1e3, 1e7]),
    ],
)
def test_the_scale_of_dots_has_round_times(low, high, most, times):
    assert _scale(low, high, most) == pytest.approx(times)


def test_several_places_have_a_column_a_link_and_a_block_a_device_pair():
    glance = Book(CAMPAIGNS["study"]()).glance
    assert glance.columns == ("wired", "wireless")
    assert [name.partition("-")[0] for name, _ in glance.blocks] == ["laptop", "pi3", "pi4"]
    assert all(len(row.dots) == 2 and all(row.dots) for _, rows in glance.blocks for row in rows)
    assert sum(len(rows) for _, rows in glance.blocks) <= MOST_ROWS


def test_a_lost_median_has_no_dot_and_nothing_measured_has_no_picture():
    measured = [Measured(around(MS)), Measured([*around(MS)[:8], *["lost_return"] * 12], **ZENOH)]
    ((_, rows),) = Book(make_analysis(*measured)).glance.blocks
    assert {row.dots[0].cell.p50: row.dots[0].at is None for row in rows} == {"1.01 ms": False, "lost": True}
    assert Book(make_analysis()).glance is None


def test_the_answer_says_what_link_and_device_cost():
    """The study's radio doubles a latency, its pi3 takes nine times the laptop's, its pi4 three times."""
    (told,) = [point for point in Book(CAMPAIGNS["study"]()).answer.points if "over wired" in point]
    factors = [float(word) for word in told.replace(";", "").split() if word.replace(".", "").isdigit()]
    assert factors == pytest.approx([2, 2, 9, 9, 3, 3], rel=0.1)
    assert (
        told.index("wireless") < told.index("over wired") < told.index("pi3") < told.index("pi4") < told.index("laptop")
    )


def test_one_place_is_compared_with_none():
    assert not any("as long as over" in point for point in Book(CAMPAIGNS["demo"]()).answer.points)


def test_of_many_sizes_the_smallest_and_the_largest_are_shown():
    glance = Book(CAMPAIGNS["lossy machine"]()).glance
    assert [name for name, _ in glance.blocks] == ["Binary 33 KB", "Binary 4 MB"]
    assert glance.left_out == 4
