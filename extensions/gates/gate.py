"""Gates for CI, as `--fail-if "latency_p99 > +10%"` (grammar: `docs/how-to/ci.md`), judged by the whole confidence interval."""

from __future__ import annotations

import difflib
import math
import operator
import re
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from fnmatch import fnmatchcase

from dds_trace.analyzer.model.metrics import METRICS, TOPIC_METRICS
from dds_trace.analyzer.model.names import is_topic
from dds_trace.base.errors import OptionError
from dds_trace.base.limits import shown
from dds_trace.base.units import UNIT_NS, split_quantity

from .compare import COMPARED_STATISTICS, RECEIVED_RATIO
from .sections import TOPIC, Patterns, Sections

METRIC_AND_STATISTIC = {
    f"{metric}_{statistic}": (metric, statistic)
    for metric in (*METRICS, *TOPIC_METRICS)
    for statistic in COMPARED_STATISTICS
}
_GATE_METRICS = (*METRIC_AND_STATISTIC, RECEIVED_RATIO)
OPERATORS: dict[str, Callable[[float, float], bool]] = {
    ">": operator.gt,
    ">=": operator.ge,
    "<": operator.lt,
    "<=": operator.le,
}
_POINTS = "points"
VALUES_OF_TOPICS: Mapping[str, tuple[Mapping[str, float], str]] = {
    "missing": ({"%": 0.01}, "1%"),
    "rate": ({"hz": 1.0}, "9 Hz"),
    **dict.fromkeys(("jitter", "hole", "age_p50", "age_p99"), (UNIT_NS, "5ms")),
}
"""Name of a value of a recorded topic -> the units of its limit, and an example."""
_GATE = re.compile(
    r"\s*(?P<metric>[A-Za-z0-9_.]+)\s*(\(\s*(?P<topic>[^()\s]+)\s*\))?\s*(?P<operator>>=|<=|>|<)\s*(?P<limit>\S.*?)\s*"
)


class GateOutcome(Enum):
    """The outcome of a gate."""

    PASSED = "passed"
    REGRESSED = "regressed"
    INCONCLUSIVE = "inconclusive"
    NOTHING_TO_COMPARE = "nothing to compare"

    @property
    def word(self) -> str:
        """For people."""
        return "undecided" if self is GateOutcome.INCONCLUSIVE else self.value

    @property
    def exit_code(self) -> int:
        """Of a command with this outcome."""
        return {"passed": 0, "regressed": 20, "inconclusive": 21}.get(self.value, 22)


class Against(Enum):
    """The value that a limit applies to, by the prefix of its columns."""

    RATIO = "ratio"  # change as a share of the base
    DIFFERENCE = "difference"  # change in ns
    NEW = "new"  # the new side itself


@dataclass(frozen=True, slots=True)
class Gate:
    """A condition under which a comparison fails.

    The limit is a ratio new / base for `RATIO`, otherwise ns or a share; of a file of limits it is number `order` of the `sections`.
    """

    text: str
    metric: str
    statistic: str
    operator: str
    against: Against
    limit: float
    topic: str = ""
    results: Patterns = ()
    sections: Sections | None = None
    order: int = 0
    accepted: str = ""

    @property
    def name(self) -> str:
        """`age_p99`, `received_ratio`."""
        return f"{self.metric}_{self.statistic}" if self.statistic else self.metric

    @property
    def kind(self) -> tuple[str, str, bool]:
        """Limits of one kind replace each other."""
        return self.metric, self.statistic, self.against is Against.NEW

    @property
    def is_by_result(self) -> bool:
        """It is judged with the limits of other results, as one family."""
        return bool(self.results) or (self.sections is not None and self.sections.are_several(self.kind))

    @property
    def topics(self) -> str:
        """Pattern of the topics it names."""
        columns = dict(self.results)
        named = self.topic or columns.get(TOPIC) or columns.get("data_type", "")
        return named if is_topic(named) or TOPIC in columns else ""

    def judge(self, value: float | None, low: float | None, high: float | None) -> GateOutcome:
        """Judge an estimate by its interval; an end that is None may be anywhere."""
        ends = (-math.inf if low is None else low, math.inf if high is None else high)
        fails = [OPERATORS[self.operator](end, self.limit) for end in ends]
        if value is None or any(fails) != all(fails):
            return GateOutcome.INCONCLUSIVE
        return GateOutcome.REGRESSED if all(fails) else GateOutcome.PASSED


