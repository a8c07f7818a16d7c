"""Topics that carry the stamps of another one, and topics that stamp again.

Equal stamps are seen. Which message was made from another one is not: a driver that stamps several topics alike looks like a chain, so less
than `TOGETHER_NS` is none, and stamps of a simulation or in steps prove nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from operator import itemgetter

import numpy as np

from dds_trace.base.units import UNIT_NS, counted, first_of, format_duration, format_ratio

from .bounds import FEW, FEWEST, MOST, PHASES, WINDOW
from .clocks import SIMULATED_BEFORE_NS
from .periods import Int64
from .quantiles import indices_of, named_quantile, steps_of
from .recorded import NONE

TOGETHER_NS = UNIT_NS["ms"]
"""Topics with messages nearer to each other are published together, by one program."""


@dataclass(frozen=True, slots=True, eq=False)
class Stamped:
    """A topic's messages by log time, `NONE` for no stamp; both times of one clock where `has_age`."""

    topic: str
    message_type: str
    log_ns: Int64
    stamp_ns: Int64
    has_age: bool

    def first_of_stamps(self) -> tuple[Int64, Int64]:
        if NONE not in self.stamp_ns[:1] and (steps_of(self.stamp_ns) > 0).all():
            return self.stamp_ns, self.log_ns
        stamps, first = np.unique(self.stamp_ns, return_index=True)
        is_stamp = stamps != NONE
        return stamps[is_stamp], self.log_ns[first[is_stamp]]


@dataclass(frozen=True, slots=True)
class Link:
    """A topic that follows another one: `messages` of it, by `share` of the other one's in its time.

    `p50_ns` and `p99_ns` are from the log time of the first to its own; where it `stamps_again`, from stamp to stamp.
    """

    topic: str
    next_topic: str
    messages: int
    share: float
    p50_ns: float
    p99_ns: float | None
    stamps_again: bool = False


def find_links(topics: Sequence[Stamped]) -> list[Link]:
    """Return the topics that pass stamps on, by the topic at which these begin and by time, then those that stamp again."""
    usable = [topic for topic in topics if not topic.message_type.endswith("/CameraInfo")]  # comes with its image
    links = sorted(_passed_on(usable), key=lambda link: (link.topic, link.p50_ns))
    passed = {link.next_topic for link in links}
    return [*links, *_stamped_again([topic for topic in usable if topic.has_age and topic.topic not in passed])]


def _passed_on(topics: Sequence[Stamped]) -> Iterator[Link]:
    firsts = [topic.first_of_stamps() for topic in topics]
    number = np.repeat(np.arange(len(firsts)), [len(stamps) for stamps, _ in firsts])
    if not len(number):
        return
    stamp_ns, log_ns = (np.concatenate(column) for column in zip(*firsts, strict=True))
    order = np.argsort(stamp_ns, kind="stable")  # of ascending parts
    is_again = steps_of(stamp_ns[order]) == 0
    order = order[np.append(is_again, False) | np.append(False, is_again)]
    order = order[np.lexsort((log_ns[order], stamp_ns[order]))]
    stamp_ns, number = stamp_ns[order], number[order]
    begins = np.maximum.accumulate(np.where(np.diff(stamp_ns, prepend=NONE) > 0, np.arange(len(order)), 0))
    pairs, counts = np.unique(number * len(firsts) + number[begins], return_counts=True)
    edges = np.searchsorted(pairs, np.arange(len(firsts) + 1) * len(firsts))
    for follower, (stamps, logged) in enumerate(firsts):
        sources, shared = (part[edges[follower] : edges[follower + 1]] for part in (pairs % len(firsts), counts))
        shared = np.where(sources == follower, 0, shared)
        if 2 * shared.max(initial=0) < max(len(stamps), 2 * FEWEST):
            continue
        first = int(sources[shared.argmax()])
        others, began = firsts[first]
        if others[0] < SIMULATED_BEFORE_NS or np.gcd.reduce(others) > UNIT_NS["us"]:
            continue
        _, at, began_at = np.intersect1d(stamps, others, assume_unique=True, return_indices=True)
        waits_ns = logged[at] - began[began_at]
        if (waits_ns > 0).mean() >= MOST and np.median(waits_ns) >= TOGETHER_NS:
            yield _link(topics[first], topics[follower], waits_ns, began_at)


def share_of_inputs(indices: Int64) -> float | None:
    """Return the share of messages that led to another one, by their indices, from the first that did to the last."""
    return len(indices) / (int(indices.max() - indices.min()) + 1) if len(indices) else None


