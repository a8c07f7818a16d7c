"""The answer in words: which middleware and bridge for which data, as far as the numbers carry it."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from reports.figures.domain_difference import domain_pairs
from reports.groups import METRICS, data_type_label, domain_label, groups_info, vendor_pair_label
from reports.text import format_count, format_ns, format_ratio
from reports.values import values_info
from reports.verdicts import (
    CLEARLY,
    MODES,
    Verdict,
    cells_label,
    clearly_faster,
    contender_labels,
    verdicts_info,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

    from analyzer.analysis import Analysis
    from reports.groups import Groups
    from reports.values import Values


@dataclass(frozen=True, slots=True)
class Answer:
    """What a reader may take away.

    Attributes:
        headline: the one sentence.
        metric: the metric that is compared (latency, or what was measured instead).
        verdicts: by kind of data; empty where nothing could be compared.
        remarks: further sentences: levels, cost of bridges, losses.
        rule: what `clearly` means; empty where nothing was compared.
    """

    headline: str
    metric: str
    verdicts: tuple[Verdict, ...]
    remarks: tuple[str, ...]
    rule: str


def answer_info(analysis: Analysis) -> Answer:
    """The answer that `analysis.summary` supports."""
    groups, values = groups_info(analysis), values_info(analysis)
    metric = values.default_metric
    if not groups.groups:
        return Answer("No measurement was found.", metric, (), (), "")
    if not values.has(metric):
        return Answer(
            "No message came back, so there is no time to compare.", metric, (), (_losses(values),), ""
        )
    verdicts = verdicts_info(groups, values, metric)
    bridges = _bridge_remarks(analysis, groups, values, metric)
    remarks = (*_unknown_remarks(metric), *_level_remarks(groups, values, metric), *bridges, _losses(values))
    return Answer(
        _headline(verdicts, groups), metric, verdicts, remarks, CLEARLY if verdicts or bridges else ""
    )


def _headline(verdicts: tuple[Verdict, ...], groups: Groups) -> str:
    if not verdicts:
        vendors = sorted({vendor_pair_label(series) for series in groups.series})
        if len(vendors) == 1:
            return f"Only {vendors[0]} was measured, so there is no choice of middleware to make."
        names = sorted(set(contender_labels(groups).values()))
        return f"{_and(names)} were not measured under equal conditions, so no choice can be made from this."
    if not any(verdict.wins for verdict in verdicts):
        cells = sum(verdict.cells for verdict in verdicts)
        where = "the one cell" if cells == 1 else f"any of the {cells} cells"
        return f"Inconclusive: no choice was clearly faster than the others in {where} compared."
    modes = dict.fromkeys(verdict.mode for verdict in verdicts)
    return " ".join(_mode_sentence(mode, [one for one in verdicts if one.mode == mode]) for mode in modes)


def _mode_sentence(mode: str, verdicts: list[Verdict]) -> str:
    """Who was fastest in one domain mode, over all kinds of data."""
    wins: Counter[str] = Counter()
    for verdict in verdicts:
        wins.update({win.contender: win.cells for win in verdict.wins})
    cells = sum(verdict.cells for verdict in verdicts)
    where = "In the same domain" if mode == MODES["same"] else f"Across {mode}"
    if not wins:
        return f"{where}: inconclusive in all {cells_label(cells)}."
    (name, count), *others = wins.most_common()
    if count == cells:
        return f"{where}, {name} was clearly fastest in {'the one cell' if cells == 1 else f'all {cells} cells'}."
    rest = [f"{other} in {n}" for other, n in others[:3]]
    inconclusive = sum(verdict.inconclusive for verdict in verdicts)
    rest += [f"{inconclusive} inconclusive"] if inconclusive else []
    return f"{where}, {name} was clearly fastest in {count} of {cells_label(cells)} ({', '.join(rest)})."


def _level_remarks(groups: Groups, values: Values, metric: str) -> list[str]:
    """The range of medians per data type, with where its ends are."""
    remarks = []
    for data_type in dict.fromkeys(cell.data_type for cell in groups.cells):
        medians = sorted(
            (median, group.index)
            for group in groups.groups
            if groups.cell_of(group).data_type == data_type
            and (median := values.times_ns[metric]["p50"][group.index]) is not None
        )
        if not medians:
            continue
        low, high = ((ns, groups.groups[index]) for ns, index in (medians[0], medians[-1]))
        first = f"{data_type_label(data_type)}: median {METRICS[metric].lower()} {format_ns(low[0])}"
        if low[1] == high[1]:
            remarks.append(f"{first} ({_place(groups, low[1].index)}).")
        else:
            ends = (_place(groups, low[1].index), _place(groups, high[1].index))
            remarks.append(f"{first} ({ends[0]}) to {format_ns(high[0])} ({ends[1]}).")
    return remarks


def _place(groups: Groups, index: int) -> str:
    group = groups.groups[index]
    label = groups.labels[group.series]
    cell = groups.cell_of(group).label.removeprefix(data_type_label(groups.cell_of(group).data_type)).strip()
    return f"{cell}, {label}"


def _bridge_remarks(analysis: Analysis, groups: Groups, values: Values, metric: str) -> list[str]:
    """What crossing to another domain did to the median, per vendor and way."""
    ways: dict[str, list[tuple[int, int]]] = {}
    for same, different in domain_pairs(analysis):
        medians = values.times_ns[metric]["p50"]
        if medians[same] is not None and medians[different] is not None:
            series = groups.series_of(groups.groups[different])
            ways.setdefault(f"{vendor_pair_label(series)}, {domain_label(series)}", []).append(
                (same, different)
            )
    return [_bridge_remark(way, pairs, values, metric) for way, pairs in ways.items()]


def _bridge_remark(way: str, pairs: list[tuple[int, int]], values: Values, metric: str) -> str:
    medians = values.times_ns[metric]["p50"]
    added = sorted((medians[different] or 0) - (medians[same] or 0) for same, different in pairs)
    slower = sum(clearly_faster(values, metric, same, different) for same, different in pairs)
    faster = sum(clearly_faster(values, metric, different, same) for same, different in pairs)
    if len(pairs) == 1:
        verdict = "clearly slower" if slower else "clearly faster" if faster else "inconclusive"
        return (
            f"{way}: median {_signed(added[0])} against the same domain in the one cell compared; {verdict}."
        )
    counts = [f"clearly slower in {slower} of {cells_label(len(pairs))}"] if slower else []
    counts += [f"clearly faster in {faster}"] if faster else []
    counts += [f"inconclusive in {len(pairs) - slower - faster}"] if slower + faster < len(pairs) else []
    return f"{way}: median {_signed(added[0])} to {_signed(added[-1])} against the same domain; {', '.join(counts)}."


def _signed(value_ns: float) -> str:
    return f"+{format_ns(value_ns)}" if value_ns > 0 else format_ns(value_ns)


def _unknown_remarks(metric: str) -> list[str]:
    if metric == "latency":
        return []
    what = METRICS[metric].lower()
    return [
        f"No relay's trace was found: the latency is unknown, and the {what} below has the time in the relay in it."
    ]


def _losses(values: Values) -> str:
    published = sum(count or 0 for count in values.plain["published"])
    received = sum(count or 0 for count in values.plain["received"])
    lost = published - received
    if lost == 0:
        return "Every message came back."
    touched = sum(
        (a or 0) > (b or 0) for a, b in zip(values.plain["published"], values.plain["received"], strict=True)
    )
    groups = f"{format_count(touched)} of {format_count(len(values.plain['published']))} groups"
    share = format_ratio(lost / published)
    return f"{format_count(lost)} of {format_count(published)} messages ({share}) did not come back, in {groups}."


def _and(names: Iterable[str]) -> str:
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last
