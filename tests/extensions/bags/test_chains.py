"""Topics that pass stamps on or stamp again, made with known times and shares; what looks alike and is none."""

from dataclasses import replace

import numpy as np
import pytest
from card_bags import MS, START_NS, S, card, write

from dds_trace.extensions.bags.chains import Stamped, chain_lines, find_links
from dds_trace.extensions.bags.report import BagReport

PERIOD_NS = 33 * MS


def wait_ns(rng, typical_ms, count):
    return np.rint(rng.gamma(16, typical_ms * MS / 16, count)).astype(np.int64)


def camera(rng, count=600, phase_ns=0):
    stamps_ns = START_NS + phase_ns + PERIOD_NS * np.arange(count) + np.rint(rng.normal(0, MS, count)).astype(np.int64)
    return stamps_ns, np.sort(stamps_ns + wait_ns(rng, 3, count))


def topic(name, stamp_ns, log_ns, message_type="a/msg/A", *, has_age=True):
    order = np.argsort(log_ns, kind="stable")
    return Stamped(name, message_type, log_ns[order], stamp_ns[order], has_age)


def followed(rng, stamps_ns, log_ns, share, typical_ms):
    is_kept = rng.random(len(stamps_ns)) < share
    return stamps_ns[is_kept], log_ns[is_kept] + wait_ns(rng, typical_ms, is_kept.sum())


@pytest.mark.parametrize("seed", range(40))
def test_stamps_that_are_passed_on_are_timed_from_the_first_to_the_last(seed):
    rng = np.random.default_rng(seed)
    shares, typical_ms = rng.uniform(0.5, 1, 2), rng.uniform(3, 60, 2)
    first = camera(rng)
    middle = followed(rng, *first, shares[0], typical_ms[0])
    last = followed(rng, *middle, shares[1], typical_ms[1])
    other = topic("/lidar", *camera(rng, phase_ns=11 * MS))
    links = find_links([topic("/out", *last), other, topic("/in", *first), topic("/middle", *middle)])
    passed = [link for link in links if not link.stamps_again]
    assert [(link.topic, link.next_topic) for link in passed] == [("/in", "/middle"), ("/in", "/out")]
    for link, share, total_ms in zip(passed, np.cumprod(shares), np.cumsum(typical_ms), strict=True):
        assert link.share == pytest.approx(share, abs=0.08)
        assert link.p50_ns == pytest.approx(total_ms * MS, rel=0.1)
        assert link.messages == len({"/middle": middle, "/out": last}[link.next_topic][0])
    assert not [link for link in links if link.stamps_again]


@pytest.mark.parametrize("seed", range(40))
def test_a_topic_that_is_stamped_again_follows_the_wander_of_its_source(seed):
    rng = np.random.default_rng(seed)
    stamps_ns, log_ns = camera(rng)
    again_ns = np.sort(log_ns + wait_ns(rng, 2, len(log_ns)))
    other = camera(rng, phase_ns=12 * MS)
    links = find_links(
        [topic("/timer", *other), topic("/out", again_ns, again_ns + MS), topic("/in", stamps_ns, log_ns)]
    )
    assert [(link.topic, link.next_topic, link.stamps_again) for link in links] == [("/in", "/out", True)]
    assert links[0].p50_ns == pytest.approx(5 * MS, rel=0.2)
    assert links[0].share == 1.0


def simulated(rng):
    steps_ns = START_NS + 10 * MS * np.arange(3000)
    return [
        topic("/imu", steps_ns, steps_ns + wait_ns(rng, 1, 3000)),
        topic("/scan", steps_ns[::10], steps_ns[::10] + wait_ns(rng, 9, 300)),
    ]


def simulated_in_uneven_steps(rng):
    return [replace(one, stamp_ns=(one.stamp_ns - START_NS) // 3) for one in simulated(rng)]


def stamped_together(rng):
    stamps_ns, log_ns = camera(rng)
    return [topic("/left", stamps_ns, log_ns), topic("/right", stamps_ns, log_ns + wait_ns(rng, 0.2, len(log_ns)))]


def in_any_order(rng):
    stamps_ns, _ = camera(rng)
    return [topic(name, stamps_ns, stamps_ns + wait_ns(rng, 9, len(stamps_ns))) for name in ("/left", "/right")]


def with_its_info(rng):
    stamps_ns, log_ns = camera(rng)
    info = topic("/camera_info", stamps_ns, log_ns - 2 * MS, "sensor_msgs/msg/CameraInfo")
    return [topic("/image", stamps_ns, log_ns), info]


def two_timers(rng):
    return [topic(f"/timer{number}", *camera(rng, phase_ns=12 * MS * number)) for number in range(4)]


def without_stamps(rng):
    none_ns = np.full(600, -(2**63))
    return [topic(f"/{number}", none_ns, camera(rng)[1]) for number in range(2)]


@pytest.mark.parametrize(
    "make",
    [
        simulated,
        simulated_in_uneven_steps,
        stamped_together,
        in_any_order,
        with_its_info,
        two_timers,
        without_stamps,
        lambda _: [],
    ],
)
def test_what_something_else_explains_is_no_chain(make):
    for seed in range(20):
        assert find_links(make(np.random.default_rng(seed))) == []


def test_stamps_of_another_clock_than_the_log_are_not_stamped_again():
    rng = np.random.default_rng(1)
    stamps_ns, log_ns = camera(rng)
    again_ns = np.sort(log_ns + wait_ns(rng, 2, len(log_ns)))
    out = topic("/out", again_ns, again_ns + MS, has_age=False)
    assert find_links([topic("/in", stamps_ns, log_ns), out]) == []


def test_a_chain_is_on_the_first_screen_and_in_the_json(tmp_path):
    rng = np.random.default_rng(1)
    stamps_ns, log_ns = camera(rng)
    topics = {"/in": (stamps_ns, log_ns), "/out": followed(rng, stamps_ns, log_ns, 0.8, 40)}
    report, *_ = card(
        write(
            tmp_path / "a.mcap",
            {name: [*zip(log.tolist(), stamp.tolist(), strict=True)] for name, (stamp, log) in topics.items()},
        )
    )
    document = BagReport(report).document
    (row,) = document["chains"]
    assert (row["recording"], row["topic"], row["next_topic"]) == (str(tmp_path / "a.mcap"), "/in", "/out")
    assert row["share"] == pytest.approx(0.8, abs=0.06)
    (line,) = chain_lines([link for _, link in report.links], 3)
    assert "/out 39.5 ms later (82 %)" in line
    points = [
        item
        for section in BagReport(report).sections
        for block in section.blocks
        for item in getattr(block, "items", ())
    ]
    assert line in points


def test_many_topics_take_linear_time_and_few_lines():
    rng = np.random.default_rng(1)
    topics = []
    for number in range(200):
        first = camera(rng, 100)
        topics += [topic(f"/in{number}", *first), topic(f"/out{number}", *followed(rng, *first, 1, 20))]
    links = find_links(topics)
    assert sum(not link.stamps_again for link in links) == 200
    assert len([*chain_lines(links, 3)]) <= 2 * 3 + 1
    assert links[0].p50_ns < S
