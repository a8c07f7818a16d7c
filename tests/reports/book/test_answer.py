import re
from dataclasses import replace

import polars as pl
import pytest
from analyses import BRIDGED, EVERY_ANALYSIS, MS, ZENOH, Measured, around, make_analysis
from paired_by_hand import paired
from wording import numbers

from dds_trace.analyzer.details import details_not_requested
from dds_trace.analyzer.groups.freshness import freshness_frame
from dds_trace.analyzer.verdicts.job import Job
from dds_trace.extensions.campaigns.recommend import recommend_settings
from dds_trace.reports.book.answer import PointKind
from dds_trace.reports.book.book import Book
from dds_trace.reports.book.groups import markdown
from dds_trace.reports.book.overview import Fact
from dds_trace.reports.book.verdicts import CLEARLY, FEW_PASSES, DataVerdict, WinCount
from dds_trace.reports.reporters import load_reporter

SLOW = around(10 * MS)
FAST = around(MS)


def test_a_clear_winner_is_named(sentences):
    answer = Book(make_analysis(Measured(SLOW), Measured(FAST, **ZENOH))).answer
    assert answer.verdicts == (
        DataVerdict(
            "Binary, same domain",
            "same domain",
            1,
            (WinCount("Zenoh", "zenoh", 1),),
            inconclusive=0,
            place="pi-one → pi-two, wired",
        ),
    )
    assert "Zenoh (the next" in answer.headline
    assert 9.92 in numbers(answer.headline)
    sentences(answer.headline, *answer.points, answer.rule)


@pytest.mark.parametrize(("slow_ns", "fast_ns", "below"), [(20, 1, 1), (18, 1, 0), (1, 20, 0), (None, 1, 0)])
def test_a_lead_below_the_difference_of_our_own_nodes_is_said(sentences, slow_ns, fast_ns, below):
    # The medians are 9 ms apart; a node's own cost is of a round trip, so twice as much of it shows.
    analysis = make_analysis(Measured(SLOW, runs=3), Measured(FAST, runs=3, **ZENOH))
    cost_ns = pl.when(pl.col("vendor") == "zenoh").then(pl.lit(fast_ns)).otherwise(pl.lit(slow_ns)) * MS
    ranked = recommend_settings(analysis.load_roundtrips(), Job("binary", 33_000, 10.0, 50 * MS, 0.9, metric="latency"))
    summary = analysis.summary.with_columns(own_cost_ns=cost_ns.cast(pl.Float64))
    book = Book(replace(analysis, summary=summary, details=replace(analysis.details, recommendation=ranked)))
    assert "Zenoh (the next" in book.answer.headline
    assert book.answer.rule == CLEARLY + FEW_PASSES  # of three passes
    said, choice = dict(book.answer.sentences).get(PointKind.CLIENT_FLOOR, ""), book.advice.sentence
    assert (numbers(said), "our own nodes" in choice) == ([1, 1, 1] * below, bool(below))
    sentences(*filter(None, (said, choice)))


def test_lost_messages_are_infinitely_late(sentences):
    # Half of the faster one's messages are lost, so its median is infinite and it cannot lead.
    lossy = [*FAST[:10], *["lost_return"] * 10]
    answer = Book(make_analysis(Measured(SLOW), Measured(lossy, **ZENOH))).answer
    assert all(win.contender != "Zenoh" for win in answer.verdicts[0].wins)
    assert numbers(answer.headline) == [25, 10, 40]
    sentences(answer.headline)


def test_without_the_round_trips_in_memory_nothing_is_judged(sentences):
    analysis = make_analysis(Measured(SLOW), Measured(FAST, **ZENOH))
    answer = Book(replace(analysis, details=details_not_requested())).answer
    assert "not ranked" in answer.headline
    sentences(answer.headline)
    assert answer.rule == ""


def test_unlike_conditions_are_not_compared(sentences):
    answer = Book(make_analysis(Measured(SLOW, payload_bytes=1000), Measured(FAST, **ZENOH))).answer
    assert answer.verdicts == ()
    assert "no ranking" in answer.headline
    assert numbers(answer.points[0]) == [10, 1, 10, 1.01, 33, 10]
    assert "no choice" not in answer.headline
    sentences(answer.headline)


def test_bridges_are_contenders_across_domains():
    answer = Book(
        make_analysis(Measured(SLOW, **BRIDGED), Measured(FAST, bridge="zenoh-bridge-dds", domain_mode="different"))
    ).answer
    (verdict,) = answer.verdicts
    assert verdict.data == "Binary, different domains"
    assert verdict.wins == (WinCount("Fast DDS through zenoh-bridge-dds", "fastdds", 1),)


def test_one_middleware_leaves_no_choice_and_the_bridge_its_price(sentences):
    answer = Book(make_analysis(Measured(FAST), Measured(SLOW, **BRIDGED))).answer
    assert numbers(answer.headline) == [1.01, 10]
    assert any(numbers(point) == [9.92] for point in answer.points)
    sentences(answer.headline, *answer.remarks)


