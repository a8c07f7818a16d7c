"""Which contender is clearly faster, cell by cell: the only judgement that a report makes.

Nothing is computed but comparisons and counts of what `summary` holds.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from reports.groups import data_type_label, device_label, qos_label, vendor_pair_label
from reports.text import visible

if TYPE_CHECKING:
    from reports.groups import Groups, Series
    from reports.values import Values

CLEARLY = (
    "A cell is one data type, size and rate. One is called clearly faster only where nine of ten of its messages were faster than half of the other's "
    "(its p90 is below the other's median) and it lost no larger share of them; anything closer is inconclusive. "
    "This compares what was recorded; repeat a run before you rely on it."
)

MODES = {"same": "same domain", "different": "different domains"}


@dataclass(frozen=True, slots=True)
class Contender:
    """What a reader can choose: a middleware, how it is called, and the bridge it needs."""

    vendor: str
    relay_vendor: str | None
    backend: str
    relay_backend: str | None
    rmw: str | None
    bridge: str


@dataclass(frozen=True, slots=True)
class Context:
    """What must be equal for a fair comparison, all as labels, the most telling first."""

    mode: str
    qos: str
    serialization: str
    devices: str
    connectivity: str


@dataclass(frozen=True, slots=True)
class Win:
    """In how many cells a contender was clearly faster than every other; `vendor` gives it its colour."""

    contender: str
    vendor: str
    cells: int


@dataclass(frozen=True, slots=True)
class Verdict:
    """What one kind of data says about its contenders, over all cells in which at least two were measured.

    Attributes:
        data: data type and domain mode (and what else tells contexts apart), as in `Binary, same domain`.
        mode: the domain mode in words.
        cells: compared cells.
        wins: most cells first.
        inconclusive: cells without a clear winner.
    """

    data: str
    mode: str
    cells: int
    wins: tuple[Win, ...]
    inconclusive: int

    @property
    def sentence(self) -> str:
        """The verdict in one sentence."""
        if not self.wins:
            return f"inconclusive in all {cells_label(self.cells)}." if self.cells > 1 else "inconclusive."
        parts = [
            f"{win.contender} is clearly fastest in {win.cells} of {cells_label(self.cells)}"
            for win in self.wins
        ]
        if self.inconclusive:
            parts.append(f"{self.inconclusive} inconclusive")
        return "; ".join(parts) + "."


def clearly_faster(values: Values, metric: str, one: int, other: int) -> bool:
    """Whether group `one` is told apart from group `other` by the rule of `CLEARLY`."""
    p90, median = values.times_ns[metric]["p90"][one], values.times_ns[metric]["p50"][other]
    kept, others_kept = values.plain["received_ratio"][one], values.plain["received_ratio"][other]
    if p90 is None or median is None or kept is None or others_kept is None:
        return False
    return p90 < median and kept >= others_kept


def verdicts_info(groups: Groups, values: Values, metric: str) -> tuple[Verdict, ...]:
    """One verdict per data type and context in which two contenders met, in the order of cells."""
    names = contender_labels(groups)
    contests: dict[tuple[str, Context], dict[int, list[int]]] = {}
    for group in sorted(groups.groups, key=lambda group: (group.cell, group.series)):
        if values.times_ns[metric]["p50"][group.index] is not None:
            place = (groups.cell_of(group).data_type, _context(groups.series_of(group)))
            contests.setdefault(place, {}).setdefault(group.cell, []).append(group.index)
    telling = _telling_parts([context for _, context in contests])
    verdicts = []
    for (data_type, context), cells in contests.items():
        compared = [entries for entries in cells.values() if _is_contest(entries, groups)]
        if not compared:
            continue
        winners = [_winner(entries, values, metric) for entries in compared]
        counts = Counter(_contender(groups.series_of(groups.groups[w])) for w in winners if w is not None)
        wins = [Win(names[contender], contender.vendor, count) for contender, count in counts.items()]
        verdicts.append(
            Verdict(
                ", ".join([data_type_label(data_type), *(getattr(context, part) for part in telling)]),
                context.mode,
                len(compared),
                tuple(sorted(wins, key=lambda win: (-win.cells, win.contender))),
                winners.count(None),
            )
        )
    return tuple(verdicts)


def contender_labels(groups: Groups) -> dict[Contender, str]:
    """Each contender's name, with backend or rmw where two would else have the same."""
    labels = {}
    for series in groups.series:
        via = "" if series.bridge == "none" else f" via {visible(series.bridge)}"
        labels[_contender(series)] = vendor_pair_label(series) + via
    for detail in ("backend", "rmw"):
        twice = {label for label, count in Counter(labels.values()).items() if count > 1}
        labels = {
            one: f"{label} ({visible(getattr(one, detail))})"
            if label in twice and getattr(one, detail)
            else label
            for one, label in labels.items()
        }
    return labels


def cells_label(count: int) -> str:
    """As in `1 cell`, `12 cells`."""
    return f"{count} cell{'' if count == 1 else 's'}"


def _contender(series: Series) -> Contender:
    return Contender(**{name: getattr(series, name) for name in Contender.__dataclass_fields__})


def _context(series: Series) -> Context:
    return Context(
        MODES.get(series.domain_mode, visible(series.domain_mode)),
        qos_label(series),
        visible(series.serialization),
        device_label(series),
        visible(series.connectivity),
    )


def _is_contest(entries: list[int], groups: Groups) -> bool:
    return len({_contender(groups.series_of(groups.groups[entry])) for entry in entries}) > 1


def _winner(entries: list[int], values: Values, metric: str) -> int | None:
    for one in entries:
        if all(one == other or clearly_faster(values, metric, one, other) for other in entries):
            return one
    return None


def _telling_parts(contexts: list[Context]) -> list[str]:
    """The parts of the contexts worth naming: the domain mode, and each in which they differ."""
    return [
        part
        for part in Context.__dataclass_fields__
        if part == "mode" or len({getattr(context, part) for context in contexts}) > 1
    ]
