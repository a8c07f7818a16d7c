"""What a link and a device cost, by the medians of the same message and setup."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable
from dataclasses import replace
from functools import partial

from dds_trace.base.printable import printable

from .groups import Groups, Series, device_pair, joined
from .headline import factor_words
from .numbers import Intervals, Values

MOST_COMPARED = 3


def place_sentence(groups: Groups, values: Values, intervals: Intervals) -> str:
    """Say how many times as long a message takes over each link, and from each device, as over and from the fastest.

    Factors are of results without losses whose intervals between runs do not overlap.
    """
    relays = {series.relay_device for series in groups.series}
    same_relay = len(relays) == 1 and not relays & {series.ping_device for series in groups.series}

    def device(series: Series) -> str:
        return printable(series.ping_device) if same_relay else device_pair(series.ping_device, series.relay_device)

    compared = partial(_against_fastest, groups, values, intervals)
    parts = (
        *compared("over", lambda one: printable(one.connectivity), lambda one: replace(one, connectivity="")),
        *compared("from" if same_relay else "on", device, lambda one: replace(one, ping_device="", relay_device=None)),
    )
    return f"At the median a message takes {'; '.join(parts)}." if parts else ""


def _against_fastest(
    groups: Groups,
    values: Values,
    intervals: Intervals,
    preposition: str,
    name_of: Callable[[Series], str],
    without: Callable[[Series], Series],
) -> tuple[str, ...]:
    if len({name_of(series) for series in groups.series}) < 2:
        return ()
    medians = values.times_ns["latency"]["p50"]
    # Everything else alike -> name -> group.
    alike: dict[Hashable, dict[str, int]] = {}
    for group in groups.groups:
        series, index = groups.series_of(group), group.index
        is_whole = group.published == group.received and not values.plain["unsent"][index]
        if is_whole and intervals.is_between_runs("latency", "p50", index):
            alike.setdefault((group.cell, without(series)), {})[name_of(series)] = index
    compared = [named for named in alike.values() if len(named) > 1]
    if not compared:
        return ()
    won = Counter(min(named, key=lambda name: medians[named[name]] or 0) for named in compared)
    (fastest, _), *_ = won.most_common(1)
    parts = []
    for name in dict.fromkeys(name for named in compared for name in sorted(named) if name != fastest):
        pairs = [(named[name], named[fastest]) for named in compared if {name, fastest} <= named.keys()]
        factors = [
            own / base
            for slow, fast in pairs
            if (own := medians[slow]) and (base := medians[fast]) and _are_apart(intervals, own, slow, fast)
        ]
        unclear = f" (no clear difference in {len(pairs) - len(factors)} of {len(pairs)} comparisons)"
        if factors:
            noted = unclear if len(factors) < len(pairs) else ""
            parts.append(f"{preposition} {name} {factor_words(factors)} as long{noted}")
    return (f"{joined(parts[:MOST_COMPARED])} as {preposition} {fastest}",) if parts else ()


def _are_apart(intervals: Intervals, own_ns: float, own: int, base: int) -> bool:
    (own_low, own_high), (base_low, base_high) = (intervals.ends("latency", "p50", group) for group in (own, base))
    return (own_low or 0) > (base_high or own_ns) or (own_high or own_ns) < (base_low or 0)
