import re
import tarfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from tap_traces import (
    FAR_NS,
    LAPTOP,
    MS,
    NEAR_NS,
    ROBOT,
    SECOND,
    Clock,
    Hearing,
    Published,
    arrivals,
    camera,
    write_beacon,
    write_tap,
)

from dds_trace.analyzer.pipeline import analyze
from dds_trace.extensions.topics.report import topic_sentences
from dds_trace.reports.book.book import Book
from dds_trace.reports.reporters import load_reporter

LOST = (100, 101, 500, 1700)


def both_taps(folder, published, *, lost=LOST, far_ns=FAR_NS, **hearing):
    near, far = arrivals(published, NEAR_NS), arrivals(published, far_ns, lost=lost)
    write_tap(folder / "robot.mcap", published.clock, [Hearing(published, near, **hearing)], session_id=0x51)
    write_tap(folder / "laptop.mcap", LAPTOP, [Hearing(published, far, **hearing)], session_id=0x52)
    return far


def row_of(analysis, receiver="laptop", topic="/camera/image"):
    (row,) = analysis.topics.filter(topic=topic, relay_device=receiver).iter_rows(named=True)
    return row


def messages_of(analysis, receiver="laptop", topic="/camera/image"):
    return analysis.topic_messages.filter(data_type=topic, relay_device=receiver)


@pytest.mark.parametrize("hearing", [{}, {"has_sequence": False}], ids=["by number", "by stamp"])
@pytest.mark.parametrize("sides", [(LAPTOP, ROBOT), (ROBOT, LAPTOP)], ids=["laptop pings", "robot pings"])
def test_every_time_is_inside_its_bound_and_none_is_negative(tmp_path, sides, hearing):
    published = camera()
    far = both_taps(tmp_path, published, **hearing)
    write_beacon(tmp_path, *sides, seconds=63)
    messages = messages_of(analyze(tmp_path))
    arrived = messages.filter(outcome="completed")
    assert len(arrived) == len(far) - len(LOST)
    true_ns = (far - published.sent_ns)[far >= 0]
    for name, truth in (("one_way_ns", true_ns), ("age_ns", true_ns + 5 * MS)):
        found = arrived[name].to_numpy()
        assert (np.abs(found - truth) <= arrived["bound_ns"].to_numpy()).all(), name
        assert found.min() >= 0
    assert arrived["bound_ns"].max() < MS
    at_publish = arrived["stamp_to_publish_ns"].to_numpy()
    assert np.abs(at_publish - 5 * MS).max() <= 20_000


@pytest.mark.parametrize("moved", [{}, {"slew_ppm": 500}, *({"set_ns": ms * MS} for ms in (40, -40, 2, -2))], ids=str)
def test_a_wall_clock_that_is_set_is_followed_and_found(tmp_path, moved):
    published = replace(camera(), clock=replace(ROBOT, **moved))
    far = both_taps(tmp_path, published, lost=())
    write_beacon(tmp_path, LAPTOP, published.clock, seconds=63)
    analysis = analyze(tmp_path)
    messages = messages_of(analysis)
    is_off = (messages["one_way_ns"] - pl.Series(far - published.sent_ns)).abs() > messages["bound_ns"]
    assert is_off.sum() == 0
    assert messages["bound_ns"].median() < 2 * MS
    assert ("clock_set" in {finding.code for finding in analysis.findings}) == bool(moved)


def test_a_topic_is_one_row_for_each_pair_of_devices(tmp_path):
    both_taps(tmp_path, camera())
    write_beacon(tmp_path, LAPTOP, ROBOT, seconds=63)
    analysis = analyze(tmp_path)
    here, there = row_of(analysis, "robot"), row_of(analysis)
    assert [row["ping_device"] for row in (here, there)] == ["robot", "robot"]
    assert (here["clock"], there["clock"]) == ("same", "fit")
    assert (there["published"], there["received"], there["lost_outbound"]) == (1800, 1796, 4)
    assert (here["received"], here["lost_outbound"]) == (1800, 0)
    assert there["rate_hz"] == pytest.approx(30, rel=0.01)
    assert there["message_bytes"] == 1000
    assert there["one_way_p50_ns"] == pytest.approx(FAR_NS * 1.23, abs=MS)
    assert there["age_p50_ns"] - there["one_way_p50_ns"] == pytest.approx(5 * MS, rel=0.01)
    assert here["bound_ns"] <= 20_000
    assert there["jitter_ns"] < MS


def test_without_the_beacon_no_time_is_made_up(tmp_path):
    both_taps(tmp_path, camera())
    analysis = analyze(tmp_path)
    there = row_of(analysis, topic="/camera/image")
    assert (there["clock"], there["one_way_p50_ns"], there["age_p50_ns"]) == ("unknown", None, None)
    assert (there["published"], there["received"]) == (1800, 1796)
    assert analysis.summary.is_empty()


