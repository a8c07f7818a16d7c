import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest
from roundtrip_frames import MS, S, in_runs, rows_by_group, steady

from dds_trace.analyzer.verdicts.answers import Clarity, _outside, find_answers
from dds_trace.analyzer.verdicts.judgements import exceeds_lossy_share
from dds_trace.analyzer.verdicts.ranking import RankingOptions
from dds_trace.reports.book.groups import VendorLabels
from dds_trace.reports.book.verdicts import verdicts_info

VENDORS = VendorLabels({})


def noisy(centre_ns, messages=60, seed=0):
    return (centre_ns * (1 + 0.1 * np.random.default_rng(seed).uniform(-1, 1, messages))).astype(int).tolist()


@pytest.mark.parametrize(("outage_ns", "kept"), [((10, 20), [9, 20, 30]), ((None, 20), [20, 30]), ((10, None), [9])])
def test_messages_of_an_outage_are_those_from_its_begin_and_before_its_end(outage_ns, kept):
    sent_ns = np.array([9, 10, 19, 20, 30])
    run = SimpleNamespace(received=sent_ns, rows=pl.DataFrame({"publish_ns": sent_ns}))
    assert _outside(run, outage_ns).tolist() == kept


def test_a_setup_that_loses_too_much_does_not_lead_though_no_other_is_shown_to_lose_less():
    lossy = steady([None] * 10 + noisy(5 * MS, 50), vendor="zenoh", relay_vendor="zenoh", run_id=299)
    whole = in_runs(noisy(5 * MS), vendor="zenoh", relay_vendor="zenoh", run_id=2)
    (answer,) = find_answers(rows_by_group(pl.concat([in_runs(noisy(10 * MS), runs=4), whole, lossy])))
    assert (answer.leader_p50, [one.loses_more for one in answer.contenders]) == ("", [False, False])


def test_a_clear_leader():
    frame = pl.concat([in_runs(noisy(10 * MS)), in_runs(noisy(5 * MS), vendor="cyclonedds", run_id=2)])
    (answer,) = find_answers(rows_by_group(frame))
    assert (answer.basis, answer.fewest_runs) == ("between runs", 3)
    assert (answer.connectivity, answer.domain_mode, answer.data_type) == ("wired", "same", "binary")
    assert (answer.payload_bytes, answer.rate_hz) == (33_000, 10.0)
    assert answer.clarity is Clarity.CLEAR
    assert answer.percentile == "p50"  # three runs of 60 messages carry no interval for p99
    assert [c.name for c in answer.contenders] == ["cyclonedds to fastdds", "fastdds"]
    assert [c.name for c in answer.leaders] == ["cyclonedds to fastdds"]
    assert (answer.leader_p50, answer.leader_p99) == ("cyclonedds to fastdds", "")
    assert answer.contenders[0].latency.upper < answer.contenders[1].latency.lower
    assert answer.contenders[0].received.value == 1.0


def test_overlapping_intervals_are_inconclusive():
    frame = pl.concat([in_runs(noisy(10 * MS)), in_runs(noisy(10 * MS, seed=9), bridge="builtin", run_id=2)])
    (answer,) = find_answers(rows_by_group(frame))
    assert answer.clarity is Clarity.INCONCLUSIVE
    assert {c.name for c in answer.leaders} == {"fastdds", "fastdds via builtin"}


def test_a_setup_that_received_nothing_is_compared_where_only_one_relay_can_have_been_meant():
    silent = {"relay_vendor": None, "relay_backend": None, "relay_device": None, "relay_domain_id": None}
    lost = in_runs([None] * 60, vendor="cyclonedds", run_id=2, **silent)
    (answer,) = find_answers(rows_by_group(pl.concat([in_runs(noisy(10 * MS)), lost])))
    assert (answer.leader_p50, answer.relay_device) == ("fastdds", "relay-pi")
    two = [in_runs(noisy(10 * MS)), in_runs(noisy(10 * MS), relay_device="other", run_id=9)]
    assert len(find_answers(rows_by_group(pl.concat([*two, lost])))) == 3