def rows_of_gates(gates: Sequence[Gate], rows: Sequence[Mapping[str, object]]) -> list[list[int]]:
    """Return for each gate the indices of the results, or of topics by `data_type`, that it judges."""
    chosen: list[list[int]] = [[] for _ in gates]
    by_sections: dict[tuple[Sections, Hashable], dict[int, list[int]]] = defaultdict(dict)
    for gate, indices in zip(gates, chosen, strict=True):
        if gate.sections is not None:
            by_sections[gate.sections, gate.kind][gate.order] = indices
            continue
        names = (str(row["data_type"]) for row in rows)
        indices.extend(n for n, name in enumerate(names) if not gate.topic or fnmatchcase(name, gate.topic))
    for (sections, kind), indices_of_order in by_sections.items():
        for index, row in enumerate(rows):
            for order in sections.counting(kind, row):
                if order in indices_of_order:
                    indices_of_order[order].append(index)
    return chosen


DEFAULT_GATES = ("latency_p50 > +10%", "latency_p99 > +20%", "received_ratio < -0.5 points")
"""Changes that five runs of 1000 messages a side detect (`docs/results/coverage.md`)."""


def parse_gates(texts: Iterable[str]) -> list[Gate]:
    """Read gates, `default` being `DEFAULT_GATES`."""
    spelled = (DEFAULT_GATES if text.strip().lower() == "default" else (text,) for text in texts)
    return [parse_gate(text) for gates in spelled for text in gates]


def parse_gate(text: str) -> Gate:
    """Read a gate; an `OptionError` for any other text."""
    where = f"--fail-if {text!r}"
    match = _GATE.fullmatch(text)
    if match is None:
        raise OptionError(f"{where}: write METRIC > LIMIT, for example 'latency_p99 > +10%'")
    metric, statistic = _parse_metric(where, match["metric"])
    topic = match["topic"] or ""
    if topic and (metric in METRICS or not topic.startswith("/")):
        raise OptionError(
            f"{where}: a topic has {', '.join((*TOPIC_METRICS, RECEIVED_RATIO))}; write 'age_p99({topic}) > 50ms'"
        )
    against, limit = _parse_limit(where, match["limit"], metric)
    return _passable(where, Gate(text.strip(), metric, statistic, match["operator"], against, limit, topic))


_OPPOSITE = {"<": ">=", "<=": ">", ">": "<=", ">=": "<"}


def parse_threshold(metric: str, condition: str, results: Patterns = ()) -> Gate:
    """Read what results have to meet (`latency_p99`, `< 20 ms`) as the gate that fails otherwise, or an `OptionError`."""
    where = f"[thresholds] {shown(metric)} = {condition!r}"
    match = _GATE.fullmatch(f"{metric} {condition}")
    if match is None or match["metric"] != metric:
        raise OptionError(f"{where}: write what passes, for example latency_p99 = '< 20 ms'")
    of_topic = any(is_topic(value) or column == TOPIC for column, value in results)
    if of_topic and metric in VALUES_OF_TOPICS and metric not in METRIC_AND_STATISTIC:
        name, statistic, against = metric, "", Against.NEW
        limit = _limit_of_topic(where, metric, match["limit"])
    else:
        name, statistic = _parse_metric(where, metric)
        against, limit = _parse_limit(where, match["limit"], name)
    if name not in (*METRICS, RECEIVED_RATIO) and not of_topic:
        raise OptionError(f"{where}: a result has {', '.join(METRICS)} and {RECEIVED_RATIO}; choose one of them")
    text = f"{metric} {match['operator']} {match['limit']}"
    return _passable(where, Gate(text, name, statistic, _OPPOSITE[match["operator"]], against, limit))


