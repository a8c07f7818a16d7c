"""The first screen's answer: which vendor and bridge is fastest for which data, and where the traces cannot tell.

For each kind of message (link, domain mode, data type, size, rate) the contenders' p99, or p50 where not all have an interval
for p99, is compared by confidence intervals. One contender leads if its interval lies wholly below all the others;
where the best interval overlaps another the answer is 'inconclusive'. Lost messages count as infinitely late. Plain
sockets are the floor beneath every middleware, and no contender where a middleware was measured.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from ..model.parameters import CASE_COLUMNS, CONTENDER_COLUMNS
from ..statistics.intervals import percentile_interval, ranges_overlap, ratio_interval
from .recommend import delivered_latencies, parts_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from ..statistics.intervals import Interval

    ContenderNames = Mapping[tuple[Any, ...], str]
    """The values of `CONTENDER_COLUMNS` -> what the setting is called."""

ANSWER_COLUMNS = ("run_id", "relay_id", "publish_ns", "latency_ns", "rtt_ns", "outcome")
"""What of the rows an answer rests on."""


class Clarity(Enum):
    """How far an answer can be relied on."""

    CLEAR = "clear"
    INCONCLUSIVE = "inconclusive"
    ONLY_ONE = "only one"  # nothing to compare it with


@dataclass(frozen=True, slots=True)
class Contender:
    """One setting in one case.

    Attributes:
        name: what tells it apart from the others of the campaign: vendor, bridge, and what else varies.
        setting: the columns `CONTENDER_COLUMNS`.
        latency: the compared percentile, with its interval, ns.
        received: share of messages whose reply came back, with its interval.
    """

    name: str
    setting: Mapping[str, Any]
    latency: Interval
    received: Interval


@dataclass(frozen=True, slots=True)
class Answer:
    """Who is fastest for one kind of message.

    Attributes:
        percentile: `p99` or `p50`, the one that was compared.
        contenders: best first.
        leaders: how many of them, from the first, cannot be told apart from the best.
    """

    connectivity: str
    domain_mode: str
    data_type: str
    payload_bytes: int
    rate_hz: float
    percentile: str
    clarity: Clarity
    contenders: tuple[Contender, ...]
    leaders: tuple[Contender, ...]


@dataclass(frozen=True, slots=True)
class Win:
    """A contender that leads clearly in some cases of a headline.

    Attributes:
        cases: in how many.
        smallest_bytes: smallest payload of those cases.
        largest_bytes: largest payload.
    """

    name: str
    cases: int
    smallest_bytes: int
    largest_bytes: int


@dataclass(frozen=True, slots=True)
class Headline:
    """The answers for one link, domain mode and data type in one line.

    Attributes:
        cases: sizes and rates with at least two contenders.
        wins: contenders that lead clearly somewhere, most cases first.
        inconclusive: cases without a clear leader.
        only_one: cases with one contender only, not among `cases`.
    """

    connectivity: str
    domain_mode: str
    data_type: str
    cases: int
    wins: tuple[Win, ...]
    inconclusive: int
    only_one: int

    @property
    def words(self) -> str:
        """The line in words."""
        what = f"{self.data_type}, {self.domain_mode} domain, {self.connectivity}"
        if not self.cases:
            return f"{what}: one contender only, nothing to compare"
        said = [f"{win.name} is fastest in {win.cases} of {self.cases}" for win in self.wins]
        if self.inconclusive:
            said.append(f"inconclusive in {self.inconclusive} of {self.cases}")
        return f"{what}: {'; '.join(said)}"


def find_answers(roundtrips: pl.DataFrame, confidence: float = 0.95) -> tuple[Answer, ...]:
    """One answer for each kind of message, sorted by its columns.

    Args:
        roundtrips: frame of `docs/trace-format.md`.
        confidence: of the intervals.
    """
    contending = without_floor(roundtrips)
    names = contender_names(contending)
    return tuple(
        answer_case(case, parts_of(rows, CONTENDER_COLUMNS), names, confidence)
        for case, rows in parts_of(contending, CASE_COLUMNS)
    )


def without_floor(frame: pl.DataFrame) -> pl.DataFrame:
    """Rows or groups of middlewares, those of plain sockets left out unless there are no others."""
    middlewares = frame.filter(pl.col("backend") != "socket")
    return frame if middlewares.is_empty() else middlewares


def answer_case(
    case: Mapping[str, Any],
    parts: Iterable[tuple[dict[str, Any], pl.DataFrame]],
    names: ContenderNames,
    confidence: float = 0.95,
) -> Answer:
    """The answer for one kind of message.

    Args:
        case: the values of `CASE_COLUMNS`.
        parts: each setting (the values of `CONTENDER_COLUMNS`) with its rows (`ANSWER_COLUMNS`) by run, relay and time;
            one at a time is held.
        names: `contender_names` of the campaign.
        confidence: of the intervals.
    """
    percentile, contenders = _compared(parts, names, confidence)
    ranked = tuple(sorted(contenders, key=_order))
    best = ranked[0].latency
    leaders = tuple(c for c in ranked if c is ranked[0] or _overlap(best, c.latency))
    if len(ranked) == 1:
        clarity = Clarity.ONLY_ONE
    else:
        clarity = Clarity.CLEAR if len(leaders) == 1 else Clarity.INCONCLUSIVE
    return Answer(**case, percentile=percentile, clarity=clarity, contenders=ranked, leaders=leaders)


def find_headlines(answers: Sequence[Answer]) -> tuple[Headline, ...]:
    """One line for each link, domain mode and data type, in the order of the answers."""
    headlines = []
    for key in dict.fromkeys((a.connectivity, a.domain_mode, a.data_type) for a in answers):
        cases = [a for a in answers if (a.connectivity, a.domain_mode, a.data_type) == key]
        sizes: dict[str, list[int]] = {}
        for answer in cases:
            if answer.clarity is Clarity.CLEAR:
                sizes.setdefault(answer.leaders[0].name, []).append(answer.payload_bytes)
        wins = [Win(name, len(won), min(won), max(won)) for name, won in sizes.items()]
        headlines.append(
            Headline(
                *key,
                cases=sum(a.clarity is not Clarity.ONLY_ONE for a in cases),
                wins=tuple(sorted(wins, key=lambda win: (-win.cases, win.name))),
                inconclusive=sum(a.clarity is Clarity.INCONCLUSIVE for a in cases),
                only_one=sum(a.clarity is Clarity.ONLY_ONE for a in cases),
            ),
        )
    return tuple(headlines)


def _compared(
    parts: Iterable[tuple[dict[str, Any], pl.DataFrame]], names: ContenderNames, confidence: float
) -> tuple[str, list[Contender]]:
    medians, tails = [], []
    for setting, rows in parts:
        values = delivered_latencies(rows)
        ordered = np.sort(values)
        median, tail = (
            Contender(
                name=names[tuple(setting.values())],
                setting=setting,
                latency=percentile_interval(values, quantile, confidence, ordered=ordered),
                received=ratio_interval((rows["outcome"] == "completed").to_numpy(), confidence),
            )
            for quantile in (0.5, 0.99)
        )
        medians.append(median)
        tails.append(tail)
    if all(contender.latency.is_two_sided for contender in tails):
        return "p99", tails
    return "p50", medians


_NAMED_APART: Mapping[str, tuple[str, str]] = {
    "rmw": ("{}", "no rmw"),
    "relay_backend": ("relay by {}", "relay unknown"),
    "relay_vendor": ("relay {}", "relay unknown"),
}
"""What is said only where nothing else tells two contenders apart, and how: of a value, and of a null."""


def contender_names(parameters: pl.DataFrame) -> ContenderNames:
    """A name for every setting: `fastdds`, `fastdds via builtin`, `fastdds to cyclonedds, reliability best_effort` ...

    Args:
        parameters: has `CONTENDER_COLUMNS`; any number of rows of each setting.
    """
    settings = [
        dict(zip(CONTENDER_COLUMNS, row, strict=True))
        for row in parameters.select(CONTENDER_COLUMNS).unique(maintain_order=True).iter_rows()
    ]
    short = [_short_name(setting, _varying(settings)) for setting in settings]
    names = {}
    for setting, name in zip(settings, short, strict=True):
        alike = [other for other, of_other in zip(settings, short, strict=True) if of_other == name]
        apart = []
        for column in _varying(alike):
            known, unknown = _NAMED_APART.get(column, (f"{column} {{}}", f"no {column}"))
            apart.append(unknown if setting[column] is None else known.format(setting[column]))
        names[tuple(setting.values())] = ", ".join(dict.fromkeys([name, *apart]))
    return names


def _varying(settings: Sequence[Mapping[str, Any]]) -> list[str]:
    return [column for column in CONTENDER_COLUMNS if len({setting[column] for setting in settings}) > 1]


def _short_name(setting: Mapping[str, Any], varying: Sequence[str]) -> str:
    name = str(setting["vendor"])
    if setting["relay_vendor"] not in {None, setting["vendor"]}:
        name += f" to {setting['relay_vendor']}"
    if setting["bridge"] != "none":
        name += f" via {setting['bridge']}"
    said = {"vendor", "bridge", *_NAMED_APART}
    return ", ".join([name, *(f"{n} {setting[n]}" for n in varying if n not in said)])


def _order(contender: Contender) -> tuple[float, float, str]:
    latency = contender.latency
    known = [math.inf if v is None else v for v in (latency.value, latency.upper)]
    return known[0], known[1], contender.name


def _overlap(one: Interval, other: Interval) -> bool:
    return ranges_overlap((one.lower, one.upper), (other.lower, other.upper))