def test_sockets_are_the_floor_and_no_contender():
    floor = steady(noisy(MS), vendor="socket", backend="socket", run_id=3)
    (answer,) = find_answers(rows_by_group(pl.concat([steady(noisy(10 * MS)), floor])))
    assert answer.clarity is Clarity.ONLY_ONE
    assert [c.name for c in answer.contenders] == ["fastdds"]
    (alone,) = find_answers(rows_by_group(floor))
    assert [c.setting["backend"] for c in alone.contenders] == ["socket"]


def test_tails_are_compared_where_every_sample_supports_them():
    frame = pl.concat([in_runs(noisy(10 * MS, 1000)), in_runs(noisy(5 * MS, 1000), vendor="zenoh", run_id=2)])
    (answer,) = find_answers(rows_by_group(frame))
    assert answer.percentile == "p99"
    assert answer.clarity is Clarity.CLEAR


def test_the_median_and_the_p99_may_have_leaders_of_their_own():
    # One is twice as quick but for one message in thirty, which takes eight times as long.
    bursty = [8 * ns if i % 30 == 7 else ns for i, ns in enumerate(noisy(5 * MS, 1000))]
    frame = pl.concat([in_runs(noisy(10 * MS, 1000)), in_runs(bursty, vendor="zenoh", relay_vendor="zenoh", run_id=2)])
    (answer,) = find_answers(rows_by_group(frame))
    assert (answer.leader_p50, answer.leader_p99) == ("zenoh", "fastdds")
    # The late ones take 40 ms, 10 % more or less: the p99 lies among the upper two thirds of them.
    times = {one.name: (round(one.p50_ns / MS), round(one.p99_ns / MS)) for one in answer.contenders}
    assert times == {"fastdds": (10, 11), "zenoh": (5, 42)}


def test_setups_are_sorted_by_p99_unless_only_the_median_has_a_leader():
    alike = in_runs(noisy(10 * MS, 1000, seed=9), vendor="zenoh", run_id=2)
    (open_,) = find_answers(rows_by_group(pl.concat([in_runs(noisy(10 * MS, 1000)), alike])))
    assert (open_.leader_p50, open_.leader_p99, open_.percentile) == ("", "", "p99")
    # Half as long, and the latest messages as long: one in thirty takes twice as long.
    late = [2 * ns if i % 30 == 7 else ns for i, ns in enumerate(noisy(5 * MS, 1000))]
    frame = pl.concat([in_runs(noisy(10 * MS, 1000)), in_runs(late, vendor="zenoh", relay_vendor="zenoh", run_id=2)])
    (median,) = find_answers(rows_by_group(frame))
    assert (median.leader_p50, median.leader_p99, median.percentile) == ("zenoh", "", "p50")


def test_losing_most_messages_is_not_fast():
    lossy = [MS if i % 4 == 0 else None for i in range(60)]
    frame = pl.concat([steady(noisy(10 * MS)), steady(lossy, reliability="best_effort", run_id=2)])
    (answer,) = find_answers(rows_by_group(frame))
    assert [c.name for c in answer.contenders] == ["fastdds, reliability reliable", "fastdds, reliability best_effort"]
    assert answer.contenders[1].latency.value == math.inf
    assert answer.contenders[1].received.value == 0.25


@pytest.mark.parametrize("starts_ns", [None, {1: 0, 2: 1000 * S}], ids=["unknown order", "one after the other"])
def test_one_run_tells_nobody_apart(starts_ns):
    frame = pl.concat([steady(noisy(10 * MS)), steady(noisy(5 * MS), vendor="zenoh", run_id=2)])
    (answer,) = find_answers(rows_by_group(frame), wall_offsets_ns=starts_ns)
    assert (answer.clarity, len(answer.leaders), answer.interleaved) == (Clarity.INCONCLUSIVE, 2, True)
    assert (answer.basis, answer.fewest_runs) == ("within one run", 1)


SHARED_FACTORS = (1.0, 1.2, 1.5, 1.1)
"""What a repeat does to all setups measured in it."""


def in_repeats(factors, first_run_id, seed, **parameters):
    return [
        steady(noisy(int(10 * MS * factor), seed=seed + i), run_id=first_run_id + i, **parameters)
        for i, factor in enumerate(factors)
    ]


