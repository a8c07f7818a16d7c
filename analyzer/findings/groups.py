"""Results: order, impossible times, too few samples."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

from dds_trace.base.units import counted, format_duration, three_digits

from ..model.environment import environment_differences
from ..model.finding import Subject
from ..model.metrics import METRICS
from ..statistics.percentiles import PERCENTILES, Percentile
from .evidence import Evidence, Observation, error, exchange_name, note, some, warning


@warning("duplicates", Subject.RESULT, "Look for a second bridge or route between the two sides.")
def duplicates(evidence: Evidence) -> Iterator[Observation]:
    """Replies came more than once."""
    copies: dict[int, list[tuple[int, int]]] = defaultdict(list)
    for _, group, counts in evidence.counts_by_exchange():
        if counts["duplicates"]:
            copies[group].append((counts["duplicates"], counts["duplicated"]))
    received = evidence.summary.frame["received"].to_list()
    for group, pairs in copies.items():
        extra, several = (sum(column) for column in zip(*pairs, strict=True))
        yield evidence.result(
            group,
            f"{several:,} of {counted(received[group], 'message')} came back more than once, {counted(extra, 'copy', 'copies')} too "
            "many; the first one counts.",
            min(several / max(received[group], 1), 1.0),
        )


@error(
    "negative_times",
    Subject.RUN,
    "Do not use these numbers: check that stamps are CLOCK_MONOTONIC of one device each, and that no two relays share a "
    "relay_id.",
)
def impossible_times(evidence: Evidence) -> Iterator[Observation]:
    """Times are below zero: a clock stepped, or stamps do not belong together."""
    for exchange, group, counts in evidence.counts_by_exchange():
        below_zero = [
            f"{name} of {counted(count, 'message')}"
            for name in ("rtt", "intermediate", "latency")
            if (count := counts[f"negative_{name}"])
        ]
        if below_zero:
            what = f"Below zero: {', '.join(below_zero)}. They are in the statistics as computed."
            yield Observation(exchange_name(exchange), what, (group,))


_REPEAT_LABELS = frozenset({"attempt", "iteration", "pass", "repeat", "round", "run", "seed", "trial"})
"""Labels that number repeats; they describe no setting."""


@warning(
    "mixed_labels", Subject.RESULT, "Analyze them as separate folders, or compare them by run in roundtrips.parquet."
)
def mixed_labels(evidence: Evidence) -> Iterator[Observation]:
    """A result has runs with different labels."""
    for group, members in enumerate(evidence.grouping.members()):
        runs = [evidence.grouping.exchanges[member].run for member in members]
        labels = {label for run in runs for label in run.labels if label.lower() not in _REPEAT_LABELS}
        values = {label: {run.labels.get(label) for run in runs} for label in sorted(labels)}
        mixed = "; ".join(
            f"{label}: {some(sorted(map(str, different)), 5)}"
            for label, different in values.items()
            if len(different) > 1
        )
        if mixed:
            yield evidence.result(group, f"Runs with different labels are summarized together ({mixed}).")


_MOST_FIELDS = 5
"""Fields that a finding lists; the sessions have all."""


@warning(
    "environment_differs", Subject.RESULT, "Analyze them as separate folders, or record again under equal conditions."
)
def unlike_group_environments(evidence: Evidence) -> Iterator[Observation]:
    """A result has runs of different environments."""
    for group, members in enumerate(evidence.grouping.members()):
        exchanges = [evidence.grouping.exchanges[member] for member in members]
        differences = environment_differences((exchange.ping, exchange.relay) for exchange in exchanges)
        if differences:
            listed = some((f"{name}: {some(values, 4)}" for name, values in differences.items()), _MOST_FIELDS)
            yield evidence.result(group, f"Runs of different environments are summarized together ({listed}).")


@note("few_samples", Subject.RESULT, "Record at least {needed} messages for each result to see all of them.")
def few_samples(evidence: Evidence) -> Iterator[Observation]:
    """Too few messages for a percentile."""
    names, samples = evidence.group_names, evidence.summary.samples
    lacking: dict[tuple[tuple[int, ...], tuple[str, ...]], list[Percentile]] = defaultdict(list)
    for percentile in PERCENTILES:
        metrics_of: dict[tuple[int, ...], list[str]] = defaultdict(list)
        for metric in METRICS:
            # Without any sample another finding says why.
            groups = tuple(
                group for group, count in enumerate(samples[metric].tolist()) if 0 < count < percentile.needs
            )
            metrics_of[groups].append(metric)
        for groups, metrics in metrics_of.items():
            if groups:
                lacking[groups, tuple(metrics)].append(percentile)
    for (groups, together), percentiles in lacking.items():
        counts = sorted(int(samples[metric][group]) for metric in together for group in groups)
        few = f"{counts[0]} to " if counts[0] != counts[-1] else ""
        first, *further = (f"{p.label} needs {p.needs:,}" for p in percentiles)
        needs = ", ".join([f"{first} messages", *further])
        everywhere = len(groups) == len(names) and len(groups) > 1
        yield Observation(
            f"all {len(groups)} results" if everywhere else some(names[group] for group in groups),
            f"{needs}; you have {few}{counts[-1]:,} (of {', '.join(together)}).",
            groups,
            blanks={"needed": percentiles[-1].needs},
        )


_DELIVERIES = {"relay_delivery_ns": "relay", "ping_delivery_ns": "ping"}

_TAIL_PERIODS, _TAIL_NS = 2, 20_000_000
"""Wait of the slowest hundredth that no busy processor explains: periods, and at least ns."""


@warning(
    "waits_in_reader",
    Subject.RESULT,
    "This is the {role}'s program, not the link: a free CPU, another -o executor or a fresh process may help.",
)
def waits_in_readers(evidence: Evidence) -> Iterator[Observation]:
    """Messages wait for the program that reads them."""
    # A reader that fell back takes a message when a later one arrives: latency is a multiple of the period.
    rates = evidence.summary.frame["rate_hz"].to_list()
    parts = evidence.details.breakdown.select("group", "part", "p50_ns", "p99_ns").iter_rows()
    for group, part, median_ns, p99_ns in parts:
        role, rate_hz = _DELIVERIES.get(part), rates[group]
        if role is None or not rate_hz:
            continue
        if median_ns * rate_hz >= 1e9:
            words, share, waited_ns = "Half of the messages", 0.5, median_ns
        elif p99_ns is not None and p99_ns >= max(_TAIL_PERIODS * 1e9 / rate_hz, _TAIL_NS):
            words, share, waited_ns = "One message in a hundred", 0.01, p99_ns
        else:
            continue
        yield evidence.result(
            group,
            f"{words} waited {format_duration(waited_ns)} or longer between the middleware of the {role} and its "
            f"callback, {three_digits(waited_ns * rate_hz / 1e9)} periods.",
            share,
            role=role,
        )
