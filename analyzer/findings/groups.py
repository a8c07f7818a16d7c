"""Checks of the groups of the summary: losses, order, impossible times, samples too few for a percentile."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

from dds_trace.base.units import counted, format_ms

from ..model.environment import environment_differences
from ..model.finding import Finding, Severity
from ..model.metrics import METRICS
from ..pairing.pair import Outcome
from ..statistics.percentiles import PERCENTILES
from .evidence import exchange_name, percent, some

if TYPE_CHECKING:
    from collections.abc import Iterator

    from ..statistics.percentiles import Percentile
    from .evidence import Evidence

_LOST = {
    Outcome.LOST_OUTBOUND.value: "on the way out",
    Outcome.LOST_IN_RELAY.value: "in the relay",
    Outcome.LOST_RETURN.value: "on the way back",
    Outcome.LOST_UNKNOWN.value: "nobody knows where",
}
"""Outcome -> where the message was lost, in words."""


def losses(evidence: Evidence) -> Iterator[Finding]:
    """Report groups that lost messages."""
    rows = evidence.summary.frame.iter_rows(named=True)
    for group, (name, row) in enumerate(zip(evidence.group_names, rows, strict=True)):
        published, received = row["published"], row["received"]
        lost = ", ".join(f"{row[outcome]} {where}" for outcome, where in _LOST.items() if row[outcome])
        if published and not received:
            yield Finding(
                Severity.ERROR,
                "nothing_received",
                name,
                f"None of {counted(published, 'message')} came back ({lost}).",
                "Check domain, bridge and middleware of both sides; there is nothing to compare here.",
                (group,),
            )
        elif lost:
            yield Finding(
                Severity.WARNING,
                "loss",
                name,
                f"{published - received} of {counted(published, 'message')} ({percent(published - received, published)}) "
                f"did not come back: {lost}.",
                "Read percentiles here as those of the messages that survived; look at reliability, "
                "socket buffers and rate.",
                (group,),
                effect=(published - received) / published,
            )


def unmeasured_groups(evidence: Evidence) -> Iterator[Finding]:
    """Report groups all of whose messages were warm-up."""
    counts = evidence.summary.frame["published"]
    for group, (name, published) in enumerate(zip(evidence.group_names, counts, strict=True)):
        if not published:
            yield Finding(
                Severity.WARNING,
                "nothing_counted",
                name,
                "All messages were warm-up; nothing is counted.",
                "Record more messages than warm-up messages.",
                (group,),
            )


def duplicates(evidence: Evidence) -> Iterator[Finding]:
    """Report groups in which replies came more than once."""
    columns = evidence.summary.frame.select("duplicates", "received").iter_rows()
    for group, (name, (count, received)) in enumerate(zip(evidence.group_names, columns, strict=True)):
        if count:
            yield Finding(
                Severity.WARNING,
                "duplicates",
                name,
                f"{counted(count, 'reply', 'replies')} came more than once; the first one counts.",
                "Look for a second bridge or route between the two sides.",
                (group,),
                effect=min(count / max(received, 1), 1.0),
            )


def reordering(evidence: Evidence) -> Iterator[Finding]:
    """Report groups in which replies overtook each other."""
    columns = evidence.summary.frame.select("reordered", "received").iter_rows()
    for group, (name, (count, received)) in enumerate(zip(evidence.group_names, columns, strict=True)):
        if count:
            yield Finding(
                Severity.WARNING,
                "reordering",
                name,
                f"{count} of {counted(received, 'reply', 'replies')} came after the reply to a later message.",
                "With reliable QoS on one topic this should not happen: look for several routes or relays.",
                (group,),
                effect=count / received,
            )


def impossible_times(evidence: Evidence) -> Iterator[Finding]:
    """Report negative times: a clock stepped, or stamps do not belong together."""
    counts = evidence.summary.of_exchange.select("negative_rtt", "negative_intermediate", "negative_latency")
    rows = counts.iter_rows(named=True)
    for exchange, group, row in zip(
        evidence.grouping.exchanges, evidence.exchange_groups(), rows, strict=True
    ):
        below_zero = [
            f"{name.removeprefix('negative_')} of {counted(n, 'message')}" for name, n in row.items() if n
        ]
        if below_zero:
            yield Finding(
                Severity.ERROR,
                "negative_times",
                exchange_name(exchange),
                f"Below zero: {', '.join(below_zero)}. They are in the statistics as computed.",
                "Do not use these numbers: check that stamps are CLOCK_MONOTONIC of one device each, and that no "
                "two relays share a relay_id.",
                (group,),
            )


_REPEAT_LABELS = frozenset({"attempt", "iteration", "pass", "repeat", "round", "run", "seed", "trial"})
"""Labels that number plain repeats, and tell of no setting."""


def mixed_labels(evidence: Evidence) -> Iterator[Finding]:
    """Report groups that pool runs with different labels, which are no parameter column; numbers of repeats are none."""
    names = evidence.group_names
    for group, members in enumerate(evidence.grouping.members()):
        values: dict[str, set[str | None]] = defaultdict(set)
        runs = [evidence.grouping.exchanges[member].run for member in members]
        for label in {label for run in runs for label in run.labels if label.lower() not in _REPEAT_LABELS}:
            values[label] = {run.labels.get(label) for run in runs}
        mixed = {label: different for label, different in sorted(values.items()) if len(different) > 1}
        if mixed:
            listed = "; ".join(
                f"{label}: {some(sorted(map(str, different)), 5)}" for label, different in mixed.items()
            )
            yield Finding(
                Severity.WARNING,
                "mixed_labels",
                names[group],
                f"Runs with different labels are summarized together ({listed}).",
                "Analyze them as separate folders, or compare them by run in roundtrips.parquet.",
                (group,),
            )


def unlike_group_environments(evidence: Evidence) -> Iterator[Finding]:
    """Report groups whose runs had unlike environments, which nobody asked for."""
    for group, members in enumerate(evidence.grouping.members()):
        exchanges = [evidence.grouping.exchanges[member] for member in members]
        differences = environment_differences((exchange.ping, exchange.relay) for exchange in exchanges)
        if differences:
            listed = "; ".join(
                f"{name}: {some(values, 4)}" for name, values in list(differences.items())[:_FIELDS]
            )
            more = len(differences) - _FIELDS
            yield Finding(
                Severity.WARNING,
                "environment_differs",
                evidence.group_names[group],
                f"Runs of unlike environments are summarized together ({listed}{f'; and {more} more' if more > 0 else ''}).",
                "Analyze them as separate folders, or record again under equal conditions.",
                (group,),
            )


_FIELDS = 5
"""Fields of unlike environments that a finding lists."""


def few_samples(evidence: Evidence) -> Iterator[Finding]:
    """Report percentiles that are null for want of samples; groups that lack the same percentiles share a finding."""
    names, samples = evidence.group_names, evidence.summary.samples
    lacking: dict[tuple[tuple[int, ...], tuple[str, ...]], list[Percentile]] = defaultdict(list)
    for percentile in PERCENTILES:
        alike: dict[tuple[int, ...], list[str]] = defaultdict(list)
        for metric in METRICS:
            # Without any sample, another finding says why (a loss, a missing relay trace).
            groups = tuple(
                group for group, n in enumerate(samples[metric].tolist()) if 0 < n < percentile.needs
            )
            alike[groups].append(metric)
        for groups, together in alike.items():
            if groups:
                lacking[groups, tuple(together)].append(percentile)
    for (groups, metrics), percentiles in lacking.items():
        counts = sorted(int(samples[metric][group]) for metric in metrics for group in groups)
        few = f"{counts[0]} to " if counts[0] != counts[-1] else ""
        first, *further = (f"{_shown(p)} needs {p.needs:,}" for p in percentiles)
        wanted = ", ".join([f"{first} messages", *further])
        everywhere = len(groups) == len(names) and len(groups) > 1
        yield Finding(
            Severity.INFO,
            "few_samples",
            f"all {len(groups)} groups" if everywhere else some(names[group] for group in groups),
            f"{wanted}; you have {few}{counts[-1]:,} (of {', '.join(metrics)}).",
            f"Record at least {percentiles[-1].needs} messages a group to see all of them.",
            groups,
        )


def _shown(percentile: Percentile) -> str:
    return percentile.name.replace("_", ".")


def outages(evidence: Evidence) -> Iterator[Finding]:
    """Report groups that lost several messages in a row."""
    names, published = evidence.group_names, evidence.summary.frame["published"].to_list()
    for (key,), of_group in evidence.details.outages.group_by(["group"], maintain_order=True):
        group = int(str(key))
        durations_ns = of_group["duration_ns"].drop_nulls().to_list()
        longest = f"; the longest lasted {format_ms(max(durations_ns))} ms" if durations_ns else ""
        endless = len(of_group) - len(durations_ns)
        yield Finding(
            Severity.WARNING,
            "outage",
            names[group],
            f"{counted(len(of_group), 'time')} several messages in a row were lost, {of_group['messages'].sum()} in all{longest}"
            + (f"; {endless} lasted to the end of the run." if endless else "."),
            "Look at the timeline: a link that drops out, a bridge or relay that restarts, a full buffer.",
            (group,),
            effect=of_group["messages"].sum() / published[group],
        )


_DELIVERIES = {"relay_delivery_ns": "relay", "ping_delivery_ns": "ping"}
"""Part of `Details.breakdown` that ends in a callback -> role whose callback it is."""

_TAIL_PERIODS, _TAIL_NS = 2, 20_000_000
"""Wait of the slowest hundredth, in periods and at least in ns, that no busy processor explains."""


def waits_in_readers(evidence: Evidence) -> Iterator[Finding]:
    """Report groups whose messages lay with the middleware for periods before the callback took them.

    A reader that falls behind takes each message when a later one arrives: the latency is then a multiple of the
    period, and says nothing of the link.
    """
    names, rates = evidence.group_names, evidence.summary.frame["rate_hz"].to_list()
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
        yield Finding(
            Severity.WARNING,
            "waits_in_reader",
            names[group],
            f"{words} waited {format_ms(waited_ns)} ms or longer between the middleware of the {role} and its "
            f"callback, {waited_ns * rate_hz / 1e9:.1f} periods.",
            f"This is the {role}'s program, not the link: look at its CPU and at --executor, and record anew with a "
            "fresh process.",
            (group,),
            effect=share,
        )
