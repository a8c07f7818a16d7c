"""The first sentences of a report: losses, from which size on who is fastest and by how much, what a bridge costs, where.

Each sentence rests on verdicts of the analyzer (`verdicts.answers`, `verdicts.bridge_cost`) within one pair of devices and
one link. Over several places a sentence names a range of factors and never a mean.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import polars as pl

from dds_trace.analyzer.model.setting import condition_of
from dds_trace.analyzer.verdicts.answers import Clarity
from dds_trace.base.printable import printable
from dds_trace.base.units import counted, format_size

from .groups import data_type_label, device_pair, domain_label, format_count, format_ratio, way_words
from .verdicts import MODES, conditions_label, contender_labels, place_label

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

    from dds_trace.analyzer.analysis import Analysis
    from dds_trace.analyzer.verdicts.answers import CaseAnswer

    from .groups import Group, Groups, VendorLabels
    from .numbers import Values

LOSSY_SHARE = 0.01
"""Share of lost messages above which a choice is named as one not to use: its p99 is a lost message then."""

BUSY_SHARE = 0.25
"""Share of the recordings that ran on a full processor from which on a report says so at once."""

MOST_NAMED = 3
"""Most places or choices that a sentence names; the table below it has all of them."""


def loss_sentence(groups: Groups, values: Values) -> str:
    """Say which share of the messages never came back, and where all of them were lost; empty without a loss."""
    planned, lost = _planned_and_lost(groups.groups, values)
    if not lost:
        return ""
    said = f"{format_ratio(lost / planned)} of the messages never came back ({format_count(lost)} of {format_count(planned)})"
    lossy = [one for one in groups.groups if _planned_and_lost([one], values)[1]]
    scope = _scope(lossy, groups)
    return f"{said}{f', all of them {scope}' if scope else ''}."


def _planned_and_lost(groups: Iterable[Group], values: Values) -> tuple[int, int]:
    """Return the messages that were due, and those of them that did not come back, the unsent ones too."""
    held = list(groups)
    planned = sum(one.published + round(values.plain["unsent"][one.index] or 0) for one in held)
    return planned, planned - sum(one.received for one in held)


def _scope(lossy: Sequence[Group], groups: Groups) -> str:
    """Say in which link, way and from which size on groups lie; empty if they have nothing in common."""
    parts = []
    sides: tuple[tuple[Callable[[Group], str], str], ...] = (
        (lambda one: groups.series_of(one).vendor_label, "by {}"),
        (lambda one: domain_label(groups.series_of(one)), "{}"),
        (lambda one: printable(groups.series_of(one).connectivity), "over {}"),
    )
    ways = {domain_label(groups.series_of(one)) for one in lossy}
    of_ways = {
        groups.series_of(one).vendor_label
        for one in groups.groups
        if domain_label(groups.series_of(one)) in ways
    }
    for value_of, words in sides if len(of_ways) > 1 else sides[1:]:
        own, every = ({value_of(one) for one in of} for of in (lossy, groups.groups))
        if own != every and len(own) <= MOST_NAMED:
            parts.append(words.format(_either(sorted(own)).replace(" or through ", " or ")))
    cells = [groups.cell_of(one) for one in lossy]
    of_types = {cell.data_type for cell in cells}
    if len(of_types) == 1:
        least = min(cell.payload_bytes for cell in cells)
        measured = [cell.payload_bytes for cell in groups.cells if cell.data_type in of_types]
        if least > min(measured):
            parts.append(_from_size(least, max(measured)))
    return ", ".join(parts)


def _from_size(least: int, largest: int) -> str:
    return f"at {format_size(least)}" if least == largest else f"from {format_size(least)} on"


def avoid_sentence(answers: Sequence[CaseAnswer], vendors: VendorLabels) -> str:
    """Name the choices that lost more than `LOSSY_SHARE` of some messages, the worst first; empty if none did."""
    labels = contender_labels(answers, vendors)
    # Place -> data type, label of the choice -> smallest size, share lost.
    of_place: dict[str, dict[tuple[str, str], tuple[int, float]]] = {}
    largest = _largest(answers)
    for answer in answers:
        for one in answer.contenders:
            lost = 1.0 - (one.received.value or 0.0)
            if lost > LOSSY_SHARE:
                of_choices = of_place.setdefault(_place(answer), {})
                key = answer.data_type, labels[one.name]
                least, worst = of_choices.get(key, (answer.payload_bytes, 0.0))
                of_choices[key] = min(least, answer.payload_bytes), max(worst, lost)
    together: dict[tuple[tuple[str, ...], str], list[tuple[str, float]]] = {}
    for place, of_choices in of_place.items():
        of_size: dict[tuple[str, int], list[tuple[str, float]]] = {}
        for (data_type, label), (least, worst) in of_choices.items():
            of_size.setdefault((data_type, least), []).append((label, worst))
        for (data_type, least), lossy in of_size.items():
            size = _from_size(least, largest[data_type])
            what = size if len(largest) == 1 else f"for {data_type_label(data_type)} {size}"
            names = tuple(sorted(label for label, _ in lossy))
            together.setdefault((names, what), []).append((place, max(worst for _, worst in lossy)))
    every = set(labels.values())
    ordered = sorted(together.items(), key=lambda item: -max(worst for _, worst in item[1]))
    named = [
        f"{_choices(names, every)} {what}{_at_places(places, len({_place(one) for one in answers}))}"
        for (names, what), places in ordered
    ]
    return f"Do not use, because of losses: {_some(named, 'more in the table')}." if named else ""


def _largest(answers: Iterable[CaseAnswer]) -> dict[str, int]:
    """Return the largest size of each data type."""
    sizes: dict[str, int] = {}
    for answer in answers:
        sizes[answer.data_type] = max(answer.payload_bytes, sizes.get(answer.data_type, 0))
    return sizes


def _choices(names: Sequence[str], every: Collection[str]) -> str:
    if len(every) > 1 and set(names) == set(every):
        return "any choice"
    shown = list(names[:MOST_NAMED])
    return _and([*shown, f"{len(names) - MOST_NAMED} more"] if len(names) > MOST_NAMED else shown)


def _at_places(places: Sequence[tuple[str, float]], all_places: int) -> str:
    worst = format_ratio(max(share for _, share in places))
    where = f"{_places([place for place, _ in places], all_places)}: " if all_places > 1 else ""
    return f" ({where}up to {worst} lost)"


@dataclass(frozen=True, slots=True)
class Stretch:
    """Neighbouring sizes with the same outcome.

    Attributes:
        winner: name of the contender that leads at these sizes, empty where none does, None where it depends on the rate.
        sizes: the sizes, rising.
        cases: the answers.
    """

    winner: str | None
    sizes: tuple[int, ...]
    cases: tuple[CaseAnswer, ...]


def stretches(cases: Iterable[CaseAnswer]) -> tuple[Stretch, ...]:
    """Cut the compared cases of one kind of data and one place into stretches of sizes."""
    of_size: dict[int, list[CaseAnswer]] = {}
    for case in cases:
        if case.clarity is not Clarity.ONLY_ONE:
            of_size.setdefault(case.payload_bytes, []).append(case)
    cut: list[Stretch] = []
    for size, of_rates in sorted(of_size.items()):
        won = {case.leaders[0].name for case in of_rates if case.clarity is Clarity.CLEAR}
        winner = "" if not won else won.pop() if len(won) == 1 else None
        if cut and cut[-1].winner == winner:
            last = cut.pop()
            cut.append(Stretch(winner, (*last.sizes, size), (*last.cases, *of_rates)))
        else:
            cut.append(Stretch(winner, (size,), tuple(of_rates)))
    return tuple(cut)


def winner_sentences(answers: Sequence[CaseAnswer], vendors: VendorLabels) -> tuple[str, ...]:
    """Say for each domain mode and kind of data from which size on which choice is fastest, and by which factor.

    Places with the same outcome share a sentence part.
    """
    labels = contender_labels(answers, vendors)
    several_types = len({answer.data_type for answer in answers}) > 1
    kinds: dict[tuple[str, str], dict[str, list[CaseAnswer]]] = {}
    for answer in answers:
        if answer.clarity is not Clarity.ONLY_ONE:
            of_places = kinds.setdefault((answer.domain_mode, answer.data_type), {})
            of_places.setdefault(_place(answer), []).append(answer)
    knows_p99 = any(answer.leader_p99 for answer in answers)
    said = []
    for (mode, data_type), of_places in sorted(kinds.items(), key=lambda item: item[0][0] != "same"):
        if not any(case.clarity is Clarity.CLEAR for cases in of_places.values() for case in cases):
            continue
        words = MODES.get(mode, printable(mode))
        where = f"In the {words}" if mode == "same" else f"Across {words}"
        what = f"{where}, {data_type_label(data_type)}" if several_types else where
        alike: dict[tuple[tuple[str | None, tuple[int, ...]], ...], list[str]] = {}
        for place, cases in of_places.items():
            signature = tuple((one.winner, one.sizes) for one in stretches(cases))
            alike.setdefault(signature, []).append(place)
        most_places_first = sorted(alike.values(), key=lambda held: -len(held))
        told = most_places_first[: MOST_NAMED if len(of_places) <= MOST_NAMED else 1]
        for places in told:
            cases = [case for place in places for case in of_places[place]]
            outcome = _outcome(stretches(cases), labels, knows_p99=knows_p99)
            said.append(f"{what}{_on(places, len(of_places))}: {outcome}.")
        left = len(of_places) - sum(map(len, told))
        if left:
            said[-1] += f" Elsewhere see the table ({counted(left, 'pair')} of devices and links)."
    if said and not knows_p99:
        said.append("At p99 nothing is told apart: that takes more slow messages, in longer or more runs.")
    return tuple(said)


def _on(places: Sequence[str], all_places: int) -> str:
    return "" if all_places == 1 else f", on {_places(places, all_places)}"


def _places(places: Sequence[str], all_places: int) -> str:
    """Name up to `MOST_NAMED` places; of more their number among all."""
    if len(places) == all_places > 1:
        return f"each of {all_places} pairs of devices and links"
    if len(places) <= MOST_NAMED:
        return "; ".join(places)
    of_all = f"{len(places)} of {all_places}"
    return f"{of_all} pairs of devices and links"


def _outcome(cut: Sequence[Stretch], labels: Mapping[str, str], *, knows_p99: bool) -> str:
    """Put the stretches of one outcome into words; more than `MOST_NAMED` are put together by winner."""
    sizes = [size for one in cut for size in one.sizes]
    is_mixed = len(cut) > MOST_NAMED
    parts = []
    for one in _by_winner(cut) if is_mixed else cut:
        where = _span(one.sizes, sizes)
        if one.winner is None:
            parts.append(f"{where} it depends on the rate ({_wins(one.cases, labels)})")
        elif not one.winner:
            parts.append(f"{where} no clear winner")
        else:
            parts.append(f"{where} {labels[one.winner]} is fastest{_by_how_much(one, knows_p99=knows_p99)}")
    return f"{'no choice is fastest throughout; ' if is_mixed else ''}{'; '.join(parts)}"


def _wins(cases: Sequence[CaseAnswer], labels: Mapping[str, str]) -> str:
    """Count the comparisons that each choice leads: `Zenoh is fastest in 2 of 4 comparisons, Fast DDS in 1`."""
    won = Counter(case.leaders[0].name for case in cases if case.clarity is Clarity.CLEAR)
    (first, count), *others = won.most_common()
    of_all = f"{labels[first]} is fastest in {count} of {counted(len(cases), 'comparison')}"
    return ", ".join([of_all, *(f"{labels[name]} in {wins}" for name, wins in others)])


def _by_winner(cut: Sequence[Stretch]) -> list[Stretch]:
    """Join the stretches with the same outcome, winners of most sizes first."""
    joined: dict[str | None, Stretch] = {}
    for one in cut:
        held = joined.get(one.winner, Stretch(one.winner, (), ()))
        joined[one.winner] = Stretch(one.winner, (*held.sizes, *one.sizes), (*held.cases, *one.cases))
    return sorted(joined.values(), key=lambda one: (not one.winner, -len(one.sizes)))


def _span(own: Sequence[int], every: Sequence[int]) -> str:
    """Name sizes among all: `up to 33 KB`, `from 1 MB on`, `at 145 KB`, `at every size`, `at 33 KB and 1 MB`."""
    if len(own) < sum(own[0] <= size <= own[-1] for size in every):
        return f"at {_and(map(format_size, own))}"
    low, high = format_size(own[0]), format_size(own[-1])
    first, last = own[0] == min(every), own[-1] == max(every)
    if first and last:
        return f"at {low}" if low == high else f"at every size ({low} to {high})"
    if last and low != high:
        return f"from {low} on"
    if first and low != high:
        return f"up to {high}"
    return f"at {low}" if low == high else f"from {low} to {high}"


def _by_how_much(stretch: Stretch, *, knows_p99: bool) -> str:
    """Say how many times as long the next choice takes, at each percentile where the verdict holds.

    Args:
        stretch: sizes with a winner.
        knows_p99: whether any choice of the campaign leads at p99; where none does, a sentence of its own says so.
    """
    parts = []
    for percentile, label in (("p50", "at the median"), ("p99", "at p99")):
        won = [case for case in stretch.cases if getattr(case, f"leader_{percentile}") == stretch.winner]
        factors = [factor for case in won if (factor := _factor(case, percentile)) is not None]
        if factors:
            of_all = (
                f" in {len(won)} of {len(stretch.cases)} comparisons" if len(won) < len(stretch.cases) else ""
            )
            parts.append(f"{_factors(factors)} as long {label}{of_all}")
        elif percentile == "p50" or knows_p99:
            parts.append(f"{label} not told apart")
    return f" (the next takes {', '.join(parts)})"


def _factor(case: CaseAnswer, percentile: str) -> float | None:
    """Return how many times as long as the leader the next choice takes that is not lost; None if all others are lost."""
    times = {one.name: getattr(one, f"{percentile}_ns") for one in case.contenders}
    own = times.pop(getattr(case, f"leader_{percentile}"))
    others = [value for value in times.values() if value is not None and value != float("inf")]
    return min(others) / own if others and own else None


def _factors(factors: Sequence[float]) -> str:
    low, high = (f"{end:.2g}" if end < 10 else f"{end:.0f}" for end in (min(factors), max(factors)))
    return f"{low} times" if low == high else f"{low} to {high} times"


def bridge_sentence(costs: pl.DataFrame, vendors: VendorLabels) -> str:
    """Say for each bridge and middleware how many times as long as in the same domain a message takes; empty without one.

    Args:
        costs: `Details.bridge_costs`.
        vendors: labels of the vendors.
    """
    way_columns = ("bridge", "vendor", "relay_vendor")
    of_latency = costs.filter(pl.col("metric") == "latency")
    several = of_latency["vendor"].n_unique() > 1
    said = []
    for (bridge, vendor, relay_vendor), rows in of_latency.group_by(*way_columns, maintain_order=True):
        factors = _cost_words(rows)
        if factors:
            pair = vendors.of_pair(str(vendor), None if relay_vendor is None else str(relay_vendor))
            said.append(f"{way_words(str(bridge))}{f' with {pair}' if several else ''} {factors}")
    return f"A message takes, against the same domain: {'; '.join(said)}." if said else ""


def _cost_words(rows: pl.DataFrame) -> str:
    """Return the factors of one way at both percentiles where it is clearly slower, and what became of the others."""
    is_finite = pl.col("ratio").is_finite().fill_null(value=False)
    parts, lost, others, compared = [], 0, 0, 0
    for name, label in (("p50", "at the median"), ("p99", "at p99")):
        own = rows.filter(statistic=name)
        slower = own.filter((pl.col("verdict") == "worse") & is_finite)
        if not slower.is_empty():
            parts.append(f"{_factors(slower['ratio'].to_list())} as long {label}")
            lost = max(lost, own.filter(~is_finite).height)
            others = max(others, own.filter((pl.col("verdict") != "worse") & is_finite).height)
            compared = max(compared, own.height)
    noted = [
        f"{words} in {count}" for count, words in ((lost, "lost"), (others, "not clearly slower")) if count
    ]
    within = f" ({', '.join(noted)} of {counted(compared, 'comparison')})" if noted else ""
    return f"{', '.join(parts)}{within}" if parts else ""


def where_sentence(analysis: Analysis, groups: Groups, values: Values) -> str:
    """Say on which devices and link this was measured, and that the machine was busy where it was."""
    links: dict[str, list[str]] = {}
    for series in groups.series:
        pair = device_pair(series.ping_device, series.relay_device)
        if series.relay_device == series.ping_device:
            pair = f"one machine ({pair})"
        conditions = conditions_label(condition_of(series.setting))
        link = printable(series.connectivity) + (f" with {conditions}" if conditions else "")
        if link not in links.setdefault(pair, []):
            links[pair].append(link)
    of_links: dict[tuple[str, ...], list[str]] = {}
    for pair, of_pair in links.items():
        of_links.setdefault(tuple(of_pair), []).append(pair)
    named = [
        f"{_and(pairs)}, {'each ' if len(pairs) > 1 and len(of_pairs) > 1 else ''}{_and(of_pairs)}"
        for of_pairs, pairs in of_links.items()
    ]
    counts = sorted({round(count) for count in values.plain["runs"] if count})
    runs = f"; {_run_counts(counts)} of each" if counts else ""
    return f"Measured on {_some(named, 'more pairs of devices')}{runs}.{_busy(analysis)}"


def _run_counts(counts: Sequence[int]) -> str:
    last = counted(counts[-1], "run")
    return last if len(counts) == 1 else f"{counts[0]} to {last}"


def _busy(analysis: Analysis) -> str:
    """Warn where at least `BUSY_SHARE` of the recordings ran on a full processor."""
    full = sum(one.count for one in analysis.findings if one.code == "cpu_saturated")
    recordings = len(analysis.sessions)
    if not full or full < BUSY_SHARE * recordings:
        return ""
    return f" The machine was busy in {full} of {counted(recordings, 'recording')}: these times hold waiting for a processor."


def _place(answer: CaseAnswer) -> str:
    return place_label(answer.ping_device, answer.relay_device, answer.connectivity, answer.conditions)


def _some(parts: Sequence[str], rest: str, between: str = "; ") -> str:
    """Join the first `MOST_NAMED` parts, and count the others."""
    left = len(parts) - MOST_NAMED
    return between.join([*parts[:MOST_NAMED], *([f"and {left} {rest}"] if left > 0 else [])])


def _either(names: Sequence[str]) -> str:
    *first, last = names
    return f"{', '.join(first)} or {last}" if first else last


def _and(names: Iterable[str]) -> str:
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last