def test_wins_are_counted_over_rates(sentences):
    answer = Book(make_analysis(
            Measured(SLOW), Measured(FAST, **ZENOH),
            Measured(SLOW, rate_hz=20.0), Measured(FAST, rate_hz=20.0, **ZENOH),
            Measured(FAST, rate_hz=50.0), Measured(SLOW, rate_hz=50.0, **ZENOH),
            Measured(FAST, rate_hz=80.0), Measured(FAST, rate_hz=80.0, **ZENOH),
        )).answer  # fmt: skip
    assert "depends on the rate" in answer.headline
    assert numbers(answer.headline)[-3:] == [2, 4, 1]
    sentences(answer.headline)


DEVICES = {"fast": 1, "pi": 9, "zero": 80}


def on_three_devices(shares, **more):
    """Groups of two middlewares on devices of unlike speed; `shares` of the time that Zenoh takes of Fast DDS's."""
    return [
        Measured([int(ns * speed * part) for ns in SLOW], ping_device=device, relay_device=device, **sides, **more)
        for (device, speed), share in zip(DEVICES.items(), shares, strict=True)
        for part, sides in ((1.0, {}), (share, ZENOH))
    ]


def test_who_is_faster_on_each_device_is_said_to_be_so_in_every_report(sentences):
    # Pooled, the devices' unlike speeds would hide the 20 % (Simpson).
    book = Book(make_analysis(*on_three_devices([0.8] * 3)), shows_all=True)
    assert "33 KB: Zenoh (" in book.answer.headline
    assert "1.25 times" in book.answer.headline
    sentences(book.answer.headline)
    assert [(one.place, one.wins[0].contender) for one in book.answer.verdicts] == [
        ("fast, wired", "Zenoh"),
        ("pi, wired", "Zenoh"),
        ("zero, wired", "Zenoh"),
    ]
    for kind in ("html", "md", "terminal"):
        text = " ".join(load_reporter(kind).render(book).split())
        assert all(verdict.place in text for verdict in book.answer.verdicts), kind
        assert "on each of 3 links" in text, kind


def test_different_answers_of_devices_have_a_sentence_each(sentences):
    answer = Book(make_analysis(*on_three_devices([0.8, 0.8, 1.25]))).answer
    assert re.search("pi, wired at 33 KB: Zenoh", answer.headline)
    assert re.search("zero, wired at 33 KB: Fast", answer.points[0])
    sentences(answer.headline, answer.points[0])


def test_conditions_follow_devices_and_link_in_every_report():
    alone = [Measured(SLOW), Measured(FAST, **ZENOH)]
    setting = "flows=2,link=wifi-54(loss_percent=1)"
    together = [Measured(SLOW, setting=setting), Measured(FAST, setting=setting, **ZENOH)]
    book = Book(make_analysis(*alone, *together), shows_all=True)
    conditions = "2 runs at once, emulated link wifi-54 (loss 1 %)"
    place = f"pi-one → pi-two, wired, {conditions}"
    assert [one.place for one in book.answer.verdicts] == ["pi-one → pi-two, wired", place]
    assert Fact("Conditions", conditions) in book.overview.facts
    for kind in ("html", "terminal"):
        assert place in " ".join(load_reporter(kind).render(book).split()), kind
    assert markdown(place) in load_reporter("md").render(book)


def test_the_deadline_is_judged_in_words_and_the_worst_result_is_named(sentences):
    analysis = make_analysis(Measured([MS] * 8), Measured([*[MS] * 3, 9 * MS, "lost_return"], payload_bytes=1000))
    rows = analysis.load_roundtrips().with_columns(group=(pl.col("run_id") - 0xA000).cast(pl.UInt32))
    freshness = freshness_frame(*paired(rows, deadline_ns=10 * MS))
    details = replace(analysis.details, freshness=freshness, deadline_ns=10 * MS)
    remark = Book(replace(analysis, details=details)).answer.remarks[0]
    assert numbers(remark) == [10, 2, 13, 15.4, 1, 10, 40]
    sentences(remark)


def test_without_a_relay_the_round_trip_is_compared_and_said_so():
    answer = Book(EVERY_ANALYSIS["ping without relay"]()).answer
    assert answer.metric == "rtt"
    assert "the latency is unknown" in answer.remarks[0]


def test_nothing_to_say(sentences):
    assert Book(EVERY_ANALYSIS["empty folder"]()).answer.headline == "No measurement was found."
    lost = Book(EVERY_ANALYSIS["nothing came back"]()).answer
    assert "No message was received" in lost.headline
    (remark,) = lost.remarks
    assert numbers(remark) == [100, 40, 40]
    sentences(remark)


def test_overview_lists_what_was_measured(sentences):
    analysis = make_analysis(
        Measured([MS] * 3),
        Measured([MS, "lost_return"], rate_hz=20.0, payload_bytes=1405, data_type="string"),
        title="kitchen",
    )
    book = Book(analysis)
    assert book.title == "kitchen"
    facts = {fact.label: fact.value for fact in book.overview.facts}
    assert (facts["Messages"], facts["Traces"]) == ("5 in 2 runs, 4 received", "1 read")
    assert (facts["Sent"], facts["Rates"]) == ("Binary 33 KB; String 1405 B", "10, 20 Hz")
    assert numbers(facts["Cost of measuring"]) == [900, 2]
    sentences(book.overview.brief, *(f"{label}: {value}" for label, value in facts.items()))


def test_overview_of_nothing():
    assert Book(make_analysis()).overview.facts == (Fact("Traces", "none found"),)