@pytest.mark.parametrize(("share", "leader"), [(0.9, ""), (0.5, "zenoh")])
def test_what_a_repeat_does_to_all_setups_widens_the_test(share, leader):
    # Repeats differ by a factor of up to 1.5; by Welch's test 10 % between the setups are then no difference.
    zenoh = in_repeats([share * factor for factor in SHARED_FACTORS], 20, 50, vendor="zenoh", relay_vendor="zenoh")
    frame = pl.concat([*in_repeats(SHARED_FACTORS, 10, 0), *zenoh])
    passes = {first + i: i for first in (10, 20) for i in range(4)}
    (answer,) = find_answers(rows_by_group(frame), passes=passes)
    assert answer.leader_p50 == leader


def test_a_lead_below_the_margin_names_nobody():
    frame = pl.concat(
        [in_runs(noisy(10 * MS), spread=0.001), in_runs(noisy(9.8 * MS), spread=0.001, vendor="zenoh", run_id=2)]
    )
    (within,) = find_answers(rows_by_group(frame))
    (named,) = find_answers(rows_by_group(frame), options=RankingOptions(margin=0.01))
    assert (within.leader_p50, within.clarity, len(within.leaders)) == ("", Clarity.INCONCLUSIVE, 2)
    assert named.leader_p50 == "zenoh to fastdds"


def test_equal_setups_of_twenty_sizes_have_no_leader_by_chance():
    # Each size by itself would have one in twenty: the tests of all sizes are one family.
    generator = np.random.default_rng(4)
    frame = pl.concat(
        run
        for size in range(1, 21)
        for number, sides in enumerate(({}, {"vendor": "zenoh", "relay_vendor": "zenoh"}))
        for run in in_repeats(
            np.exp(0.2 * generator.standard_normal(4)), 100 * size + 10 * number, size, payload_bytes=size, **sides
        )
    )
    answers = find_answers(rows_by_group(frame))
    assert [answer.leader_p50 for answer in answers] == [""] * 20


@pytest.mark.parametrize(("times_ms", "letters"), [((10, 10.6, 30), "a a b"), ((10, 10.9, 12.1), "a ab b")])
def test_tiers_name_who_is_slower_and_who_is_not_shown_to_be_is_among_the_leaders(times_ms, letters):
    vendors = ("fastdds", "zenoh", "cyclonedds")
    frame = pl.concat(
        in_runs(noisy(ms * MS), spread=0.05, vendor=vendor, relay_vendor=vendor, run_id=place)
        for place, (vendor, ms) in enumerate(zip(vendors, times_ms, strict=True), 1)
    )
    (answer,) = find_answers(rows_by_group(frame))
    assert (answer.leader_p50, [one.name for one in answer.leaders]) == ("", ["fastdds", "zenoh"])
    assert {one.name: one.letters_p50 for one in answer.contenders} == dict(zip(vendors, letters.split(), strict=True))
    assert 3 < answer.repeats_p50 < 100


def test_setups_recorded_one_after_the_other_have_no_verdict_unless_their_order_is_trusted():
    frame = pl.concat([in_runs(noisy(10 * MS)), in_runs(noisy(5 * MS), vendor="zenoh", relay_vendor="zenoh", run_id=2)])
    apart = {100 + i: i * S for i in range(3)} | {200 + i: (3 + i) * S for i in range(3)}
    in_turn = {100 + i: 2 * i * S for i in range(3)} | {200 + i: (2 * i + 1) * S for i in range(3)}
    rows = rows_by_group(frame)
    (answer,) = find_answers(rows, wall_offsets_ns=apart)
    assert (answer.clarity, answer.leader_p50, answer.interleaved) == (Clarity.INCONCLUSIVE, "", False)
    assert 1.01 < answer.drift_ratio < 1.2
    (trusted,) = find_answers(rows, wall_offsets_ns=apart, options=RankingOptions(trust_order=True))
    assert (trusted.leader_p50, trusted.interleaved) == ("zenoh", False)
    (mixed,) = find_answers(rows, wall_offsets_ns=in_turn)
    assert (mixed.leader_p50, mixed.interleaved, mixed.drift_ratio) == ("zenoh", True, None)
    (at_once,) = find_answers(rows, wall_offsets_ns=dict.fromkeys(apart, 0))
    assert (at_once.leader_p50, at_once.interleaved) == ("zenoh", True)
    # The clock of one device stands 1000 s later.
    later = frame.with_columns(publish_ns=pl.col("publish_ns") + 1000 * S * (pl.col("run_id") >= 200))
    offsets = {run_id: start - 1000 * S * (run_id >= 200) for run_id, start in in_turn.items()}
    (by_wall,) = find_answers(rows_by_group(later), wall_offsets_ns=offsets)
    assert (by_wall.leader_p50, by_wall.interleaved) == ("zenoh", True)


