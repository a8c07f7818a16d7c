"""Calls of services and actions."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from statistics import median

from dds_trace.base.units import counted, format_duration
from dds_trace.tracefile.format.json_fields import number_of, object_of

from ..model.finding import Subject
from .evidence import Evidence, Observation, note, warning

_TIMES = {
    "first_ns": "the first call after discovery took {}",
    "typed_ns": "conversion of its typed messages takes {} of each call",
    "accepted_p50_ns": "half of the goals are accepted within {}",
    "feedback_p50_ns": "half have a first feedback within {}",
}
"""Times of a run's `call` in words."""


@note(
    "calls",
    Subject.RESULT,
    "Compare with the same bytes by topics, raw and typed. A first call as late as this one is what a program meets that calls as "
    "soon as it sees the server.",
)
def calls(evidence: Evidence) -> Iterator[Observation]:
    """Messages are calls of a service or an action."""
    p50s_ns = evidence.summary.frame["rtt_p50_ns"]
    for group, values in _calls(evidence).items():
        parts = [words.format(format_duration(median(values[name]))) for name, words in _TIMES.items() if values[name]]
        if parts:
            yield evidence.result(group, f"A call takes {format_duration(p50s_ns[group])} at p50; {'; '.join(parts)}.")


@warning(
    "calls_timed_out",
    Subject.RESULT,
    "Lost requests and responses are counted as losses. For late ones look at the largest latencies: a lower rate or fewer clients "
    "may help, or a longer -o call_timeout, if the caller can wait.",
)
def calls_timed_out(evidence: Evidence) -> Iterator[Observation]:
    """Calls had no response within their timeout."""
    for group, values in _calls(evidence).items():
        missed, published = round(sum(values["timed_out"])), evidence.summary.frame["published"][group]
        if missed:
            never = published - evidence.summary.frame["received"][group]
            yield evidence.result(
                group,
                f"{counted(missed, 'call')} of {published:,} had no response within {max(values['timeout_s']):g} s; {never:,} never had one.",
                missed / published,
            )


def _calls(evidence: Evidence) -> dict[int, dict[str, list[float]]]:
    groups: dict[int, dict[str, list[float]]] = {}
    for exchange, group in evidence.exchanges_by_group():
        for name, value in object_of(exchange.run.extra.get("call")).items():
            number = number_of(value)
            if number is not None and number >= 0:
                groups.setdefault(group, defaultdict(list))[name].append(number)
    return groups
