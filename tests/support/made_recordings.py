"""Recordings of known truth as arrays: harmless ones, in which nothing is lost, and ones that lost messages."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

S, MS = 10**9, 10**6
START_NS = 1_700_000_000 * S
NONE = -(2**63)


@dataclass
class Topic:
    """Times in ns from 0 on by log time; stamps and numbers are None where messages have none."""

    log_ns: np.ndarray
    stamp_ns: np.ndarray | None = None
    numbers: np.ndarray | None = None
    publisher: np.ndarray | None = None
    is_command: bool = False

    def only(self, kept):
        parts = (self.log_ns, self.stamp_ns, self.numbers, self.publisher)
        return Topic(*(None if part is None else part[kept] for part in parts), self.is_command)


@dataclass
class Made:
    topics: dict[str, Topic]
    lost: int = 0

    def columns(self):
        """Yield name, is_command, and the columns that the rules take, by log time."""
        for name, topic in self.topics.items():
            order = np.argsort(topic.log_ns, kind="stable")
            log_ns = topic.log_ns[order].astype(np.int64) + START_NS
            count, none = len(log_ns), np.full(len(log_ns), NONE, np.int64)
            stamp_ns = none if topic.stamp_ns is None else topic.stamp_ns[order].astype(np.int64) + START_NS
            numbers = none if topic.numbers is None else topic.numbers[order].astype(np.int64)
            publisher = np.zeros(count, np.int64) if topic.publisher is None else topic.publisher[order]
            sizes = np.full(count, 100, np.int64)
            columns = log_ns, log_ns, stamp_ns, sizes, numbers, publisher, np.zeros(count, np.int64)
            yield name, topic.is_command, columns


def timer(rng, seconds=None, hz=None, *, start=None, jitter=None):
    """A timer's due times and arrivals: late by a jitter of their own."""
    hz = hz or float(rng.choice([10, 15, 20, 30, 50, 100]))
    seconds = seconds or rng.uniform(30, 120)
    start = rng.uniform(0, 1 / hz) if start is None else start
    due = (start + np.arange(int(seconds * hz)) / hz) * S
    jitter = rng.choice([0.002, 0.01, 0.05, 0.15]) if jitter is None else jitter
    late = np.abs(rng.normal(0, jitter / hz, len(due))) * S + 3 * MS
    return due, np.sort(due + late)


def stamped(rng, **options):
    due, log_ns = timer(rng, **options)
    return Topic(log_ns, due)


def with_companion(rng, topic, name="/topic"):
    seconds = float(np.max(topic.log_ns)) / S
    return Made({name: topic, "/imu": stamped(rng, seconds=seconds, hz=100, jitter=0.02)})


# Harmless: nothing is lost.


def events(rng):
    mean = rng.choice([0.05, 0.2, 1.0])
    count = int(rng.integers(100, 800))
    is_even = rng.random() < 0.5
    waits = rng.exponential(mean, count) if is_even else rng.lognormal(np.log(mean), rng.uniform(0.5, 1.2), count)
    log_ns = np.cumsum(waits) * S
    return with_companion(rng, Topic(log_ns, log_ns - 2 * MS if rng.random() < 0.5 else None))


def commands_by_hand(rng):
    hz, at, log = rng.choice([10, 20, 30, 50]), rng.uniform(0, 5), []
    for _ in range(int(rng.integers(3, 10))):
        length = rng.uniform(0.5, 6)
        count = max(int(length * hz), 2)
        log.append(at + np.cumsum(rng.normal(1, 0.02, count) / hz))
        at += length + rng.uniform(0.4, 15)
    log_ns = np.concatenate(log) * S
    stamp_ns = log_ns - 2 * MS if rng.random() < 0.7 else None
    return with_companion(rng, Topic(log_ns, stamp_ns, is_command=rng.random() < 0.5))


def computed(rng):
    count = int(rng.integers(400, 2000))
    kind = rng.integers(3)
    at = np.arange(count)
    slow = rng.uniform(0, 0.1) * np.sin(at / rng.uniform(30, 200))
    drift = 1 + slow + rng.uniform(0, 0.06) * np.sin(at / rng.uniform(5, 10))
    if kind == 0:  # two inputs in turn
        base = np.where(at % 2, rng.uniform(25, 35), rng.uniform(40, 50))
        waits = np.maximum(base * drift + rng.normal(0, 3, count), 15)
        waits += (rng.random(count) < 0.02) * rng.uniform(5, 20, count)
    elif kind == 1:  # durations of a computation
        waits = rng.uniform(20, 80) * drift * rng.lognormal(0, rng.uniform(0.1, 0.5), count)
    else:  # mostly short, now and then long
        waits = rng.uniform(20, 80) * drift * rng.normal(1, 0.06, count)
        waits *= np.where(rng.random(count) < 0.03, rng.uniform(1.2, 2.5, count), 1)
    log_ns = np.cumsum(waits) * MS
    return with_companion(rng, Topic(log_ns))