@pytest.mark.parametrize(("lossy", "leader"), [((True, True), "zenoh"), ((False, True), "")])
def test_who_loses_2_percent_leads_only_where_all_do(lossy, leader):
    def sent(is_lossy, centre_ns):
        return [None if is_lossy and i % 50 == 7 else ns for i, ns in enumerate(noisy(centre_ns, 1000))]

    frame = pl.concat(
        [
            in_runs(sent(lossy[0], 10 * MS)),
            in_runs(sent(lossy[1], 5 * MS), vendor="zenoh", relay_vendor="zenoh", run_id=2),
        ]
    )
    (answer,) = find_answers(rows_by_group(frame))
    assert answer.leader_p50 == leader


def test_headlines_count_cases():
    runs = []
    for number, (size, cyclone_ns) in enumerate([(33_000, 5 * MS), (502_000, 6 * MS), (1_000_000, 10 * MS)]):
        runs.append(in_runs(noisy(10 * MS), payload_bytes=size, run_id=10 + number))
        runs.append(
            in_runs(
                noisy(cyclone_ns, seed=3),
                payload_bytes=size,
                run_id=20 + number,
                vendor="cyclonedds",
                relay_vendor="cyclonedds",
            )
        )
    runs.append(in_runs(noisy(MS), data_type="imu", payload_bytes=296, run_id=30))
    (verdict,) = verdicts_info(find_answers(rows_by_group(pl.concat(runs))), VENDORS)
    assert (verdict.place, verdict.data, verdict.cells) == ("ping-pi → relay-pi, wired", "Binary, same domain", 3)
    assert ([(win.vendor, win.cells) for win in verdict.wins], verdict.inconclusive) == ([("cyclonedds", 2)], 1)


def test_leads_are_sorted_by_their_cases_and_then_by_name():
    frame = pl.concat([in_runs(noisy(10 * MS)), in_runs(noisy(5 * MS), vendor="a", relay_vendor="a", run_id=2)])
    (answer,) = find_answers(rows_by_group(frame))
    first, second = (replace(answer, leaders=(one,)) for one in answer.contenders)
    for answers, wins in (
        ([second, first], [("a", 1), ("fastdds", 1)]),
        ([first, second, second], [("fastdds", 2), ("a", 1)]),
    ):
        assert [(win.vendor, win.cells) for win in verdicts_info(answers, VENDORS)[0].wins] == wins


def test_contenders_have_names_that_tell_them_apart():
    frame = pl.concat(
        [
            steady(noisy(10 * MS), rmw="rmw_fastrtps_cpp"),
            steady(noisy(5 * MS), rmw="rmw_fastrtps_dynamic_cpp", run_id=2),
            steady(noisy(7 * MS), vendor="zenoh", relay_vendor="zenoh", relay_backend="zenoh", run_id=3),
            steady(noisy(8 * MS), vendor="zenoh", relay_vendor=None, relay_backend=None, run_id=4),
            steady(noisy(9 * MS), vendor="opendds", relay_vendor="opendds", run_id=5),
        ]
    )
    (answer,) = find_answers(rows_by_group(frame))
    assert [c.name for c in answer.contenders] == [
        "fastdds, rmw_fastrtps_dynamic_cpp",
        "zenoh, relay zenoh, relay by zenoh",
        "zenoh, relay unknown",
        "opendds",
        "fastdds, rmw_fastrtps_cpp",
    ]