def test_one_machine_needs_no_beacon(tmp_path):
    published = camera(seconds=20)
    for number in (1, 2):
        hearing = Hearing(published, arrivals(published, 200_000, seed=number))
        write_tap(tmp_path / f"tap{number}.mcap", ROBOT, [hearing], session_id=number)
    row = row_of(analyze(tmp_path), "robot")
    assert (row["clock"], row["runs"], row["received_ratio"]) == ("assumed", 2, 1.0)
    assert row["one_way_p50_ns"] == pytest.approx(246_000, abs=30_000)
    assert row["bound_ns"] <= 20_000


def analyzed(folder, robot, laptop, **tap):
    """Analysis of a tap on each device, with what each heard, and beacons between the devices."""
    write_tap(folder / "robot.mcap", ROBOT, robot, session_id=1, **tap)
    write_tap(folder / "laptop.mcap", LAPTOP, laptop, session_id=2, **tap)
    write_beacon(folder, LAPTOP, ROBOT, seconds=23)
    return analyze(folder)


def test_numbers_that_nobody_heard_are_lost_and_copies_and_late_ones_counted(tmp_path):
    published = camera(seconds=20)
    lost = [50, 51, 300]
    near, far = arrivals(published, NEAR_NS, lost=lost), arrivals(published, FAR_NS, lost=[*lost, 90])
    far[200] = far[202] + 1  # overtaken by two
    row = row_of(analyzed(tmp_path, [Hearing(published, near)], [Hearing(published, far)]))
    assert (row["published"], row["lost_unknown"], row["lost_outbound"], row["reordered"]) == (600, 3, 1, 1)


def test_what_was_sent_before_a_tap_began_or_as_it_ended_is_not_lost(tmp_path):
    published = camera(seconds=20)
    near, far = arrivals(published, NEAR_NS), arrivals(published, FAR_NS)
    far[:90] = -1
    far[-30:] = -1
    row = row_of(analyzed(tmp_path, [Hearing(published, near)], [Hearing(published, far)]))
    assert (row["published"], row["received"]) == (480, 480)


def test_a_tap_that_runs_on_after_the_last_message_sees_an_outage_to_the_end(tmp_path):
    published = camera(seconds=20)
    near, far = arrivals(published, NEAR_NS), arrivals(published, FAR_NS)
    far[-30:] = -1
    end_ns = int(published.sent_ns[-1]) + 2 * SECOND
    row = row_of(analyzed(tmp_path, [Hearing(published, near)], [Hearing(published, far)], end_ns=end_ns))
    assert (row["published"], row["received"]) == (600, 570)


def test_behind_a_bridge_messages_are_joined_by_their_content(tmp_path):
    published = camera(seconds=20)
    far = arrivals(published, FAR_NS, lost=[40])
    bridged = Hearing(published, far, guid="02" * 16, first_sequence=7, has_source=False)
    analysis = analyzed(tmp_path, [Hearing(published, arrivals(published, NEAR_NS))], [bridged])
    row = row_of(analysis)
    assert (row["ping_device"], row["published"], row["received"]) == ("robot", 600, 599)
    arrived = messages_of(analysis).filter(outcome="completed")
    true_ns = (far - published.sent_ns)[far >= 0]
    assert (np.abs(arrived["one_way_ns"].to_numpy() - true_ns) <= arrived["bound_ns"].to_numpy()).all()


def test_contents_that_repeat_are_not_joined_behind_a_bridge(tmp_path):
    published = camera(
        seconds=20, contents=np.arange(600) // 2 * (np.arange(600) > 100) + np.arange(600) * (np.arange(600) <= 100)
    )
    bridged = Hearing(published, arrivals(published, FAR_NS), guid="02" * 16, has_source=False)
    messages = messages_of(analyzed(tmp_path, [Hearing(published, arrivals(published, NEAR_NS))], [bridged]))
    assert messages["one_way_ns"].drop_nulls().max() < 20 * MS


def test_a_middleware_without_stamps_is_measured_from_the_tap_next_to_the_publisher(tmp_path):
    published = camera(seconds=20)
    far = both_taps(tmp_path, published, lost=(), has_source=False)
    write_beacon(tmp_path, LAPTOP, ROBOT, seconds=23)
    arrived = messages_of(analyze(tmp_path)).filter(outcome="completed")
    near = arrivals(published, NEAR_NS)
    assert (np.abs(arrived["one_way_ns"].to_numpy() - (far - near)) <= arrived["bound_ns"].to_numpy()).all()


def test_one_tap_is_enough_where_only_one_clock_can_have_made_the_stamps(tmp_path):
    published = camera(seconds=20)
    write_tap(tmp_path / "laptop.mcap", LAPTOP, [Hearing(published, arrivals(published, FAR_NS))], session_id=2)
    write_beacon(tmp_path, LAPTOP, ROBOT, seconds=23)
    row = row_of(analyze(tmp_path))
    assert (row["ping_device"], row["clock"]) == ("robot", "fit")
    assert row["one_way_p50_ns"] == pytest.approx(FAR_NS * 1.23, abs=MS)


