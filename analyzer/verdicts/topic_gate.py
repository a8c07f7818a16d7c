"""Limits on one topic of a recording: `--fail-if "missing(/camera) > 1%"`."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from fnmatch import fnmatchcase

from dds_trace.base.errors import OptionError
from dds_trace.base.units import UNIT_NS, split_quantity

from .gate import OPERATORS, GateOutcome

TOPIC_METRICS = {"missing": "%", "jitter": "time", "hole": "time", "age_p50": "time", "age_p99": "time"}
"""Name of a value of a topic -> the kind of its limit: a share in %, or a time."""

_GATE = re.compile(
    r"\s*(?P<metric>\w+)\s*\(\s*(?P<topic>[^()\s]+)\s*\)\s*(?P<operator>>=|<=|>|<)\s*(?P<limit>\S.*?)\s*"
)


@dataclass(frozen=True, slots=True)
class TopicGate:
    """A condition under which `--topics` fails; `topic` may have wildcards, `limit` is a share or ns."""

    text: str
    metric: str
    topic: str
    operator: str
    limit: float

    def is_about(self, topic: str) -> bool:
        return fnmatchcase(topic, self.topic)

    def judge(self, low: float | None, high: float | None) -> GateOutcome:
        """Judge a value from `low` to `high`; one that is not known may be anything."""
        ends = (-math.inf if low is None else low, math.inf if high is None else high)
        fails = [OPERATORS[self.operator](end, self.limit) for end in ends]
        if all(fails):
            return GateOutcome.REGRESSED
        return GateOutcome.INCONCLUSIVE if any(fails) else GateOutcome.PASSED


def parse_topic_gate(text: str) -> TopicGate:
    """Read a limit on a topic.

    Raises:
        OptionError: the text is not such a limit.
    """
    match = _GATE.fullmatch(text)
    if match is None:
        raise OptionError(f"--fail-if {text!r}: write NAME(TOPIC) > LIMIT, for example 'missing(/camera/image) > 1%'")
    kind = TOPIC_METRICS.get(match["metric"])
    if kind is None:
        names = ", ".join(TOPIC_METRICS)
        raise OptionError(f"--fail-if {text!r}: there is no {match['metric']!r} of a topic; choose from {names}")
    number, unit = split_quantity(match["limit"]) or (0.0, "")
    factor = 0.01 if unit == "%" else UNIT_NS.get(unit)
    if factor is None or (unit == "%") != (kind == "%"):
        example = "1%" if kind == "%" else "5ms"
        raise OptionError(f"--fail-if {text!r}: no limit {match['limit']!r} of {match['metric']}; write {example}")
    return TopicGate(text.strip(), match["metric"], match["topic"], match["operator"], number * factor)