def loop_with_work(rng):
    """A loop that sleeps, and works, now and then for longer."""
    now_and_then = (rng.random(800) < 0.03) * rng.uniform(0.02, 0.4, 800)
    work = now_and_then if rng.random() < 0.5 else rng.lognormal(np.log(0.005), rng.uniform(0.3, 1.2), 800)
    log_ns = np.cumsum(0.05 + work + rng.normal(0, 0.001, 800)) * S
    return with_companion(rng, Topic(log_ns, log_ns - MS if rng.random() < 0.5 else None))


def changed_rates(rng):
    rates = rng.choice([10, 15, 20, 30], 3, replace=False)
    due = np.cumsum(np.concatenate([np.full(int(rng.uniform(10, 30) * hz), 1 / hz) for hz in rates])) * S
    log_ns = due + np.abs(rng.normal(0, 0.5 * MS, len(due)))
    return with_companion(rng, Topic(log_ns, due if rng.random() < 0.5 else None))


def two_rates(rng):
    """Two publishers of one topic that nothing distinguishes."""
    parts = [timer(rng, seconds=60, hz=hz) for hz in (rng.choice([10, 20]), rng.choice([3, 7, 15, 30]))]
    due, log_ns = (np.concatenate(column) for column in zip(*parts, strict=True))
    return with_companion(rng, Topic(log_ns, due if rng.random() < 0.5 else None))


def thinned(rng):
    topic = stamped(rng, seconds=rng.uniform(60, 150), hz=rng.choice([15, 30, 60]), jitter=0.04)
    at = np.arange(len(topic.log_ns))
    kept, of = [(2, 3), (3, 5), (5, 6), (3, 4), (1, 2)][rng.integers(5)]
    if rng.random() < 0.7:
        selected = at % of < kept
    else:  # a throttle
        period_ns = float(np.median(np.diff(topic.stamp_ns))) * of / kept
        selected, next_ns = np.zeros(len(at), bool), 0.0
        for n, log_ns in enumerate(topic.log_ns):
            if log_ns >= next_ns:
                selected[n], next_ns = True, (next_ns or log_ns) + period_ns
    topic = topic.only(selected)
    return with_companion(rng, topic if rng.random() < 0.8 else Topic(topic.log_ns), "/image_throttle")


def paused_simulation(rng):
    pauses = np.sort(rng.uniform(5, 50, int(rng.integers(1, 5))))
    lengths = rng.uniform(1.2, 8, len(pauses))
    speed = rng.choice([1.0, 0.5, 0.8])
    topics = {}
    for name in ("/scan", "/odom", "/joint_states")[: rng.integers(2, 4)]:
        due, log_ns = timer(rng, seconds=60, hz=rng.choice([10, 20, 50]))
        shift = (lengths[:, None] * (due[None, :] / S >= pauses[:, None])).sum(axis=0) * S
        stamps = due - START_NS + 100 * S
        topics[name] = Topic(log_ns / speed + shift, stamps)
    return Made(topics)


def paused_without_stamps(rng):
    made = paused_simulation(rng)
    return Made({name: Topic(topic.log_ns) for name, topic in made.topics.items()})


def replay_in_a_loop(rng):
    loops, rest = int(rng.integers(2, 6)), rng.uniform(0.01, 0.6)
    seconds, behind = rng.uniform(3, 15), rng.uniform(100, 9000)
    topics = {}
    for name in ("/imu/data", "/tf"):
        due, log_ns = timer(rng, seconds=seconds, hz=rng.choice([20, 50, 100]), jitter=0.02)
        again = np.arange(loops)[:, None] * (seconds + rest) * S
        topics[name] = Topic((log_ns + again).ravel(), np.tile(due - behind * S, loops))
    return Made(topics)


def script(rng):
    """A script that writes in one go, or a program that sleeps between its trials."""
    if rng.random() < 0.5:
        count = int(rng.integers(60, 3000))
        waits = rng.normal(21_000, 600, count) * rng.choice([1, 5, 40])
        waits[rng.integers(0, count, 3)] += rng.uniform(0.5, 60, 3) * MS
        return Made({"topic": Topic(np.cumsum(np.abs(waits)))})
    at, starts = 30.0, []
    for _ in range(9):
        starts.append((at, at + rng.uniform(1.2, 3)))
        at += rng.uniform(15, 36)
    marker, force, now = [], [], 0.0
    while now < at:
        end = next((end for start, end in starts if start <= now < end), None)
        marker.append(end + rng.uniform(0, 0.0004) if end else now + rng.uniform(0, 0.0004))
        now = (np.floor((end or now) / 0.1 + 1e-9) + 1) * 0.1
    now = 0.02
    while now < at:
        end = next((end for start, end in starts if start <= now < end), None)
        now = end + rng.uniform(0.001, 0.005) if end else now
        force.append(now)
        now += rng.normal(0.094, 0.003)
    marks, forces = np.array(marker) * S, np.array(force) * S
    return Made({"/marker": Topic(marks + 300_000, marks), "/force": Topic(forces), "/pos": Topic(forces + 100_000)})