def test_no_relay_trace_and_nothing_at_all():
    bare = steady([MS] * 9).with_columns(latency_ns=pl.lit(None, pl.Int64))
    (answer,) = find_answers(rows_by_group(bare))
    assert answer.clarity is Clarity.ONLY_ONE
    assert answer.contenders[0].latency.value is None
    assert find_answers(rows_by_group(steady([]))) == ()


def test_devices_of_unlike_speed_are_answered_each_for_itself():
    # Cyclone DDS is 20 % faster on each of three devices; pooled, the devices' spread would hide it (Simpson).
    speeds = {"fast": 1.0, "pi": 9.0, "zero": 80.0}
    frame = pl.concat(
        in_runs(
            noisy(speed * share * MS),
            vendor=vendor,
            ping_device=device,
            run_id=10 * place + (1 if vendor == "fastdds" else 2),
        )
        for place, (device, speed) in enumerate(speeds.items(), 1)
        for vendor, share in (("fastdds", 1.0), ("cyclonedds", 0.8))
    )
    answers = find_answers(rows_by_group(frame))
    assert [answer.ping_device for answer in answers] == ["fast", "pi", "zero"]
    assert {answer.clarity for answer in answers} == {Clarity.CLEAR}
    assert {answer.leaders[0].setting["vendor"] for answer in answers} == {"cyclonedds"}
    verdicts = [(one.place, one.cells, one.wins[0].cells, one.inconclusive) for one in verdicts_info(answers, VENDORS)]
    assert verdicts == [(f"{device} → relay-pi, wired", 1, 1, 0) for device in ("fast", "pi", "zero")]


def test_unlike_values_of_a_link_are_two_cases_and_no_contenders():
    frame = pl.concat(
        in_runs(noisy(10 * MS), setting=f"link=custom(delay_ms={delay})", run_id=delay) for delay in (1, 2)
    )
    answers = find_answers(rows_by_group(frame))
    assert [answer.conditions for answer in answers] == ["link=custom(delay_ms=1)", "link=custom(delay_ms=2)"]
    assert {answer.clarity for answer in answers} == {Clarity.ONLY_ONE}


def test_who_lost_33_of_100_is_not_the_fastest():
    # Of the messages that came back Cyclone DDS is twice as fast, and its median is so with the losses, too.
    lossy = [None if i % 3 == 1 else ns for i, ns in enumerate(noisy(5 * MS, 100))]
    frame = pl.concat([in_runs(noisy(10 * MS, 100)), in_runs(lossy, vendor="cyclonedds", run_id=2)])
    (answer,) = find_answers(rows_by_group(frame))
    cyclone = answer.contenders[1]
    assert (answer.percentile, cyclone.setting["vendor"], cyclone.loses_more) == ("p99", "cyclonedds", True)
    assert cyclone.p50_ns < answer.contenders[0].p50_ns
    assert (cyclone.received.value, cyclone.survivors_ns < 6 * MS) == (0.67, True)
    assert [one.setting["vendor"] for one in answer.leaders] == ["fastdds"]
    (verdict,) = verdicts_info([answer], VENDORS)
    assert ([win.vendor for win in verdict.wins], verdict.inconclusive) == (["fastdds"], 0)  # at p99


def test_losses_are_adjusted_over_kinds_of_message():
    # Runs lose 0 to 2 and 4 to 9 of 60: by Welch's test p is 0.006, enough for one kind and not for ten.
    def sizes(count):
        for size in range(1, count + 1):
            for vendor, lost in (("fastdds", (0, 1, 0, 2)), ("zenoh", (4, 9, 5, 7) if size == 1 else (0, 1, 0, 2))):
                for number, some in enumerate(lost):
                    times = [None if i < some else 5 * MS for i in range(60)]
                    run_id = 100 * size + 10 * (vendor == "zenoh") + number
                    yield steady(times, vendor=vendor, relay_vendor=vendor, payload_bytes=size, run_id=run_id)

    for count, losers in ((1, ["zenoh"]), (10, [])):
        answers = find_answers(rows_by_group(pl.concat(sizes(count))))
        assert [one.name for answer in answers for one in answer.contenders if one.loses_more] == losers


def test_one_of_a_hundred_messages_is_not_more_than_one_percent():
    assert not exceeds_lossy_share(1 - 0.99)
    assert exceeds_lossy_share(1 - 0.989)