def _passable(where: str, gate: Gate) -> Gate:
    """Return a gate that some value passes; a limit of 0 is taken, although no time is below it."""
    is_share = gate.name in (RECEIVED_RATIO, "missing")
    low, high, words = 0.0, 1.0 if is_share else math.inf, "between 0 and 100 %" if is_share else "never below 0"
    if gate.against is Against.DIFFERENCE:
        low, high, words = (-1.0, 1.0, "between -100 and +100 points") if is_share else (-math.inf, math.inf, "")
    elif gate.metric in TOPIC_METRICS:  # clocks may be apart
        low = -math.inf
    is_above = gate.limit > high or (gate.operator == "<=" and gate.limit == high)
    if gate.limit < low if gate.operator in (">", ">=") else is_above:
        raise OptionError(f"{where}: no result can pass this, as the value is {words}; give another limit")
    return gate


def _parse_metric(where: str, name: str) -> tuple[str, str]:
    spelled = name.lower().replace(".", "_")  # p99.9 is meant as p99_9
    if spelled not in _GATE_METRICS:
        near = difflib.get_close_matches(spelled, _GATE_METRICS, n=1, cutoff=0)[0]
        raise OptionError(f"{where}: no metric {name!r}; did you mean {near!r}?")
    return METRIC_AND_STATISTIC.get(spelled, (spelled, ""))


def _parse_limit(where: str, limit: str, metric: str) -> tuple[Against, float]:
    sign = limit[0] if limit[0] in "+-" else ""
    number, unit = split_quantity(limit[len(sign) :]) or (0.0, "")
    if unit == _POINTS and metric == RECEIVED_RATIO and sign:
        return Against.DIFFERENCE, (-number if sign == "-" else number) / 100
    if unit != "%" and unit not in UNIT_NS:
        raise OptionError(f"{where}: no limit {limit!r}; write a change such as +10% or +2ms, or a value such as 20ms")
    number = -number if sign == "-" else number
    is_share, is_signed = unit == "%", bool(sign)
    if metric == RECEIVED_RATIO:
        if not is_share or is_signed:
            raise OptionError(f"{where}: {RECEIVED_RATIO} takes a share such as 99%, or a change such as -0.5 points")
        return Against.NEW, number / 100
    if is_share:
        if not is_signed:
            raise OptionError(f"{where}: write +{limit} for a change against the base")
        return Against.RATIO, 1 + number / 100
    return Against.DIFFERENCE if is_signed else Against.NEW, number * UNIT_NS[unit]


def parse_topic_gate(text: str, *, of_two: bool = False) -> Gate:
    """Read a limit on a recorded topic, which may have wildcards; an `OptionError` for any other text."""
    where = f"--fail-if {text!r}"
    match = _GATE.fullmatch(text)
    if match is None or not match["topic"]:
        raise OptionError(f"{where}: write NAME(TOPIC) > LIMIT, for example 'missing(/camera/image) > 1%'")
    name = match["metric"]
    if name not in VALUES_OF_TOPICS:
        raise OptionError(f"{where}: there is no {name!r} of a topic; choose from {', '.join(VALUES_OF_TOPICS)}")
    metric, statistic = METRIC_AND_STATISTIC.get(name, (name, ""))
    against, limit = Against.NEW, match["limit"]
    if of_two and limit[0] in "+-":
        number, unit = split_quantity(limit[1:]) or (0.0, "")
        is_share = name == "missing"
        if unit != (_POINTS if is_share else "%"):
            raise OptionError(f"{where}: write {'+0.5 points' if is_share else '+10%'} for a change of {name}")
        against = Against.DIFFERENCE if is_share else Against.RATIO
        value = (-number if limit[0] == "-" else number) / 100 + (not is_share)
    else:
        value = _limit_of_topic(where, name, limit)
    return _passable(where, Gate(text.strip(), metric, statistic, match["operator"], against, value, match["topic"]))


def _limit_of_topic(where: str, name: str, limit: str) -> float:
    number, unit = split_quantity(limit) or (0.0, "")
    units, example = VALUES_OF_TOPICS[name]
    if unit not in units:
        raise OptionError(f"{where}: no limit {limit!r} of {name}; write {example}")
    return number * units[unit]