def _link(first: Stamped, follower: Stamped, waits_ns: Int64, inputs: Int64, *, stamps_again: bool = False) -> Link:
    share, p50_ns = share_of_inputs(inputs) or 0.0, float(np.median(waits_ns))
    return Link(
        first.topic, follower.topic, len(waits_ns), share, p50_ns, named_quantile(waits_ns, "p99"), stamps_again
    )


def _stamped_again(topics: Sequence[Stamped]) -> Iterator[Link]:
    """Yield topics with stamps that wander with the arrival of another topic, message by message.

    Two timers of one computer keep their phase, too, but each wanders by itself.
    """
    ordered = sorted(topics, key=lambda topic: len(topic.log_ns))

    @lru_cache(maxsize=FEWEST * FEWEST)
    def ranks(number: int, times: str, indices: bytes) -> Int64 | None:
        """Return the ranks of the differences of neighbouring steps; None where all are alike."""
        wander_ns = np.diff(getattr(ordered[number], times)[np.frombuffer(indices, np.int64)], 2)
        by_rank: Int64 = np.argsort(np.argsort(wander_ns, kind="stable"), kind="stable") - len(wander_ns) // 2
        return by_rank if wander_ns.any() else None

    links = dict[tuple[int, int, bool], Link]()
    for first, topic in enumerate(ordered):
        near = range(max(first - FEWEST, 0), min(first + FEWEST + 1, len(ordered)))
        others = [other for other in near if other != first and _are_as_many(topic, ordered[other])]
        for other, at, paired in _in_turn(topic, others, ordered):
            came, sent = ranks(first, "log_ns", at), ranks(other, "stamp_ns", paired)
            if came is not None and sent is not None and 2 * (came @ sent) > came @ came:
                follower = ordered[other]
                at_all = np.searchsorted(topic.log_ns, follower.stamp_ns, "right") - 1
                waits_ns = (follower.stamp_ns - topic.stamp_ns[at_all])[at_all >= 0]
                link = _link(topic, follower, waits_ns, at_all[at_all >= 0], stamps_again=True)
                links[min(first, other), max(first, other), first > other] = link
    yield from (link for _, link in sorted(links.items(), key=itemgetter(0)))


def _are_as_many(one: Stamped, other: Stamped) -> bool:
    fewer, more = sorted((len(one.log_ns), len(other.log_ns)))
    return fewer >= max(2 * WINDOW, (1 - FEW) * more)


def _in_turn(first: Stamped, others: Sequence[int], topics: Sequence[Stamped]) -> Iterator[tuple[int, bytes, bytes]]:
    """Yield the topics that stamp once after nearly each message of the first, with the indices of these messages and stamps."""
    stamps = [topics[other].stamp_ns[:PHASES] for other in others]
    at_of_all = first.log_ns.searchsorted(np.concatenate([np.empty(0, np.int64), *stamps]), "right") - 1
    ends = np.cumsum([0, *map(len, stamps)]).tolist()
    for other, (start, end) in zip(others, pairwise(ends), strict=True):
        at = at_of_all[start:end]
        paired = indices_of(at >= 0)
        at = at[paired]
        is_next = steps_of(at) == 1
        if len(is_next) > 2 * WINDOW and np.count_nonzero(is_next) / len(is_next) >= MOST:
            yield other, at.tobytes(), paired.tobytes()


def chain_lines(links: Sequence[Link], most: int) -> Iterator[str]:
    """Yield a line for each topic at which stamps begin: what follows, in the order of time."""
    passed = [link for link in links if not link.stamps_again]
    begins = list(dict.fromkeys(link.topic for link in passed))
    for begin in begins[:most]:
        following = [link for link in passed if link.topic == begin]
        steps = [
            f"{link.next_topic} {format_duration(link.p50_ns)} later ({format_ratio(link.share)})" for link in following
        ]
        last_ns = following[-1].p99_ns
        last = "" if last_ns is None else f"; p99 to {following[-1].next_topic} {format_duration(last_ns)}"
        yield f"the same stamps as {begin}: {', '.join(first_of(steps, most))}{last}"
    again = [link for link in links if link.stamps_again]
    for link in again[:most]:
        yield (
            f"stamps of {link.next_topic} follow {link.topic} message by message, {format_duration(link.p50_ns)} later: stamped again here, "
            "or one timer drives both"
        )
    hidden = max(len(begins) - most, 0) + max(len(again) - most, 0)
    if hidden:
        yield f"and {counted(hidden, 'more such topic')} not shown"