def set_clock(rng):
    """The clock of the recording computer is set forward; its timers go on."""
    at, by = rng.uniform(10, 40), rng.uniform(1.2, 6)
    topics = {}
    for number, hz in enumerate(rng.choice([1, 2, 5, 10, 20, 25, 50], 4, replace=False)):
        due, log_ns = timer(rng, seconds=60, hz=float(hz), jitter=0.01)
        topics[f"/timer{number}"] = Topic(log_ns + (due > at * S) * by * S, None)
    return Made(topics)


HARMLESS = {
    "events": events,
    "commands by hand": commands_by_hand,
    "computed topics": computed,
    "loops with work": loop_with_work,
    "rates that change": changed_rates,
    "two rates on one topic": two_rates,
    "thinned topics": thinned,
    "paused simulations": paused_simulation,
    "paused, without stamps": paused_without_stamps,
    "replays in a loop": replay_in_a_loop,
    "scripts": script,
    "clocks set": set_clock,
}


# Losses.


def lost_at_random(rng, topic):
    return rng.random(len(topic.log_ns)) > rng.uniform(0.01, 0.3)


def lost_in_bursts(rng, topic):
    kept = np.ones(len(topic.log_ns), bool)
    for _ in range(int(rng.integers(1, 6))):
        first = rng.integers(20, len(kept) - 60)
        kept[first : first + rng.integers(5, 50)] = False
    return kept


def every_second_lost(rng, topic):
    at = np.arange(len(topic.log_ns))
    return (at // rng.integers(40, 100) % 2 == 0) | (at % 2 == 0)


def queues_overflow(rng, topic):
    """Stalls after which the last messages of a queue come at once; what did not fit is lost. Changes the arrivals."""
    kept = np.ones(len(topic.log_ns), bool)
    period_ns = float(np.median(np.diff(topic.log_ns)))
    for first in rng.choice(np.arange(30, len(kept) - 80, 70), 3, replace=False):
        stall, depth = int(rng.integers(15, 40)), int(rng.integers(3, 10))
        kept[first : first + stall - depth] = False
        end_ns = topic.log_ns[first + stall]
        topic.log_ns[first + stall - depth : first + stall] = end_ns - np.arange(depth, 0, -1) * min(
            50_000, period_ns / 50
        )
    return kept


def lost_of_one_publisher(rng, topic):
    """Two publishers of one topic, of which one loses messages."""
    period_ns = float(np.median(np.diff(topic.log_ns)))
    count = len(topic.log_ns)
    kept = np.append(rng.random(count) > rng.uniform(0.05, 0.3), np.ones(count, bool))
    kept[count - 1] = True
    topic.log_ns = np.append(topic.log_ns, topic.log_ns + 0.3 * period_ns)
    for name in ("stamp_ns", "numbers"):
        values = getattr(topic, name)
        if values is not None:
            setattr(topic, name, np.append(values, values + (0.3 * period_ns if name == "stamp_ns" else 0)))
    if topic.stamp_ns is not None or topic.numbers is not None:
        topic.publisher = np.repeat([1, 2], count)
    return kept


def lost_by_recorder(rng, evidence):
    """Three topics that all lack the same stretches: the recorder stood, or a file of it is gone."""
    topics, lost = {}, 0
    stretches = [
        (at, at + rng.choice([rng.uniform(0.7, 4), 0.7, 2.0]))
        for at in np.sort(rng.choice(np.arange(5, 50, 8), 3, replace=False))
    ]
    for number, hz in enumerate(rng.choice([10, 20, 25, 50, 100], 3, replace=False)):
        due, log_ns = timer(rng, seconds=60, hz=float(hz), jitter=rng.choice([0.002, 0.01]))
        topic = Topic(
            log_ns, due if evidence == "stamps" else None, np.arange(len(due)) if evidence == "numbers" else None
        )
        kept = ~np.any([(log_ns >= first * S) & (log_ns < last * S) for first, last in stretches], axis=0)
        topics[f"/topic{number}"], lost = topic.only(kept), lost + int((~kept).sum())
    return Made(topics, lost)


LOSSES = {
    "random": lost_at_random,
    "bursts": lost_in_bursts,
    "every second": every_second_lost,
    "queues": queues_overflow,
    "of one publisher": lost_of_one_publisher,
    "of all topics": lost_by_recorder,
}
EVIDENCE = ("numbers", "stamps", "arrival")


def lossy(rng, loss, evidence):
    """Return a recording with losses of a kind, which numbers, stamps or arrival alone can show."""
    if loss == "of all topics":
        return lost_by_recorder(rng, evidence)
    due, log_ns = timer(rng, seconds=rng.uniform(30, 90), jitter=rng.choice([0.002, 0.01, 0.05]))
    topic = Topic(log_ns, due if evidence == "stamps" else None)
    if evidence == "numbers":
        topic.numbers = np.arange(len(log_ns))
    kept = LOSSES[loss](rng, topic)
    kept[[0, -1]] = True
    made = with_companion(rng, topic.only(kept))
    made.lost = int((~kept).sum())
    return made