def analysis_of_a_chain(folder, every=1):
    """Of images that the laptop detects something in, 8 ms after each (or some), and of what it publishes then."""
    published = camera(seconds=20)
    near, far = arrivals(published, NEAR_NS), arrivals(published, FAR_NS)
    found = Published("/detections", LAPTOP, far[::every] + 8 * MS, published.headers[::every], guid="03" * 16)
    there, back = arrivals(found, NEAR_NS, seed=3), arrivals(found, FAR_NS, seed=4)
    return analyzed(
        folder, [Hearing(published, near), Hearing(found, back)], [Hearing(published, far), Hearing(found, there)]
    )


def test_a_chain_is_timed_from_the_first_to_the_last_at_each_tap(tmp_path):
    analysis = analysis_of_a_chain(tmp_path)
    lines = [line for line in topic_sentences(analysis) if line.startswith("the same stamps")]
    assert len(lines) == 2
    assert "/detections on laptop 8." in lines[0]
    assert "(100 %)" in lines[0]


@pytest.mark.parametrize("every", [1, 2, 3])
def test_the_hops_of_a_chain(tmp_path, every):
    hops = analysis_of_a_chain(tmp_path, every).topic_hops
    chain = hops.filter(chain=hops.filter(topic="/detections", relay_device="robot")["chain"][0])
    events = [tuple(row) for row in chain.select("from_event", "to_event", "topic", "next_topic").rows()]
    assert events == [
        ("stamp", "publish", "/camera/image", "/camera/image"),
        ("publish", "receive", "/camera/image", "/camera/image"),
        ("receive", "publish", "/camera/image", "/detections"),
        ("publish", "receive", "/detections", "/detections"),
    ]
    assert chain["p50_ns"].to_list() == pytest.approx([5 * MS, FAR_NS * 1.23, 8 * MS, FAR_NS * 1.23], rel=0.3)
    assert chain["share"].to_list() == [None, None, pytest.approx(1 / every, rel=0.01), None]


def test_stamps_of_a_simulation_have_no_age(tmp_path):
    published = camera(seconds=20)
    simulated = Published(published.topic, ROBOT, published.sent_ns, published.sent_ns)
    both_taps(tmp_path, simulated, lost=())
    write_beacon(tmp_path, LAPTOP, ROBOT, seconds=23)
    row = row_of(analyze(tmp_path))
    assert row["age_p50_ns"] is None
    assert row["one_way_p50_ns"] is not None


def test_over_a_third_device_the_bounds_add_up(tmp_path):
    server = Clock("server", "33333333-3333-3333-3333-333333333333", 7 * SECOND, 3 * SECOND, -40)
    published = camera(seconds=20)
    far = both_taps(tmp_path, published, lost=())
    write_beacon(tmp_path / "one", LAPTOP, server, seconds=23)
    write_beacon(tmp_path / "two", ROBOT, server, seconds=23, number=1)
    arrived = messages_of(analyze(tmp_path)).filter(outcome="completed")
    assert (
        np.abs(arrived["one_way_ns"].to_numpy() - (far - published.sent_ns)) <= arrived["bound_ns"].to_numpy()
    ).all()
    assert arrived["bound_ns"].max() < 2 * MS


def test_a_saved_analysis_has_its_topics(tmp_path):
    from dds_trace.analyzer.analysis import load_analysis

    both_taps(tmp_path / "runs", camera(seconds=10), lost=())
    analysis = analyze(tmp_path / "runs")
    analysis.save(tmp_path / "saved")
    saved = load_analysis(tmp_path / "saved")
    for name in ("topics", "topic_messages", "topic_hops"):
        assert getattr(saved, name).equals(getattr(analysis, name))
    assert isinstance(saved.topics, pl.DataFrame)


DOCS = Path(__file__).parents[3] / "docs"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recorded")
    with tarfile.open(DOCS / "results" / "two-machines" / "traces.tar.xz") as archive:
        archive.extractall(folder, filter="data")
    return analyze(folder / "robot-and-laptop")


def test_the_archive_is_small():
    assert (DOCS / "results" / "two-machines" / "traces.tar.xz").stat().st_size <= 1_000_000


def test_the_clocks_are_two_seconds_apart_and_every_time_is_bounded(recorded):
    (fit,) = {
        row["offset_ns"] // 10**8 for row in recorded.details.clock_fits.iter_rows(named=True) if row["offset_ns"] > 0
    }
    assert fit in (19, 20)
    over = recorded.topics.filter(topic="/camera/image", relay_device="laptop").to_dicts()[0]
    assert (over["clock"], over["ping_device"]) == ("fit", "robot")
    assert over["bound_ns"] < 1_000_000
    messages = recorded.topic_messages
    assert messages["one_way_ns"].min() >= 0
    assert messages["age_ns"].min() >= 0
    assert not messages["bound_ns"].null_count()


def test_its_page_draws_of_the_beacons_their_clocks_and_asks_for_no_job(recorded):
    page = load_reporter("html").render(Book(recorded))
    assert re.findall(r'data-figure="(\w+)"', page) == ["clock"]
    assert 'id="job"' not in page
